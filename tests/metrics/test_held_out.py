"""Criteria on exact views: zero for the true rig, about the bound for rigs scattered by the bound."""

import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.metrics.held_out import criteria_on_exact_views, draw_rigs
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig
from binocal.solvers.covariance import cramer_rao_bound

pytestmark = pytest.mark.usefixtures("many_calls")


@pytest.fixture(scope="module")
def scene_and_bound():
    rng = np.random.default_rng(0)
    rig, board = table2_rig(), parse_board("chessboard:11x8:20mm")
    poses = sample_board_poses(rig, board, 12, rng)
    return StereoScene(rig, board, poses), cramer_rao_bound(rig, board.object_points_m, poses, 0.1)


def test_the_true_rig_has_no_error_and_the_bound_is_stated(scene_and_bound):
    scene, bound = scene_and_bound
    exact = simulate_detections(scene, np.random.default_rng(1))
    criteria = criteria_on_exact_views(
        scene.rig, exact, scene.T_left_board, 0.02, (scene.rig, bound), np.random.default_rng(2)
    )
    assert [c.name for c in criteria] == ["pixel error (eq. 19)", "rectified row error", "relative length error"]
    for criterion in criteria:
        assert criterion.value < 1e-7 < criterion.bound


@pytest.mark.slow
def test_a_rig_from_the_bound_scores_about_one(scene_and_bound):
    scene, bound = scene_and_bound
    exact = simulate_detections(scene, np.random.default_rng(1))
    ratios = []
    for rig in draw_rigs(scene.rig, bound, 8, np.random.default_rng(3)):
        criteria = criteria_on_exact_views(
            rig, exact, scene.T_left_board, 0.02, (scene.rig, bound), np.random.default_rng(2)
        )
        ratios.append([c.ratio for c in criteria])
    assert np.all(
        (np.sqrt(np.mean(np.square(ratios), axis=0)) > 0.5) & (np.sqrt(np.mean(np.square(ratios), axis=0)) < 1.6)
    )


def test_without_a_bound_the_ratio_is_not_a_number(scene_and_bound):
    scene, _ = scene_and_bound
    exact = simulate_detections(scene, np.random.default_rng(1))
    criteria = criteria_on_exact_views(scene.rig, exact, scene.T_left_board, 0.02, None, np.random.default_rng(2))
    assert all(np.isnan(c.bound) and np.isnan(c.ratio) for c in criteria)


@pytest.mark.slow
def test_drawn_rigs_have_the_covariance(scene_and_bound):
    scene, bound = scene_and_bound
    rigs = draw_rigs(scene.rig, bound, 2000, np.random.default_rng(4))
    t = np.array([r.T_right_left.t - scene.rig.T_right_left.t for r in rigs])
    expected = [bound.sigma[f"translation.{axis}"] for axis in "xyz"]
    assert t.std(axis=0) == pytest.approx(expected, rel=0.06)


def test_few_drawn_rigs_have_exactly_the_covariance(scene_and_bound):
    scene, bound = scene_and_bound
    rigs = draw_rigs(scene.rig, bound, 40, np.random.default_rng(4))
    t = np.array([r.T_right_left.t - scene.rig.T_right_left.t for r in rigs])
    expected = [bound.sigma[f"translation.{axis}"] for axis in "xyz"]
    assert np.sqrt(np.mean(t**2, axis=0)) == pytest.approx(expected, rel=1e-6)
    assert np.abs(t.mean(axis=0)).max() < 1e-9 * max(expected)
    assert len(draw_rigs(scene.rig, bound, 3, np.random.default_rng(4))) == 3
