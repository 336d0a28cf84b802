"""The ring of transitions."""

from __future__ import annotations

import numpy as np

from binocal.rl.training.replay import ReplayBuffer


def numbered(first: int, n: int) -> tuple[np.ndarray, ...]:
    """Transitions whose every entry tells which one it is."""
    i = np.arange(first, first + n, dtype=float)
    return np.stack([i, i], axis=1), i[:, None] / 100, -i, np.stack([i + 1, i + 1], axis=1), i % 2 == 0


def test_the_oldest_give_way():
    buffer = ReplayBuffer(5, 2, 1)
    buffer.add(*numbered(0, 3))
    assert len(buffer) == 3 and buffer.n_written == 3
    buffer.add(*numbered(3, 4))
    assert len(buffer) == 5 and buffer.n_written == 7
    assert sorted(-buffer.reward) == [2, 3, 4, 5, 6]


def test_the_parts_of_a_transition_stay_together():
    buffer = ReplayBuffer(64, 2, 1)
    buffer.add(*numbered(0, 100))
    observation, action, reward, following, is_terminal = buffer.sample(500, np.random.default_rng(0))
    i = observation[:, 0]
    assert set(i) == set(range(36, 100))  # all that is stored, nothing else: 500 draws of 64 miss one in 3000 of seeds
    np.testing.assert_array_equal(following[:, 1], i + 1)
    np.testing.assert_array_equal(reward, -i)
    np.testing.assert_allclose(action[:, 0], i / 100, rtol=1e-6)
    np.testing.assert_array_equal(is_terminal, i % 2 == 0)
    assert {a.dtype for a in (observation, action, reward, following, is_terminal)} == {np.dtype(np.float32)}


def test_samples_are_copies():
    buffer = ReplayBuffer(4, 2, 1)
    buffer.add(*numbered(0, 4))
    buffer.sample(4, np.random.default_rng(0))[0][:] = -1
    assert buffer.observation.min() == 0


def test_restored_it_samples_and_overwrites_the_same():
    ours = ReplayBuffer(8, 2, 1)
    ours.add(*numbered(0, 11))
    theirs = ReplayBuffer(8, 2, 1)
    theirs.restore(ours.state())
    for buffer in (ours, theirs):
        buffer.add(*numbered(11, 2))
    for a, b in zip(
        ours.sample(20, np.random.default_rng(3)), theirs.sample(20, np.random.default_rng(3)), strict=True
    ):
        np.testing.assert_array_equal(a, b)
