"""``calibrate --corners``: corners in a file in place of images."""

from __future__ import annotations

import json

import pytest

import binocal
from binocal.cli import main
from contracts import make_corners


@pytest.fixture(scope="module")
def turned(tmp_path_factory):
    folder = tmp_path_factory.mktemp("turning") / "turn"
    assert main(["simulate", "--rig", "turning", "--pairs", "4", "--output", str(folder)]) == 0
    return folder


def test_rectangles_from_the_simulator_to_the_rig(turned, tmp_path, capsys):
    arguments = ["calibrate", "--corners", turned / "corners.npz", "--calibrator", "rectangles"]
    arguments += ["--prior", turned / "rig.json", "--output", tmp_path / "rig.json", "--json"]
    assert main([str(a) for a in arguments]) == 0
    document = json.loads(capsys.readouterr().out)
    assert len(document["provenance"]["rectangles"]["pairs"]) == 4
    assert "Board" not in [line["name"] for line in document["checks"]]  # there is none
    assert main(["evaluate", str(tmp_path / "rig.json"), "--truth", str(turned / "truth.json"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rotation_error_deg"] < 0.15  # 0.03 measured


def test_corners_of_a_board_in_place_of_its_images(tmp_path, capsys):
    corners = make_corners()
    binocal.write_detections(tmp_path / "corners.npz", corners)
    arguments = ["calibrate", "--corners", tmp_path / "corners.npz", "--model", "brown4", "--calibrator", "lm"]
    arguments += ["--output", tmp_path / "rig.json", "--evidence", tmp_path / "again.npz"]
    assert main([str(a) for a in arguments]) == 0
    made = binocal.read_calibration(tmp_path / "rig.json")
    assert made.rig.baseline_m == binocal.calibrate(corners, calibrator="lm", model="brown4").rig.baseline_m
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "corners.npz").read_bytes()
    assert "Wrote" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (["--left", "a"], 2, "missing option '--right'"),
        (
            ["--corners", "{turn}/corners.npz", "--left", "a"],
            2,
            "give either --left, --right and --board, or --corners",
        ),
        (["--corners", "{turn}/corners.npz", "--preprocess"], 2, "belong to images"),
        (
            ["--corners", "{turn}/corners.npz"],
            3,
            "holds rectangles of turning cameras; calibrator 'drl' works from a board",
        ),
        (["--corners", "{turn}/corners.npz", "--calibrator", "rectangles"], 2, "needs a prior"),
        (
            ["--left", "a", "--right", "b", "--board", "chessboard:9x6:3mm", "--calibrator", "rectangles"],
            2,
            "works from rectangles in a file: give --corners FILE",
        ),
        (
            ["--corners", "{turn}/truth.json", "--calibrator", "rectangles", "--prior", "{turn}/rig.json"],
            3,
            "not a whole NumPy archive",
        ),
        (
            ["--left", "a", "--right", "b", "--board", "chessboard:9x6:3mm", "--calibrator", "opencv", "--skew"],
            2,
            "skew",
        ),
    ],
)
def test_what_does_not_suit_is_one_line(turned, tmp_path, capsys, arguments, code, text):
    arguments = [a.format(turn=turned) for a in arguments]
    assert main(["calibrate", *arguments, "--output", str(tmp_path / "rig.json")]) == code
    error = capsys.readouterr().err
    assert text in error and len(error.strip().splitlines()) == 1
    assert not (tmp_path / "rig.json").exists()


def test_a_turning_rig_shows_no_board(tmp_path, capsys):
    arguments = ["simulate", "--rig", "turning", "--pairs", "2", "--board", "chessboard:9x6:3mm"]
    assert main([*arguments, "--output", str(tmp_path / "x")]) == 2
    assert "leave out --board" in capsys.readouterr().err
