"""One Newton step stands for the solve without a block of views, and its rows and lengths for those of the metrics."""

import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.calibrators.base import CalibrationRequest
from binocal.calibrators.left_out_views import blocks_of, left_out_errors
from binocal.calibrators.summary import joint_problem, rig_of
from binocal.metrics.image import length_error, rectified_row_error
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig
from binocal.solvers.board_views import BundleEstimate
from binocal.solvers.covariance import inliers
from binocal.solvers.minimization import minimize

BOARD = parse_board("chessboard:11x8:20mm")


@pytest.fixture(scope="module")
def case():
    rng = np.random.default_rng(4)
    scene = StereoScene(table2_rig(), BOARD, sample_board_poses(table2_rig(), BOARD, 12, rng))
    views = simulate_detections(scene, rng, noise_px=0.2)
    request = CalibrationRequest("brown4")
    problem = joint_problem(views, request)
    start = BundleEstimate.of_rig(scene.rig, scene.T_left_board)
    return views, request, problem, minimize(problem, start)


def test_blocks_are_neighbours_and_hold_every_view_once():
    for n_views in (6, 7, 40):
        block = blocks_of(n_views)
        assert len(block) == n_views and np.all(np.diff(block) >= 0) and set(block) == set(range(6))


def test_rows_and_lengths_are_those_of_a_solve_without_the_block(case):
    views, request, problem, minimum = case
    used = np.logical_and(*inliers(problem, minimum))
    found = left_out_errors(views, problem, minimum, used, (float(minimum.estimate.parameters[0][0]), 10.0))
    block = blocks_of(views.n_views)
    for k in (0, 3):
        train, test = np.flatnonzero(block != k), np.flatnonzero(block == k)
        few = views.select(train)
        estimate = BundleEstimate(
            minimum.estimate.parameters, minimum.estimate.T_left_board[train], minimum.estimate.T_right_left
        )
        again = minimize(joint_problem(few, request), estimate)
        rig = rig_of(again.estimate, few, "brown4")
        lengths = length_error(rig, views.select(test)).view_scale_percent / 100
        # lengths of 2e-4 to 1e-3, 2.5e-5 apart; rays off the axis have shorter rows in angles than in a rectified image
        assert found.lengths[test] == pytest.approx(lengths, abs=4e-5)
        rows = rectified_row_error(rig, views.select(test)).view_rms_px
        assert np.sqrt(np.nanmean(found.rows_px[test] ** 2, axis=1)) == pytest.approx(rows, rel=0.12)


def test_corners_that_do_not_count_are_not_measured_and_wild_ones_are_capped(case):
    views, _, problem, minimum = case
    used = np.logical_and(*inliers(problem, minimum))
    used[0], used[1, 3:] = False, False
    found = left_out_errors(views, problem, minimum, used, (1000.0, 0.01))
    assert np.isnan(found.rows_px[0]).all() and np.isnan(found.rows_px[1]).all() and np.isnan(found.lengths[:2]).all()
    assert np.nanmax(np.abs(found.rows_px)) == pytest.approx(5 * np.sqrt(2) * 0.01)
