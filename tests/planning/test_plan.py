"""Plans: the views that they ask for can be seen, and help as predicted."""

from dataclasses import replace

import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.geometry import SE3
from binocal.planning import plan_views
from binocal.planning.candidates import information_of_views
from binocal.requirements import figure_of_calibration, parse_requirement
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig
from binocal.solvers.covariance import cramer_rao_bound

RIG, BOARD, NOISE_PX = table2_rig(), parse_board("chessboard:6x5:30mm"), 0.1
NEED = parse_requirement("depth 1% at 2m")


def calibrated(poses, seed):
    detections = simulate_detections(StereoScene(RIG, BOARD, poses), np.random.default_rng(seed), noise_px=NOISE_PX)
    return calibrate(detections, model="brown4", calibrator="lm")


def joined(a, b):
    return SE3(np.concatenate([a.R, b.R]), np.concatenate([a.t, b.t]))


@pytest.fixture(scope="module")
def first():
    return sample_board_poses(RIG, BOARD, 6, np.random.default_rng(0))


@pytest.fixture(scope="module")
def calibration(first):
    return calibrated(first, 1)


def test_views_add_up_to_the_bound(first):
    bound = cramer_rao_bound(RIG, BOARD.object_points_m, first, NOISE_PX)
    information = information_of_views(RIG, BOARD.object_points_m, first, bound.names).sum(axis=0) / NOISE_PX**2
    np.testing.assert_allclose(np.sqrt(np.diag(np.linalg.inv(information))), list(bound.sigma.values()), rtol=1e-4)


def test_planned_views_reach_what_is_predicted_and_beat_ordinary_ones(first, calibration):
    plan = plan_views(calibration, BOARD, NEED, n_views=4)
    assert len(plan.views) == 4 and plan.figure == pytest.approx(figure_of_calibration(calibration, NEED).value)
    figures = [view.figure for view in plan.views]
    assert figures == sorted(figures, reverse=True) and figures[-1] < 0.6 * plan.figure
    poses = SE3(np.stack([v.T_left_board.R for v in plan.views]), np.stack([v.T_left_board.t for v in plan.views]))
    reached = figure_of_calibration(calibrated(joined(first, poses), 2), NEED).value
    assert reached == pytest.approx(figures[-1], rel=0.15)  # measured: 5 to 95 % of 100 rigs within 8 %
    ordinary = [
        figure_of_calibration(
            calibrated(joined(first, sample_board_poses(RIG, BOARD, 4, np.random.default_rng(seed))), seed), NEED
        ).value
        for seed in range(5)
    ]
    assert reached < min(ordinary)


def test_every_planned_view_is_seen_whole_by_both_cameras_and_said_in_words(calibration):
    plan = plan_views(calibration, BOARD, NEED, n_views=6)
    for view in plan.views:
        scene = StereoScene(RIG, BOARD, SE3(view.T_left_board.R[None], view.T_left_board.t[None]))
        assert all(np.isfinite(px).all() for px in scene.project())
        depth = (view.T_left_board.apply(BOARD.object_points_m))[:, 2]
        centre = view.T_left_board.apply(BOARD.object_points_m.mean(axis=0)[None])[0]
        assert view.left_px == pytest.approx(RIG.left.project(centre[None])[0], abs=8)
        x, y = RIG.left.project(view.T_left_board.apply(BOARD.object_points_m)).T
        if "right" in view.away:
            assert np.corrcoef(x, depth)[0, 1] > 0
        if "bottom" in view.away:
            assert np.corrcoef(y, depth)[0, 1] > 0
    assert len({(round(v.left_px[0]), round(v.left_px[1]), round(v.tilt_deg)) for v in plan.views}) == 6


def test_a_plan_ends_where_the_need_is_met(calibration):
    figure = figure_of_calibration(calibration, NEED).value
    easy = plan_views(calibration, BOARD, replace(NEED, limit=0.7 * figure))
    assert easy.is_enough and 1 <= len(easy.views) <= 4 and not easy.why


def test_what_no_view_helps_is_said(calibration):
    matching = plan_views(calibration, BOARD, parse_requirement("depth 0.1% at 5m with 0.25px"))
    assert not matching.is_enough and "matching" in matching.why
    assert plan_views(calibration, BOARD, parse_requirement("reprojection 0.01px")).views == ()
    assert plan_views(calibration, parse_board("chessboard:6x5"), NEED).views == ()
    assert "nothing together" in plan_views(calibration, BOARD, parse_requirement("depth 1% at 1mm")).why
