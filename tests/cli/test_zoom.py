"""``calibrate --zoom`` and ``simulate --rig zoom``: the plumbing; the images are stood in for by their corners."""

from __future__ import annotations

import json

import numpy as np
import pytest

import binocal
from binocal.app.corners import FoundCorners
from binocal.cli import main
from binocal.result import RejectedView
from contracts import make_zoom_corners

BOARD = "chessboard:11x8:20mm"


@pytest.fixture
def listed(tmp_path, monkeypatch):
    """A list of five settings whose images show what the simulator says."""
    corners = make_zoom_corners()
    lines = [f"{setting:g},s{i}/l*.png,s{i}/r*.png" for i, setting in enumerate(corners.settings.tolist())]
    path = tmp_path / "settings.csv"
    path.write_text("setting,left,right\n" + "\n".join(lines) + "\n")

    def find(left, right, board, preprocess, progress, should_stop, least_pairs=0):
        number = int(left.rsplit("/", 2)[1][1:])
        assert right == str(tmp_path / f"s{number}" / "r*.png") and least_pairs == 3
        rejected = (RejectedView("9", "blurred"),) if number == 1 else ()
        return FoundCorners(corners.detections[number], rejected, (), ("a note",) * (number == 2), {})

    monkeypatch.setattr("binocal.app.zoom.find_corners", find)
    return path


def test_from_a_list_of_settings_to_the_rig_at_one(listed, tmp_path, capsys):
    arguments = ["calibrate", "--zoom", listed, "--board", BOARD, "--calibrator", "zoom", "--at", "20"]
    arguments += ["--model", "brown4", "--output", tmp_path / "rig.json", "--json"]
    assert main([str(a) for a in arguments]) == 0
    out, err = capsys.readouterr()
    document = json.loads(out)
    assert document["provenance"]["zoom"]["setting"] == 20
    assert document["provenance"]["zoom"]["settings"] == [10, 20, 30, 40, 50]
    assert document["rejected"][0]["name"] == "20/9" and "zoom setting 30: a note" in err
    rig = binocal.read_calibration(tmp_path / "rig.json").rig
    assert 1600 * 4**0.25 * 0.9 < rig.left.parameters[0] < 1600 * 4**0.25 * 1.1


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--zoom", "{csv}", "--board", BOARD, "--calibrator", "zoom", "--at", "60"], "outside of those calibrated"),
        (["--zoom", "{csv}", "--board", BOARD], "belong together"),
        (["--zoom", "{csv}", "--calibrator", "zoom"], "goes with --board alone"),
        (["--zoom", "{csv}", "--board", BOARD, "--calibrator", "zoom", "--left", "a"], "goes with --board alone"),
        (["--left", "a", "--right", "b", "--board", BOARD, "--calibrator", "zoom"], "belong together"),
        (["--left", "a", "--right", "b", "--board", BOARD, "--at", "3"], "--at is a setting of --zoom"),
        (["--zoom", "{csv}", "--board", BOARD, "--calibrator", "zoom", "--skew"], "knows no skew"),
    ],
)
def test_what_does_not_suit_is_one_line(listed, tmp_path, capsys, arguments, text):
    arguments = [a.format(csv=listed) for a in arguments]
    assert main(["calibrate", *arguments, "--model", "brown4", "--output", str(tmp_path / "rig.json")]) == 2
    error = capsys.readouterr().err
    assert text in error and len([line for line in error.splitlines() if "binocal:" in line]) == 1


def test_the_simulator_writes_a_list_that_is_read(tmp_path, monkeypatch, capsys):
    made = []

    def stand_in(rig, board, n_pairs, output, options, *, force=False, progress=None):
        made.append((rig.left.parameters[0], options.seed))
        output.mkdir()

    monkeypatch.setattr("binocal.app.zoom.simulate", stand_in)
    folder = tmp_path / "z"
    arguments = ["simulate", "--rig", "zoom", "--board", BOARD, "--pairs", "2", "--output", str(folder), "--seed", "5"]
    assert main(arguments) == 0
    from binocal.formats.zoom_csv import read_zoom_settings

    rows = read_zoom_settings(folder / "settings.csv")
    assert len(rows) == len(made) == 13 and [seed for _, seed in made] == list(range(5, 18))
    assert np.all(np.diff([focal for focal, _ in made]) > 0) and made[-1][0] == pytest.approx(6400, rel=0.05)
    assert rows[3].left == str(folder / "setting_03" / "left_*.png")
    assert "13 zoom settings" in capsys.readouterr().out
    assert main([*arguments[:3], "--pairs", "2", "--output", str(tmp_path / "y")]) == 2
    assert "shows a board" in capsys.readouterr().err
