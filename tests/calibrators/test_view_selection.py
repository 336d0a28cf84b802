from __future__ import annotations

import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.calibrators import CalibrationRequest, calibrate
from binocal.calibrators.view_selection import choose_greedily, depth_target, select_views
from binocal.errors import TooFewViewsError
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig
from binocal.simulation.corruptions import drop_view, flip_view, mismatch_pair

BOARD = parse_board("chessboard:11x8:20mm")


def recording(n_views, seed=0):
    rng = np.random.default_rng(seed)
    rig = table2_rig()
    scene = StereoScene(rig, BOARD, sample_board_poses(rig, BOARD, n_views, rng))
    return rig, simulate_detections(scene, rng, noise_px=0.2)


def depth_sigma(calibration, rig):
    """Relative depth error that a calibration's own covariance predicts; its translation is stepped additively."""
    to_additive = np.eye(len(calibration.covariance.names))
    x, y, z = calibration.rig.T_right_left.t
    to_additive[-3:, -6:-3] = -np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    back = np.linalg.inv(to_additive)
    target = depth_target(rig, 0.4)
    return float(np.sqrt(np.trace(target @ back @ calibration.covariance.matrix @ back.T)))


def test_chosen_views_determine_depth_better_than_the_first_ones():
    rig, detections = recording(150)
    selection = select_views(detections, CalibrationRequest("brown4", max_views=15))
    assert len(selection.views) == 15 and (np.diff(selection.views) > 0).all()
    chosen = depth_sigma(calibrate(detections.select(selection.views), model="brown4"), rig)
    first = depth_sigma(calibrate(detections.select(np.arange(15)), model="brown4"), rig)
    everything = depth_sigma(calibrate(detections, model="brown4"), rig)
    assert everything < chosen < 0.85 * first  # measured 0.63
    ratio = selection.depth_sigma / selection.all_depth_sigma
    assert ratio == pytest.approx(chosen / everything, rel=0.25)
    assert "15 of 150 views" in selection.sentence() and f"({ratio:.2f} times)" in selection.sentence()


def test_all_views_cost_nothing():
    _, detections = recording(12)
    selection = select_views(detections, CalibrationRequest("brown4", max_views=50))
    assert (selection.views == np.arange(12)).all()
    assert selection.depth_sigma == pytest.approx(selection.all_depth_sigma)


def test_contradicting_and_empty_views_are_passed_over():
    _, detections = recording(60)
    spoiled = drop_view(mismatch_pair(flip_view(detections, 7), 20, 50), 33, side="left")
    selection = select_views(spoiled, CalibrationRequest("brown4", max_views=40))
    assert not set(selection.views) & {33} and "20" in selection.misfits
    assert "passed over" in selection.sentence()


def test_greedy_choice_takes_what_is_missing():
    x, y = np.diag([1.0, 0.0]), np.diag([0.0, 0.5])
    information = np.stack([x, x, y, x])
    chosen = choose_greedily(information, 1e-3 * np.eye(2), np.eye(2), 2)
    assert 2 in chosen and len(set(chosen.tolist())) == 2


def test_too_few_views():
    _, detections = recording(6)
    with pytest.raises(ValueError, match="at least 3"):
        CalibrationRequest(max_views=2)
    blind = detections
    for view in range(4):
        blind = drop_view(blind, view, side="right")
    with pytest.raises(TooFewViewsError):
        select_views(blind, CalibrationRequest(max_views=4))
