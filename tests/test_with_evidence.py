"""From rig.json and the corners as detected, without images: the calibration as it was, recheck, another model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import binocal
from binocal.boards import parse_board
from binocal.errors import DataError
from binocal.evidence.right_poses import MOST_OFF_BALANCE, imbalance_of_deviations
from binocal.geometry import SE3, so3
from binocal.metrics.image import pixel_error
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig
from binocal.simulation.corruptions import drop_view, flip_view, mismatch_pair
from rigs import assert_same_detections

BOARD = parse_board("chessboard:11x8:20mm")


def corners(n_views=10, seed=0, **noise):
    rng = np.random.default_rng(seed)
    rig = table2_rig()
    scene = StereoScene(rig, BOARD, sample_board_poses(rig, BOARD, n_views, rng))
    return simulate_detections(scene, rng, **{"noise_px": 0.2, **noise})


def spoiled(seed=0):
    """Two views turned, one of a mismatched pair, one that a camera did not see, corners missing and wild."""
    detections = corners(seed=seed, outlier_share=0.01, outlier_px=10.0)
    detections = flip_view(flip_view(detections, 2, side="left"), 5, side="right")
    detections = drop_view(mismatch_pair(detections, 7, 8), 4, side="left")
    left = detections.left_px.copy()
    left[3, :6] = np.nan
    left[2, 10:12] = np.nan
    covariance = np.broadcast_to(np.diag([0.04, 0.05]), (*left.shape, 2)).copy()
    covariance *= 1 + 0.1 * np.random.default_rng(seed).random(left.shape)[..., :1, None]
    return replace(detections, left_px=left, left_covariance_px2=covariance, right_covariance_px2=covariance)


def saved(tmp_path, detections, **choices):
    """The calibration, and what a later process has of it: rig.json and corners."""
    calibration = binocal.calibrate(detections, **{"model": "brown4", **choices})
    binocal.write_calibration(tmp_path / "rig.json", calibration)
    binocal.write_detections(tmp_path / "corners.npz", detections)
    return (
        calibration,
        binocal.read_calibration(tmp_path / "rig.json"),
        binocal.read_detections(tmp_path / "corners.npz"),
    )


@pytest.mark.parametrize("make", [corners, spoiled])
@pytest.mark.parametrize("calibrator", ["drl", "lm"])
def test_the_calibration_is_as_good_as_new(tmp_path, make, calibrator):
    made, read, detections = saved(tmp_path, make(), calibrator=calibrator)
    whole = read.with_evidence(detections)
    if make is spoiled:
        assert any(view.left_order for view in made.views) or any(view.right_order for view in made.views)
        assert made.rejected
    assert_same_detections(whole.evidence.detections, made.evidence.detections)
    np.testing.assert_array_equal(whole.evidence.T_left_board.R, made.evidence.T_left_board.R)
    np.testing.assert_array_equal(whole.evidence.T_left_board.t, made.evidence.T_left_board.t)
    assert whole.evidence.misfit_px == made.evidence.misfit_px


def test_every_later_step_runs_without_images(tmp_path):
    made, read, detections = saved(tmp_path, spoiled())
    whole = read.with_evidence(detections)
    again = binocal.calibrate(detections, model="brown4")
    assert np.array_equal(again.rig.T_right_left.t, made.rig.T_right_left.t)
    assert np.array_equal(again.covariance.matrix, made.covariance.matrix)
    other = binocal.calibrate(detections, model="brown5")
    assert other.rig.left.model == "brown5" and [v.name for v in other.rejected] == [v.name for v in made.rejected]
    evaluated = pixel_error(whole.rig, whole.evidence.detections, whole.evidence.T_left_board)
    expected = pixel_error(made.rig, made.evidence.detections, made.evidence.T_left_board)
    np.testing.assert_array_equal(evaluated.view_rms_px, expected.view_rms_px)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda d: d.select(np.arange(9)), r"view 9 is missing \(1 of"),
        (lambda d: replace(d, names=("0",) * 10), "several views have one name"),
        (lambda d: replace(d, left_size_wh=(10, 10)), "left images are"),
        (lambda d: replace(d, is_metric=False), "only one of the board and the rig"),
        (lambda d: replace(d, right_px=d.right_px + 0.01), "from its prediction"),
        (lambda d: d.reorder("left", {3: np.arange(88)[::-1]}), "left view 3 is"),
        (lambda d: drop_view(d, 6, side="left"), "view 6 has 88 corners instead of 176"),
        (lambda d: d.select(np.array([1, 0, 3, 2, 4, 5, 6, 7, 8, 9])), None),
    ],
)
def test_other_corners_are_refused(tmp_path, change, expected):
    made, read, detections = saved(tmp_path, corners())
    if expected is None:  # views are found by name
        assert_same_detections(read.with_evidence(change(detections)).evidence.detections, made.evidence.detections)
        return
    with pytest.raises(DataError, match=expected):
        read.with_evidence(change(detections))


def test_a_changed_pose_is_found_where_every_view_has_its_own_right_pose(tmp_path):
    """Residuals do not show it: the right poses, one a view, fit whatever R and T are."""
    rng = np.random.default_rng(4)
    detections = corners(noise_px=0.1)
    T_left_board = sample_board_poses(table2_rig(), BOARD, 10, np.random.default_rng(0))
    moved = SE3(so3.exp(rng.normal(0, 2e-3, (10, 3))) @ T_left_board.R, T_left_board.t + rng.normal(0, 5e-4, (10, 3)))
    later = simulate_detections(StereoScene(table2_rig(), BOARD, moved), rng, noise_px=0.1)
    detections = replace(detections, right_px=later.right_px)
    made, read, detections = saved(tmp_path, detections, calibrator="lm", exposure="apart")
    assert made.T_right_board is not None
    whole, used, T = read.with_evidence(detections), made.T_left_board, made.rig.T_right_left
    off = imbalance_of_deviations(T, used, made.T_right_board, BOARD.object_points_m.mean(axis=0))
    assert whole.evidence is not None and off < 0.5 * MOST_OFF_BALANCE  # measured: 0.02
    for turn_deg, shift_m in (([0.1, 0, 0], [0, 0, 0]), ([0, 0, 0.2], [0, 0, 0]), ([0, 0, 0], [0, 1e-3, 0])):
        changed = SE3(so3.exp(np.radians(turn_deg)) @ T.R, T.t + np.array(shift_m))
        edited = replace(read, rig=replace(read.rig, T_right_left=changed))
        with pytest.raises(DataError, match=r"R and T are not those of the calibration.*changed after"):
            edited.with_evidence(detections)
        held = replace(edited, provenance={**edited.provenance, "options": {"prior": {"held": ["rotation"]}}})
        assert held.with_evidence(detections).evidence is not None  # a prior may pull R and T anywhere


def test_a_file_without_board_poses_says_so():
    calibration = binocal.calibrate(corners(), model="brown4")
    bare = replace(calibration, evidence=None, T_left_board=None)
    with pytest.raises(DataError, match="board poses"):
        bare.with_evidence(corners())


def test_a_calibrator_that_changes_corners_is_found_out():
    detections = corners()
    with pytest.raises(ValueError, match=r"left view 1: its corners are not those"):
        binocal.evidence.changed_orders(
            detections, replace(detections, left_px=detections.left_px + (np.arange(10) == 1)[:, None, None])
        )
    with pytest.raises(ValueError, match="view new is not among"):
        binocal.evidence.changed_orders(detections, replace(detections, names=("new", *detections.names[1:])))
