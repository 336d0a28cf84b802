"""Calibration as a decision process: what actions mean, what rewards add up to, that states are values."""

from __future__ import annotations

import copy
from dataclasses import fields, is_dataclass

import numpy as np
import pytest

from binocal.rl.agent_kind import AgentKind
from binocal.rl.rig_batches import distance_sigma, sample_starts
from binocal.rl.task import (
    INCREMENT_REACH,
    KERNEL,
    MAX_DISTANCE_DECADES,
    PROGRESS_REWARD,
    STEP_COST,
    _whitened_step,
    initial,
    n_actions,
    observation,
    observation_names,
    reward,
    steering_action,
    transition,
)
from binocal.solvers.arrays import take_rigs
from binocal.solvers.loop import advance
from binocal.solvers.loop_state import Action

KINDS = (AgentKind.DRL, AgentKind.DRL_INCREMENTS)


@pytest.fixture
def start(rigs):
    return sample_starts(rigs, np.random.default_rng(1))


def arrays(value, path: str = "") -> dict[str, np.ndarray]:
    """Every array of a nest of dataclasses and tuples, by its path."""
    if isinstance(value, np.ndarray):
        return {path: value}
    if is_dataclass(value):
        parts = {f.name: getattr(value, f.name) for f in fields(value)}
    elif isinstance(value, tuple):
        parts = {str(i): part for i, part in enumerate(value)}
    else:
        return {}
    return {k: a for name, part in parts.items() for k, a in arrays(part, f"{path}.{name}").items()}


def assert_same(a, b, **tolerance):
    left, right = arrays(a), arrays(b)
    assert left.keys() == right.keys() and left
    for path, array in left.items():
        np.testing.assert_allclose(array, right[path], err_msg=path, **(tolerance or {"rtol": 0, "atol": 0}))


def random_action(rigs, kind, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (rigs.n_rigs, n_actions(kind)))


@pytest.mark.parametrize("kind", KINDS)
def test_observations_are_named_and_finite(rigs, start, kind):
    state = initial(rigs.problem, start, kind)
    for seed in range(3):
        seen = observation(rigs.problem, state, kind)
        assert seen.shape == (rigs.n_rigs, len(observation_names(kind))) and np.isfinite(seen).all()
        state = transition(rigs.problem, state, random_action(rigs, kind, seed), kind)
    assert len(set(observation_names(kind))) == len(observation_names(kind))


def test_zero_is_plain_robust_gauss_newton(rigs, start):
    state = initial(rigs.problem, start, AgentKind.DRL)
    plain = state.loop
    nothing, one = np.zeros(rigs.n_rigs), np.ones(rigs.n_rigs)
    for _ in range(5):
        state = transition(rigs.problem, state, np.zeros((rigs.n_rigs, 6)), AgentKind.DRL)
        plain = advance(rigs.problem, plain, Action(nothing, one), KERNEL)
        assert_same(state.loop.estimate, plain.estimate, rtol=1e-8, atol=1e-10)
        np.testing.assert_array_equal(state.loop.is_kept, plain.is_kept)


def test_what_the_six_numbers_ask_for(rigs, start):
    loop = initial(rigs.problem, start, AgentKind.DRL).loop
    rows = np.array([[0.0] * 6, [1.0] * 6, [-1.0] * 6, [np.nan] * 6])
    rigs = np.arange(rigs.n_rigs) % 4
    action = steering_action(rows[rigs], loop)
    pivot = loop.newton.least_pivot
    np.testing.assert_allclose(action.damping, np.array([0, 500, 0, 0])[rigs] * pivot, rtol=1e-4)
    loop = take_rigs(loop, np.zeros(4, dtype=int))
    action = steering_action(rows, loop)
    np.testing.assert_allclose(action.scale_factor, [1, np.exp(1.5), np.exp(-1.5), 1])
    np.testing.assert_allclose(action.stretch, np.exp(0.4 * np.array([0, 1, -1, 0]))[:, None] * [1, 1])
    np.testing.assert_allclose(action.bend, [0, 1, 0, 0])
    np.testing.assert_allclose(action.pose_damping, [0, 1000, 0, 0], rtol=1e-4)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("kind", KINDS)
def test_a_number_that_is_not_finite_counts_as_zero(rigs, start, kind, bad):
    state = initial(rigs.problem, start, kind)
    zero = transition(rigs.problem, state, np.zeros((rigs.n_rigs, 6)), kind)
    wrong = transition(rigs.problem, state, np.full((rigs.n_rigs, 6), bad), kind)
    assert_same(wrong, zero)
    assert np.isfinite(observation(rigs.problem, wrong, kind)).all()


@pytest.mark.parametrize("kind", KINDS)
def test_a_step_alters_nothing_that_it_was_given(rigs, start, kind):
    state = transition(rigs.problem, initial(rigs.problem, start, kind), random_action(rigs, kind), kind)
    action = 3 * random_action(rigs, kind, 1)
    before = copy.deepcopy((state, action, rigs.problem, start))
    after = transition(rigs.problem, state, action, kind)
    observation(rigs.problem, after, kind)
    assert_same((state, action, rigs.problem, start), before)
    assert (after.n_steps == state.n_steps + 1).all()


@pytest.mark.parametrize("kind", KINDS)
def test_a_step_is_the_same_alone_and_in_a_batch(rigs, start, kind):
    action = random_action(rigs, kind)
    together = transition(rigs.problem, initial(rigs.problem, start, kind), action, kind)
    pick = np.array([5])
    alone = rigs.select(pick)
    begun = initial(alone.problem, take_rigs(start, pick), kind)
    one = transition(alone.problem, begun, action[pick], kind)
    np.testing.assert_allclose(
        distance_sigma(alone, one.loop.estimate), distance_sigma(rigs, together.loop.estimate)[pick], rtol=1e-9
    )


def test_the_increment_along_the_newton_step_is_the_newton_step(rigs, start):
    state = initial(rigs.problem, start, AgentKind.DRL_INCREMENTS)
    _, whitened = _whitened_step(rigs.problem, state.loop)
    length = np.linalg.norm(whitened, axis=1, keepdims=True)
    by_increment = transition(rigs.problem, state, whitened / (INCREMENT_REACH * length), AgentKind.DRL_INCREMENTS)
    newton = transition(
        rigs.problem, initial(rigs.problem, start, AgentKind.DRL), np.zeros((rigs.n_rigs, 6)), AgentKind.DRL
    )
    assert newton.loop.is_kept.sum() >= 6
    assert_same(by_increment.loop.estimate, newton.loop.estimate, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("kind", KINDS)
def test_a_rejected_candidate_leaves_the_estimate(rigs, start, kind):
    state = initial(rigs.problem, start, kind)
    n_rejected = 0
    for seed in range(6):
        after = transition(rigs.problem, state, random_action(rigs, kind, seed), kind)
        stays = ~after.loop.is_kept
        np.testing.assert_array_equal(
            after.loop.estimate.T_right_left.R[stays], state.loop.estimate.T_right_left.R[stays]
        )
        n_rejected, state = n_rejected + stays.sum(), after
    assert n_rejected > 0


def test_rewards_add_up_to_the_start_and_the_number_of_steps(rigs, start):
    tolerance = 0.1
    state = initial(rigs.problem, start, AgentKind.DRL)
    begin = sigma = distance_sigma(rigs, state.loop.estimate)
    total, n_steps = np.zeros(rigs.n_rigs), np.zeros(rigs.n_rigs)
    for _ in range(15):
        runs = sigma >= tolerance
        state = transition(rigs.problem, state, np.zeros((rigs.n_rigs, 6)), AgentKind.DRL)
        after = distance_sigma(rigs, state.loop.estimate)
        total += np.where(runs, reward(sigma, after, tolerance), 0.0)
        n_steps += runs
        sigma = np.where(runs, after, sigma)
    arrived = sigma < tolerance
    assert arrived.sum() >= 8
    decades = np.minimum(np.log10(begin / tolerance), MAX_DISTANCE_DECADES)
    np.testing.assert_allclose(total[arrived], (PROGRESS_REWARD * decades - STEP_COST * n_steps)[arrived], atol=1e-9)


def test_the_reward_of_a_step_by_hand():
    # from 10 to 1 sigma: a decade; from 1 to below the tolerance: one more; the cost of a step off each
    got = reward(np.array([10.0, 1.0, 1.0, np.nan]), np.array([1.0, 0.01, 1.0, 0.1]), 0.1)
    np.testing.assert_allclose(got, [0.3 - 1, 0.3 - 1, -1, 0.3 * 8 - 1])
