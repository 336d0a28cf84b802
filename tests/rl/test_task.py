"""Calibration as a decision process: what actions mean, what rewards add up to, that states are values."""

from __future__ import annotations

import copy
from dataclasses import fields, is_dataclass

import numpy as np
import pytest

from binocal.rl.rig_batches import distance_sigma, sample_starts, select_loop, take_rigs
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
from binocal.solvers.steering import Action, advance

MEANINGS = ("steering", "increments")


@pytest.fixture
def start(cases):
    return sample_starts(cases, np.random.default_rng(1))


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


def random_action(cases, meaning, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (cases.n_rigs, n_actions(meaning)))


@pytest.mark.parametrize("meaning", MEANINGS)
def test_observations_are_named_and_finite(cases, start, meaning):
    state = initial(cases.problem, start, meaning)
    for seed in range(3):
        seen = observation(cases.problem, state, meaning)
        assert seen.shape == (cases.n_rigs, len(observation_names(meaning))) and np.isfinite(seen).all()
        state = transition(cases.problem, state, random_action(cases, meaning, seed), meaning)
    assert len(set(observation_names(meaning))) == len(observation_names(meaning))


def test_zero_is_plain_robust_gauss_newton(cases, start):
    state = initial(cases.problem, start, "steering")
    plain = state.loop
    nothing, one = np.zeros(cases.n_rigs), np.ones(cases.n_rigs)
    for _ in range(5):
        state = transition(cases.problem, state, np.zeros((cases.n_rigs, 6)), "steering")
        plain = advance(cases.problem, plain, Action(nothing, one), KERNEL)
        assert_same(state.loop.estimate, plain.estimate, rtol=1e-8, atol=1e-10)
        np.testing.assert_array_equal(state.loop.is_kept, plain.is_kept)


def test_what_the_six_numbers_ask_for(cases, start):
    loop = initial(cases.problem, start, "steering").loop
    rows = np.array([[0.0] * 6, [1.0] * 6, [-1.0] * 6, [np.nan] * 6])
    rigs = np.arange(cases.n_rigs) % 4
    action = steering_action(rows[rigs], loop)
    pivot = loop.newton.least_pivot
    np.testing.assert_allclose(action.damping, np.array([0, 500, 0, 0])[rigs] * pivot, rtol=1e-4)
    loop = select_loop(loop, np.zeros(4, dtype=int))
    action = steering_action(rows, loop)
    np.testing.assert_allclose(action.scale_factor, [1, np.exp(1.5), np.exp(-1.5), 1])
    np.testing.assert_allclose(action.stretch, np.exp(0.4 * np.array([0, 1, -1, 0]))[:, None] * [1, 1])
    np.testing.assert_allclose(action.bend, [0, 1, 0, 0])
    np.testing.assert_allclose(action.pose_damping, [0, 1000, 0, 0], rtol=1e-4)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("meaning", MEANINGS)
def test_a_number_that_is_not_finite_counts_as_zero(cases, start, meaning, bad):
    state = initial(cases.problem, start, meaning)
    zero = transition(cases.problem, state, np.zeros((cases.n_rigs, 6)), meaning)
    wrong = transition(cases.problem, state, np.full((cases.n_rigs, 6), bad), meaning)
    assert_same(wrong, zero)
    assert np.isfinite(observation(cases.problem, wrong, meaning)).all()


@pytest.mark.parametrize("meaning", MEANINGS)
def test_a_step_alters_nothing_that_it_was_given(cases, start, meaning):
    state = transition(cases.problem, initial(cases.problem, start, meaning), random_action(cases, meaning), meaning)
    action = 3 * random_action(cases, meaning, 1)
    before = copy.deepcopy((state, action, cases.problem, start))
    after = transition(cases.problem, state, action, meaning)
    observation(cases.problem, after, meaning)
    assert_same((state, action, cases.problem, start), before)
    assert (after.n_steps == state.n_steps + 1).all()


@pytest.mark.parametrize("meaning", MEANINGS)
def test_a_step_is_the_same_alone_and_in_a_batch(cases, start, meaning):
    action = random_action(cases, meaning)
    together = transition(cases.problem, initial(cases.problem, start, meaning), action, meaning)
    pick = np.array([5])
    alone = cases.select(pick)
    begun = initial(alone.problem, take_rigs(start, pick), meaning)
    one = transition(alone.problem, begun, action[pick], meaning)
    np.testing.assert_allclose(
        distance_sigma(alone, one.loop.estimate), distance_sigma(cases, together.loop.estimate)[pick], rtol=1e-9
    )


def test_the_increment_along_the_newton_step_is_the_newton_step(cases, start):
    state = initial(cases.problem, start, "increments")
    _, whitened = _whitened_step(cases.problem, state.loop)
    length = np.linalg.norm(whitened, axis=1, keepdims=True)
    by_increment = transition(cases.problem, state, whitened / (INCREMENT_REACH * length), "increments")
    newton = transition(
        cases.problem, initial(cases.problem, start, "steering"), np.zeros((cases.n_rigs, 6)), "steering"
    )
    assert newton.loop.is_kept.sum() >= 6
    assert_same(by_increment.loop.estimate, newton.loop.estimate, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("meaning", MEANINGS)
def test_a_rejected_candidate_leaves_the_estimate(cases, start, meaning):
    state = initial(cases.problem, start, meaning)
    n_rejected = 0
    for seed in range(6):
        after = transition(cases.problem, state, random_action(cases, meaning, seed), meaning)
        stays = ~after.loop.is_kept
        np.testing.assert_array_equal(after.loop.estimate.R_right_left[stays], state.loop.estimate.R_right_left[stays])
        n_rejected, state = n_rejected + stays.sum(), after
    assert n_rejected > 0


def test_rewards_add_up_to_the_start_and_the_number_of_steps(cases, start):
    tolerance = 0.1
    state = initial(cases.problem, start, "steering")
    begin = sigma = distance_sigma(cases, state.loop.estimate)
    total, n_steps = np.zeros(cases.n_rigs), np.zeros(cases.n_rigs)
    for _ in range(15):
        runs = sigma >= tolerance
        state = transition(cases.problem, state, np.zeros((cases.n_rigs, 6)), "steering")
        after = distance_sigma(cases, state.loop.estimate)
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
