"""Solves that compete: the lowest cost wins, within the old rig's bounds and in front of the cameras."""

from __future__ import annotations

import numpy as np
import pytest

from binocal.geometry import so3
from binocal.rl.match_batches import MATCH_SETS, sample_matches, sample_starts
from binocal.solvers.arrays import take_rigs
from binocal.solvers.chosen_scale import CHOSEN_SCALE
from binocal.solvers.epipolar import EpipolarProblem, Rays
from binocal.solvers.portfolio import PORTFOLIO, compete, cost_beside, cost_of_seen, is_near
from binocal.solvers.relative_pose import RelativePose
from streets import T_RIGHT_LEFT, cameras, street

TRUTH = RelativePose.of(T_RIGHT_LEFT)


@pytest.fixture(scope="module")
def problem():
    return EpipolarProblem.of_matches(cameras(), street(np.random.default_rng(0), cameras(), 200, 0.2, wrong=0.2))[0]


def test_one_problem_may_be_asked_for_many_poses(problem):
    steps = np.radians(np.random.default_rng(1).normal(0, 0.5, (4, 5)))
    poses = RelativePose(np.tile(TRUTH.R, (4, 1, 1)), np.tile(TRUTH.t, (4, 1))).stepped(steps)
    together = problem.linearize(poses, np.full(4, 2.0), "geman")
    for i in range(4):
        one = problem.linearize(take_rigs(poses, i), np.asarray(2.0), "geman")
        np.testing.assert_allclose(together.jacobian[i], one.jacobian, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(together.cost_px2[i], one.cost_px2)
        np.testing.assert_allclose(TRUTH.stepped(steps[i]).R, poses.R[i], atol=1e-12)
        np.testing.assert_allclose(TRUTH.step_to(take_rigs(poses, i)), steps[i], atol=1e-9)


def test_the_lowest_cost_wins_and_equal_ones_agree(problem):
    old = TRUTH.stepped(np.radians([1.0, -1.0, 0.5, 2.0, 1.0]))
    far = TRUTH.stepped(np.radians([3.0, 3.0, 0.0, 0.0, 0.0]))
    contest = compete(problem, old, PORTFOLIO, {"elsewhere": far})
    assert contest.names == (*PORTFOLIO, "elsewhere")
    assert contest.winner == 0 and contest.n_agreeing >= 4
    np.testing.assert_allclose(np.degrees(so3.angle_rad(contest.estimate.R @ TRUTH.R.T)), 0.0, atol=0.2)
    alone = contest.of(("elsewhere",))
    assert alone.costs[0] >= contest.costs.min()


def test_a_batch_has_a_winner_for_each():
    matches = sample_matches(MATCH_SETS["drift_easy"], 6, np.random.default_rng(2))
    old = sample_starts(matches, np.random.default_rng(3))
    contest = compete(matches.problem, old, PORTFOLIO)
    chosen = np.take_along_axis(contest.costs, contest.winner[None], axis=0)[0]
    np.testing.assert_allclose(chosen, contest.costs.min(axis=0), rtol=1e-5)
    np.testing.assert_allclose(cost_beside(matches.problem, contest.estimate, old), chosen, rtol=1e-9)


def test_what_lies_behind_the_cameras_counts_as_wrong(problem):
    """The mirror image of a scene fits as well, its points behind the cameras."""
    mirrored = EpipolarProblem(
        Rays(-problem.left.directions, problem.left.by_pixel), Rays(-problem.right.directions, problem.right.by_pixel)
    )
    np.testing.assert_allclose(np.abs(mirrored.residuals_px(TRUTH)), np.abs(problem.residuals_px(TRUTH)))
    assert cost_beside(mirrored, TRUTH, TRUTH) > cost_beside(problem, TRUTH, TRUTH) + 0.4 * 100
    backward = RelativePose(TRUTH.R, -TRUTH.t)
    seen = [float(cost_of_seen(problem, pose, None, 0.5)) for pose in (TRUTH, backward)]
    assert seen[0] == seen[1] == pytest.approx(float(cost_of_seen(problem, TRUTH, TRUTH, 0.5)))


def test_outside_the_old_rigs_bounds_everything_costs_more(problem):
    beyond = TRUTH.stepped(np.radians([6.0, 0, 0, 0, 0]))
    assert not is_near(beyond, TRUTH) and is_near(beyond, TRUTH, turn_deg=6.5)
    assert cost_beside(problem, TRUTH, beyond) > 100.0 > cost_beside(problem, TRUTH, TRUTH)
    away = RelativePose(TRUTH.R, -TRUTH.t)
    assert is_near(away, TRUTH)  # the sign of the translation is found later


def test_only_equations_that_can_be_weighed_anew_have_a_chosen_scale():
    class Other:
        pass

    state = type("State", (), {"equations": Other(), "mad_px": np.asarray(1.0)})()
    action = type("Action", (), {"scale_factor": 2.0, "damping": np.asarray(0.0)})()
    with pytest.raises(TypeError, match="solve the problem with minimize"):
        CHOSEN_SCALE.propose(None, state, action, "geman")
