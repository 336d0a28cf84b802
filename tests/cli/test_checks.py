"""The checks of ``binocal calibrate``: ten lines, coloured on a terminal alone, and in the document."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from binocal import app
from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.cli import main
from binocal.cli.checks import checks_text, show_checks
from binocal.findings import Severity, finding
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig
from binocal.validation.overview import CheckLine

LINES = (CheckLine("Fit", "RMS 0.1 px"), CheckLine("Rays", "1 % have\nnone", Severity.WARNING, ("lens-model-folds",)))
SPEC = "chessboard:6x5:30mm"
CALIBRATE = ["calibrate", "--left", "l/*.png", "--right", "r/*.png", "--board", SPEC]


def test_a_line_is_a_line():
    assert checks_text(LINES).splitlines() == ["Fit        ok       RMS 0.1 px", "Rays       warning  1 % have none"]


def test_colours_are_for_terminals(capsys, monkeypatch):
    show_checks(LINES)
    assert "\x1b" not in capsys.readouterr().out
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    show_checks(LINES)
    out = capsys.readouterr().out
    assert "warning" in out and "1 % have none" in out
    show_checks(())
    assert capsys.readouterr().out == ""


@pytest.fixture
def run(monkeypatch, tmp_path):
    rng, rig, board = np.random.default_rng(0), table2_rig(), parse_board(SPEC)
    scene = StereoScene(rig, board, sample_board_poses(rig, board, 10, rng))
    detections = simulate_detections(scene, rng, noise_px=0.1)
    made = app.CalibrationRun(
        calibrate(detections, model="brown4", calibrator="lm"), detections, elapsed_s={"images": 1.0, "solve": 0.1}
    )
    monkeypatch.setattr(app, "calibrate_images", lambda *given, **options: made)
    monkeypatch.chdir(tmp_path)
    return made


def test_calibrate_shows_ten_checks_unless_declined(run, capsys):
    assert main(CALIBRATE) == 0
    text = capsys.readouterr().out
    assert sum(line.split()[1:2] == ["ok"] for line in text.splitlines()) == 10
    assert main([*CALIBRATE, "--force", "--json"]) == 0
    document = json.loads(capsys.readouterr().out, parse_constant=lambda word: pytest.fail(word))
    assert [line["severity"] for line in document["checks"]] == ["ok"] * 10
    assert main([*CALIBRATE, "--force", "--no-checks"]) == 0
    assert "Halves" not in capsys.readouterr().out


def test_what_a_check_finds_wrong_joins_the_findings(run, capsys, monkeypatch):
    from binocal import validation
    from binocal.validation import ValidationReport

    figures = {"correlation": 0.4, "sigma": 0.01, "common_px": 0.1, "sigma_factor": 1.0, "worst_point_px": 0.1}
    found = ValidationReport((finding("residuals-correlated", **figures),))
    monkeypatch.setattr(validation, "validate", lambda *given: found)
    assert main(CALIBRATE) == 0
    text = capsys.readouterr().out
    assert text.startswith("warning: residuals of neighbouring corners correlate by 0.40")
    assert json.loads(Path("rig.json").read_text(encoding="utf-8"))["findings"][0]["code"] == "residuals-correlated"


def test_a_closed_stdout_is_no_traceback(monkeypatch):
    """``calibrate >&-`` ended with 47 lines; that stdout is closed is said at the end, by the one who flushes it."""
    monkeypatch.setattr(sys, "stdout", None)
    show_checks(LINES)
