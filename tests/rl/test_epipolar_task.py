"""Streets as a decision process: what actions mean, what is seen, what it is worth, one set of matches as many."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from binocal.rl.agent_kind import AgentKind
from binocal.rl.cases import cases_of
from binocal.rl.epipolar_task import (
    FOUND_REWARD,
    N_STEPS,
    OBSERVED,
    action_of,
    initial,
    observation,
    solver_action,
    transition,
)
from binocal.rl.match_batches import (
    FOUND_SIGMA,
    MATCH_SETS,
    MatchSet,
    distance_sigma,
    has_found,
    judge,
    polished,
    sample_matches,
    sample_starts,
)
from binocal.simulation.matches import MatchDistribution
from binocal.solvers.arrays import take_rigs
from binocal.solvers.epipolar import EpipolarProblem, Rays


@pytest.fixture(scope="module")
def matches():
    return sample_matches(MATCH_SETS["drift_hard"], 8, np.random.default_rng(0))


@pytest.fixture(scope="module")
def start(matches):
    return sample_starts(matches, np.random.default_rng(1))


def alone(matches, index):
    """One problem without a batch and without what fills it up."""
    one = take_rigs(matches.problem, index)
    here = one.counts > 0
    return EpipolarProblem(
        Rays(one.left.directions[here], one.left.by_pixel[here]),
        Rays(one.right.directions[here], one.right.by_pixel[here]),
        scale_px=1.0,
    )


def test_observations_are_named_and_finite(matches, start):
    state, rng = initial(matches.problem, start), np.random.default_rng(2)
    for _ in range(4):
        seen = observation(matches.problem, state)
        assert seen.shape == (8, len(OBSERVED)) and np.isfinite(seen).all()
        state = transition(matches.problem, state, rng.uniform(-1, 1, (8, 2)))
    assert len(set(OBSERVED)) == len(OBSERVED) == 18


def test_quantiles_are_those_of_the_matches_in_pixels(matches, start):
    state = initial(matches.problem, start)
    seen = observation(matches.problem, state)
    for index in range(8):
        residuals = np.abs(alone(matches, index).residuals_px(take_rigs(start, index)))
        expected = np.quantile(residuals, (0.1, 0.2, 0.3, 0.5, 0.7, 0.9), method="lower")
        np.testing.assert_allclose(10 ** seen[index, :6], expected, rtol=1e-9)


def test_a_set_alone_goes_the_way_it_goes_in_a_batch(matches, start):
    actions = np.random.default_rng(3).uniform(-1, 1, (5, 8, 2))
    state = initial(matches.problem, start)
    ones = [(alone(matches, i), initial(alone(matches, i), take_rigs(start, i))) for i in range(8)]
    for action in actions:
        state = transition(matches.problem, state, action)
        ones = [(problem, transition(problem, one, action[i])) for i, (problem, one) in enumerate(ones)]
    seen = observation(matches.problem, state)
    for i, (problem, one) in enumerate(ones):
        np.testing.assert_allclose(one.loop.estimate.R, state.loop.estimate.R[i], atol=1e-9)
        np.testing.assert_allclose(observation(problem, one), seen[i], atol=1e-4)  # logarithms of small falls
        assert one.n_rejected == state.n_rejected[i]


@pytest.mark.parametrize(("scale_px", "damping"), [(1.0, 1e-6), (16.0, 1e-5), (128.0, 1.0)])
def test_what_the_two_numbers_ask_for(matches, start, scale_px, damping):
    state = initial(matches.problem, start)
    action = solver_action(matches.problem, state, np.tile(action_of(scale_px, damping), (8, 1)))
    np.testing.assert_allclose(action.scale_factor, scale_px)
    np.testing.assert_allclose(action.damping, damping)


def test_rejections_raise_the_damping_and_what_is_not_finite_counts_as_zero(matches, start):
    state = initial(matches.problem, start)
    raised = solver_action(matches.problem, replace(state, n_rejected=np.full(8, 2)), np.tile([0.0, -1.0], (8, 1)))
    np.testing.assert_allclose(raised.damping, 0.03)
    zero, wrong = (transition(matches.problem, state, np.full((8, 2), value)) for value in (0.0, np.nan))
    np.testing.assert_array_equal(zero.loop.estimate.R, wrong.loop.estimate.R)


def test_a_candidate_is_kept_only_where_its_cost_falls(matches, start):
    state, rng = initial(matches.problem, start), np.random.default_rng(4)
    n_rejected = 0
    for _ in range(10):
        before = state
        state = transition(matches.problem, state, rng.uniform(-1, 1, (8, 2)))
        scale = state.loop.scale_px
        was = before.loop.equations.cost_under(scale, "geman")
        kept = state.loop.is_kept
        assert np.all(state.loop.cost_px2[kept] < was[kept])
        np.testing.assert_array_equal(state.loop.estimate.R[~kept], before.loop.estimate.R[~kept])
        n_rejected += (~kept).sum()
    assert n_rejected > 0


def test_rewards_add_up_to_the_fall_of_the_distance_and_the_find(matches, start):
    cases = cases_of(AgentKind.DRL_STREETS)
    state = initial(matches.problem, start)
    first = sigma = cases.remaining_sigma(matches, state.loop)
    total = np.zeros(8)
    for step in range(N_STEPS):
        state = transition(matches.problem, state, np.tile(action_of(16.0 * 2.0 ** (-step / 3), 1e-5), (8, 1)))
        judged = judge(matches, sigma, state, FOUND_SIGMA)
        assert judged.is_terminal.all() == judged.is_terminal.any() == (step == N_STEPS - 1)
        total, sigma = total + judged.reward, judged.sigma
    is_found = has_found(matches, state.loop.estimate)
    assert 0 < is_found.sum() < 8  # else the bonus is not told from its absence
    expected = np.log10(np.maximum(first, 1) / np.maximum(sigma, 1)) + FOUND_REWARD * is_found
    np.testing.assert_allclose(total, expected, atol=1e-12)
    np.testing.assert_array_equal(judged.has_arrived, is_found)


def test_errors_sit_on_the_bound_without_wrong_matches():
    # 80 problems x 5 unknowns: the RMS scatters by 4 %; a kernel of one pixel costs up to a tenth at noise of 0.5 px
    plain = MatchSet(MatchDistribution(("street", "room"), noise_px=(0.1, 0.5)), (0.0, 5.0), (0.0, 5.0))
    matches = sample_matches(
        replace(plain, matches=replace(plain.matches, wrong_share=(0, 0))), 80, np.random.default_rng(5)
    )
    end = polished(matches.problem, matches.truth.stepped(np.full((80, 5), 1e-3)))
    assert np.sqrt(np.mean(distance_sigma(matches, matches.truth, end) ** 2)) == pytest.approx(1.03, abs=0.13)


def test_old_rigs_are_as_far_off_as_the_set_says():
    options = MATCH_SETS["mid"]
    matches = sample_matches(options, 40, np.random.default_rng(6))
    xi = np.degrees(matches.truth.step_to(sample_starts(matches, np.random.default_rng(7))))
    turn, direction = np.linalg.norm(xi[:, :3], axis=1), np.linalg.norm(xi[:, 3:], axis=1)
    assert turn.min() >= 5 - 1e-6 and turn.max() <= 20 + 1e-6 and direction.max() <= 20 + 1e-6 and direction.max() > 15
