from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest

from binocal import app
from binocal.boards import parse_board
from binocal.errors import DataError, OutputExistsError, TooFewViewsError
from binocal.formats import rig_json
from binocal.geometry import SE3
from binocal.metrics.pose import scaled
from fakes import FakePackages
from rigs import make_calibration, make_poses, make_rig

BOARD = parse_board("chessboard:11x8:10mm")


@pytest.fixture
def fakes(monkeypatch):
    return FakePackages(monkeypatch)


@pytest.fixture
def truth(fakes):
    return rig_json.Truth(fakes.rig, BOARD, fakes.detections.names, fakes.poses, 3.0, 0.8)


def test_a_calibration_says_what_became_of_every_file(fakes):
    seen = []
    request = app.CalibrationRequest("brown4", seed=7, progress=lambda *step: seen.append(step))
    run = app.calibrate_images("l", "r", BOARD, request, preprocess=True)
    assert fakes.calls["list_pairs"] == ("l", "r") and fakes.calls["preprocess"] is True
    assert fakes.calls["calibrate"] is request and fakes.calls["calibrator"] == "drl"
    assert run.calibration.rejected == fakes.rejected and run.ignored == (("left99 copy.png", "a copy of left99.png"),)
    provenance = run.calibration.provenance
    assert provenance["iterations"] == 5 and provenance["seed"] == 7 and provenance["board"] == "chessboard:11x8:10mm"
    assert len(provenance["input_sha256"]["left"]) == 64 and seen == [("finding corners", 6, 6)]


def test_what_a_choice_of_views_costs_is_noted(fakes):
    choose = fakes.calibrate
    fakes.calibrate = lambda *given: replace(choose(*given), provenance={"view_choice": {"reason": "3 of 6 views"}})
    run = app.calibrate_images("l", "r", BOARD, app.CalibrationRequest("brown4", max_views=3))
    assert run.notes[-1] == "3 of 6 views."


def test_an_error_carries_what_was_dropped_before_it(fakes):
    def too_few(*_, **__):
        raise TooFewViewsError(2, 3, {"05": "mismatched pair"})

    fakes.calibrate = too_few
    with pytest.raises(TooFewViewsError) as caught:
        app.calibrate_images("l", "r", BOARD)
    assert caught.value.rejected == {"07": "no board found in the right image", "05": "mismatched pair"}
    assert caught.value.__notes__ == [
        "ignored left99 copy.png: a copy of left99.png",
        "note: left and right images differ in size",
    ]


def test_a_simulation_is_repeatable_and_complete(fakes, tmp_path):
    truths = [app.simulate(make_rig(), BOARD, 3, tmp_path / name, app.SimulateOptions(seed=5)) for name in "ab"]
    names = sorted(os.listdir(tmp_path / "a"))
    assert names == [*(f"{side}_{i:02d}.png" for side in ("left", "right") for i in range(3)), "truth.json"]
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    assert sorted(os.listdir(tmp_path)) == ["a", "b"]
    np.testing.assert_array_equal(
        rig_json.read_truth(tmp_path / "a" / "truth.json").T_left_board.t, truths[0].T_left_board.t
    )
    other = app.simulate(make_rig(), BOARD, 3, tmp_path / "c", app.SimulateOptions(seed=6))
    assert np.abs(other.T_left_board.t - truths[0].T_left_board.t).max() > 1e-4


def test_an_interrupted_simulation_leaves_nothing(fakes, tmp_path, monkeypatch):
    def interrupt(stage, done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        app.simulate(make_rig(), BOARD, 3, tmp_path / "out", progress=interrupt)
    assert os.listdir(tmp_path) == []


def test_force_replaces_the_old_images_and_nothing_else(fakes, tmp_path):
    out = tmp_path / "out"
    app.simulate(make_rig(), BOARD, 4, out)
    (out / "mine.txt").write_text("keep")
    with pytest.raises(OutputExistsError):
        app.simulate(make_rig(), BOARD, 2, out)
    app.simulate(make_rig(), BOARD, 2, out, force=True)
    assert sorted(os.listdir(out)) == [
        "left_00.png",
        "left_01.png",
        "mine.txt",
        "right_00.png",
        "right_01.png",
        "truth.json",
    ]


def test_a_board_without_a_size_is_not_simulated(fakes, tmp_path):
    with pytest.raises(ValueError, match="needs its size"):
        app.simulate(make_rig(), parse_board("chessboard:11x8"), 3, tmp_path / "out")
    with pytest.raises(ValueError, match="nothing to render"):
        app.simulate(make_rig(), BOARD, 0, tmp_path / "out")


@pytest.fixture
def few_bound_rigs(monkeypatch):
    """The criteria's bound from four rigs: what it is worth is tested in tests/metrics."""
    monkeypatch.setattr("binocal.metrics.held_out.N_BOUND_RIGS", 4)


@pytest.mark.usefixtures("few_bound_rigs")
def test_the_truth_is_met_with_the_bound_of_the_views_used(fakes, truth):
    calibration = app.calibrate_images("l", "r", BOARD).calibration
    used = replace(calibration, views=calibration.views[:4])
    evaluation = app.evaluate_truth(used, truth)
    assert evaluation.comparison.rotation_error_deg == 0 and evaluation.comparison.has_bound
    assert fakes.calls["bound"] == {"n_views": 4, "noise_px": 0.08, "n_seen": 4 * 88} and evaluation.noise_px == 0.08
    strangers = replace(calibration, views=tuple(replace(view, name="x") for view in calibration.views))
    assert "no view of the calibration" in app.evaluate_truth(strangers, truth).notes[0]
    fisheye = replace(calibration, rig=make_rig("fisheye4"))
    assert "cannot say" in app.evaluate_truth(fisheye, truth).notes[0]


@pytest.mark.usefixtures("few_bound_rigs")
@pytest.mark.parametrize("kind", ["one view", "parallel views"])
def test_a_truth_whose_views_determine_nothing_has_no_bound(kind):
    n_views = 1 if kind == "one view" else 3
    calibration = make_calibration(n_views=n_views)
    poses = make_poses(1, np.random.default_rng(0))
    R = poses.R if kind == "one view" else np.eye(3)[None]
    poses = SE3(np.repeat(R, n_views, axis=0), np.repeat(poses.t, n_views, axis=0))
    names = tuple(view.name for view in calibration.views)
    truth = rig_json.Truth(make_rig(), parse_board("chessboard:11x8:10mm"), names, poses)
    evaluation = app.evaluate_truth(calibration, truth)
    assert not evaluation.comparison.has_bound and "no bound: the truth's views" in evaluation.notes[0]


def test_a_rig_in_pitches_is_scaled_by_the_truths_board(fakes, truth):
    calibration = app.calibrate_images("l", "r", BOARD).calibration
    in_pitches = replace(calibration, rig=replace(scaled(fakes.rig, 100.0), is_metric=False))
    evaluation = app.evaluate_truth(in_pitches, truth)
    assert evaluation.comparison.translation_error_mm < 1e-9 and "board pitches" in evaluation.notes[0]


def test_a_rig_is_compared_with_the_truth_of_a_scene(fakes, truth):
    calibration = app.calibrate_images("l", "r", BOARD).calibration
    of_scene = replace(truth, board=None, scene="street")
    evaluation = app.evaluate_truth(calibration, of_scene)
    assert evaluation.comparison.translation_error_mm < 1e-9 and not evaluation.comparison.has_bound
    assert evaluation.criteria == () and "no board" in evaluation.notes[0]
    in_baselines = replace(calibration, rig=replace(scaled(fakes.rig, 1 / fakes.rig.baseline_m), is_metric=False))
    evaluation = app.evaluate_truth(in_baselines, of_scene)
    assert evaluation.comparison.translation_error_mm < 1e-9 and "truth's baseline" in evaluation.notes[0]


def test_images_are_evaluated_without_truth(fakes):
    evaluation = app.evaluate_images(fakes.rig, "l", "r", BOARD)
    assert evaluation.pixel_error.all_px < 1e-9 and evaluation.length_error.scale_rms_percent < 1e-7
    assert evaluation.row_error.rms_px < 1e-6 and evaluation.rejected == fakes.rejected


def test_images_are_evaluated_on_the_board_as_measured(fakes):
    larger = scaled(fakes.rig, 1.01)
    evaluation = app.evaluate_images(larger, "l", "r", BOARD, measured_m=(1.01 * 0.12, 1.01 * 0.09))
    assert evaluation.pixel_error.all_px < 1e-9 and evaluation.length_error.scale_rms_percent < 1e-7
    nominal = app.evaluate_images(larger, "l", "r", BOARD).length_error
    assert nominal.scale_rms_percent == pytest.approx(1.0, rel=0.02)
    with pytest.raises(DataError, match="A-C measures 120mm and should have 90mm"):
        app.evaluate_images(larger, "l", "r", BOARD, measured_m=(0.12, 0.12))


def test_a_view_without_a_pose_is_left_out_of_the_pixel_error(fakes):
    left, right = fakes.detections.left_px.copy(), fakes.detections.right_px.copy()
    left[1], right[1] = np.nan, np.nan
    fakes.detections = replace(fakes.detections, left_px=left, right_px=right)
    evaluation = app.evaluate_images(fakes.rig, "l", "r", BOARD)
    assert np.isnan(evaluation.pixel_error.view_rms_px).tolist() == [False, True] + 4 * [False]
    assert evaluation.pixel_error.n_corners == 5 * 2 * 88 and evaluation.length_error.n_views == 5


def test_a_suspect_view_is_left_out_by_name_and_several_are_named(fakes):
    noisy = fakes.detections.right_px + 0.02 * np.random.default_rng(0).standard_normal(fakes.detections.right_px.shape)
    right = noisy.copy()
    right[2] += 3.0
    fakes.detections = replace(fakes.detections, right_px=right)
    evaluation = app.evaluate_images(fakes.rig, "l", "r", BOARD)
    assert [(view.name, view.code) for view in evaluation.rejected[1:]] == [("2", "view-mismatched")]
    assert evaluation.names == ("0", "1", "3", "4", "5") and evaluation.pixel_error.all_px < 0.03
    right[4] += 3.0  # two of six: the rig may be what is wrong
    fakes.detections = replace(fakes.detections, right_px=right)
    evaluation = app.evaluate_images(fakes.rig, "l", "r", BOARD)
    named = [note.split(":")[0] for note in evaluation.notes if "may not belong together" in note]
    assert named == ["view 2", "view 4"] and len(evaluation.names) == 6 and evaluation.pixel_error.all_px > 0.5


def test_a_view_of_more_noise_is_named_and_stays(fakes):
    rng, sigma_px = np.random.default_rng(0), np.full((6, 1, 1), 0.02)
    sigma_px[2] = 0.6  # blurred: each camera alone fits no better than both
    left, right = (
        px + sigma_px * rng.standard_normal(px.shape) for px in (fakes.detections.left_px, fakes.detections.right_px)
    )
    fakes.detections = replace(fakes.detections, left_px=left, right_px=right)
    evaluation = app.evaluate_images(fakes.rig, "l", "r", BOARD)
    assert len(evaluation.names) == 6 and evaluation.rejected == fakes.rejected
    assert any(note.startswith("view 2:") for note in evaluation.notes)


def test_units_and_sizes_must_agree(fakes):
    with pytest.raises(DataError, match="give the board's length a unit"):
        app.evaluate_images(fakes.rig, "l", "r", parse_board("chessboard:11x8"))
    fakes.detections = replace(fakes.detections, right_size_wh=(640, 480))
    with pytest.raises(DataError, match="right images are 640x480, the rig's right camera is 1280x960"):
        app.evaluate_images(fakes.rig, "l", "r", BOARD)


def test_the_demonstration_compares_both_boards(fakes, tmp_path):
    fakes.poses = make_poses(6, np.random.default_rng(0))
    cases = app.demo(tmp_path / "demo", n_pairs=6)
    assert [case.name for case in cases] == ["10mm", "20mm"]
    for case in cases:
        assert {"rig.json", "truth.json", "left_00.png", "right_05.png"} <= set(os.listdir(case.folder))
        assert (
            case.evaluation.comparison.parameter_accuracy_percent == 100
            and max(criterion.value for criterion in case.evaluation.criteria) < 1e-6
        )
    with pytest.raises(OutputExistsError):
        app.demo(tmp_path / "demo", n_pairs=6)


def test_the_bound_of_cameras_of_two_kinds_weighs_each_by_its_own_noise():
    from binocal.app.evaluate import _weights_of_cameras
    from binocal.result import ResidualSummary

    made = replace(make_calibration(make_rig()), noise_px=0.1)
    alike = replace(made, rms=ResidualSummary(0.14, 0.16, 0.15))
    assert _weights_of_cameras(alike, (2, 5)) is None
    weights = _weights_of_cameras(replace(made, rms=ResidualSummary(0.1, 0.4, 0.3)), (2, 5))
    a, b = weights.left, weights.right
    assert a.shape == (2, 3, 5) and not a[:, 1].any() and not b[:, 1].any()
    assert np.allclose(a[:, [0, 2]] / b[:, [0, 2]], 4.0)  # four times the noise
    assert np.allclose((a[0, 0, 0] ** 2 + b[0, 0, 0] ** 2) / 2, 1.0)  # the unit is the mean information
