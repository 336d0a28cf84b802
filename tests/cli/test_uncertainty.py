"""``binocal uncertainty``: what it prints, and every way to ask it wrongly."""

import json
from pathlib import Path

import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.cli import main
from binocal.formats import rig_json
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig
from rigs import make_calibration


@pytest.fixture(scope="module")
def rig_path(tmp_path_factory):
    rng, rig, board = np.random.default_rng(0), table2_rig(), parse_board("chessboard:6x5:30mm")
    scene = StereoScene(rig, board, sample_board_poses(rig, board, 10, rng))
    detections = simulate_detections(scene, rng, noise_px=0.1)
    path = tmp_path_factory.mktemp("uncertainty") / "rig.json"
    rig_json.write_calibration(path, calibrate(detections, model="brown4", calibrator="lm"))
    return str(path)


def test_the_table_splits_depth_by_cause(rig_path, capsys):
    assert main(["uncertainty", rig_path, "--range", "0.5-5m"]) == 0
    text = capsys.readouterr().out
    assert "calibration" in text and "matching" in text and "row error" in text and "projection" in text
    assert sum(line.lstrip().startswith("worst") or "  worst" in line for line in text.splitlines()) >= 6


def test_the_document_holds_arrays_and_their_worst_places(rig_path, capsys):
    assert main(["uncertainty", rig_path, "--range", "1m", "--matching", "0.5px", "--json"]) == 0
    document = json.loads(capsys.readouterr().out, parse_constant=lambda word: pytest.fail(word))
    (at_1m,) = document["ranges"]
    total = np.array([[np.nan if v is None else v for v in row] for row in at_1m["total_m"]])
    assert at_1m["depth_m"] == 1.0 and document["matching_px"] == 0.5 and document["unit"] == "m"
    assert at_1m["worst"]["total_m"] == np.nanmax(total) >= at_1m["middle"]["total_m"]
    assert at_1m["worst"]["relative"] == at_1m["worst"]["total_m"]
    assert {m["camera"] for m in document["projection"]["at_infinity"]} == {"left", "right"}


@pytest.mark.parametrize(
    ("options", "code", "said"),
    [
        (["--range", "5-0.5m"], 2, "from near to far"),
        (["--range", "2px"], 2, "not a length"),
        (["--range", "0.5-5"], 3, "in metres: give --range a unit"),
        (["--range", "1mm"], 3, "see nothing together"),
        (["--range", "1m", "--matching", "-1px"], 2, "not a number of pixels"),
        (["--range", "1m", "--matching", "1mm"], 2, "not a number of pixels"),
    ],
)
def test_what_makes_no_sense_is_one_line(rig_path, capsys, options, code, said):
    assert main(["uncertainty", rig_path, *options]) == code
    out, err = capsys.readouterr()
    assert not out and said in err and len(err.splitlines()) == 1


def test_a_file_without_covariance_is_told_so(tmp_path, capsys):
    path = tmp_path / "rig.json"
    rig_json.write_calibration(path, make_calibration())  # its translation's sigma is unknown
    assert main(["uncertainty", str(path), "--range", "1m"]) == 3
    assert "states no covariance" in capsys.readouterr().err


def test_an_older_file_says_what_it_does_not_hold(rig_path, tmp_path, capsys):
    document = json.loads(Path(rig_path).read_text(encoding="utf-8"))
    del document["mean_board_pose"]
    path = tmp_path / "older.json"
    path.write_text(json.dumps(document))
    assert main(["uncertainty", str(path), "--range", "1m"]) == 0
    text = capsys.readouterr().out
    assert "no projection uncertainty" in text and "calibrate anew" in text


@pytest.mark.parametrize(("calibrator", "why"), [("rectangles", "no board was seen"), ("zoom", "lm and drl do")])
def test_a_fresh_file_without_board_poses_is_not_called_old(rig_path, tmp_path, capsys, calibrator, why):
    document = json.loads(Path(rig_path).read_text(encoding="utf-8"))
    del document["mean_board_pose"]
    document["provenance"] = {**document.get("provenance", {}), "calibrator": calibrator}
    path = tmp_path / "fresh.json"
    path.write_text(json.dumps(document))
    assert main(["uncertainty", str(path), "--range", "1m"]) == 0
    text = capsys.readouterr().out
    assert why in text and "calibrate anew" not in text


def test_a_file_without_a_calibration_is_named_as_such(rig_path, tmp_path, capsys):
    from binocal.formats.opencv_yaml import write_opencv

    write_opencv(tmp_path / "rig.yml", table2_rig())
    rig_json.write_rig(tmp_path / "bare.json", table2_rig())
    (tmp_path / "cut.json").write_text(Path(rig_path).read_text()[:5000])
    for name, text in (
        ("rig.yml", "holds no calibration of binocal's; an uncertainty needs the rig.json"),
        ("bare.json", "holds no calibration of binocal's; an uncertainty needs the rig.json"),
        ("cut.json", "is not JSON"),
        ("none.json", "is missing"),
    ):
        assert main(["uncertainty", str(tmp_path / name), "--range", "1m"]) == 3
        said = capsys.readouterr().err
        assert text in said and said.count("\n") == 1
