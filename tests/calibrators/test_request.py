"""One request, one provenance: whatever the method and the model, and the command line's defaults are the library's."""

from __future__ import annotations

import inspect
from dataclasses import fields

import numpy as np
import pytest
import typer

from binocal.boards import parse_board
from binocal.calibrators import CalibrationRequest, calibrate, calibrate_as_requested
from binocal.cli.verbs import app
from binocal.errors import CancelledError
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig

BOARD = parse_board("chessboard:11x8:20mm")


def recording(n_views, seed=0):
    rng = np.random.default_rng(seed)
    rig = table2_rig()
    scene = StereoScene(rig, BOARD, sample_board_poses(rig, BOARD, n_views, rng))
    return simulate_detections(scene, rng, noise_px=0.2)


def test_defaults_of_library_and_command_line_are_the_same():
    library = {name: p.default for name, p in inspect.signature(calibrate).parameters.items()}
    command = {p.name: p.default for p in typer.main.get_command(app).commands["calibrate"].params}
    request = {field.name: field.default for field in fields(CalibrationRequest)}
    for name in ("model", "skew", "seed", "max_views"):
        assert library[name] == command[name] == request[name], name
    assert library["calibrator"] == command["calibrator"]


def test_the_most_telling_views_are_used_and_the_cost_is_stated():
    detections = recording(30)
    calibration = calibrate(detections, model="brown4", max_views=10)
    choice = calibration.provenance["view_choice"]
    assert len(calibration.views) == choice["max_views"] == 10 and choice["n_views"] == 30
    assert choice["depth_sigma"] > choice["all_depth_sigma"] > 0 and "10 of 30 views" in choice["reason"]
    every = calibrate(detections.select(np.arange(10)), model="brown4", max_views=10)
    assert len(every.views) == 10 and "view_choice" not in every.provenance


def test_provenance_says_who_made_it_and_from_what():
    request = CalibrationRequest("auto", seed=3, max_views=20)
    calibration = calibrate_as_requested(recording(8), request, calibrator="lm", inputs={"input_sha256": {"a": "0"}})
    p = calibration.provenance
    assert {"binocal", "python", "numpy", "platform", "corner_weights", "model_choice"} <= set(p)
    assert p["calibrator"] == "lm" and p["seed"] == 3 and p["input_sha256"] == {"a": "0"}
    assert p["options"] == {"model": "auto", "skew": False, "max_views": 20}
    assert p["model"] == calibration.rig.left.model == p["model_choice"]["model"]


@pytest.mark.parametrize(("model", "max_views"), [("brown4", None), ("auto", None), ("brown4", 6)])
def test_progress_runs_to_its_end_and_every_step_can_be_the_last(model, max_views):
    detections, seen = recording(8), []
    calibrate(detections, model=model, max_views=max_views, progress=lambda *step: seen.append(step))
    last = {what: (done, total) for what, done, total in seen}
    assert last and all(done == total for done, total in last.values())
    for n_asked in range(3):
        answers = iter([False] * n_asked + [True])
        with pytest.raises(CancelledError):
            calibrate(detections, model=model, max_views=max_views, should_stop=lambda answers=answers: next(answers))


def test_an_unknown_choice_is_named():
    detections = recording(4)
    with pytest.raises(ValueError, match="brown9"):
        calibrate(detections, model="brown9")
    with pytest.raises(ValueError, match="no option 'turbo'"):
        calibrate(detections, model="brown4", options={"turbo": True})
    with pytest.raises(ValueError, match="at least 3 views"):
        calibrate(detections, max_views=2)
    with pytest.raises(TypeError, match="Detections"):
        calibrate("corners.npz", model="brown4")
