"""The replay buffer: a ring of transitions."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.shapes import Bool, Float

Batch = tuple[ndarray, ndarray, ndarray, ndarray, ndarray]


class ReplayBuffer:
    """Transitions (observation, action, reward, next observation, terminated); the oldest give way."""

    def __init__(self, capacity: int, n_observed: int, n_actions: int) -> None:
        self.capacity, self.n_written = capacity, 0
        self.observation = np.zeros((capacity, n_observed), dtype=np.float32)
        self.action = np.zeros((capacity, n_actions), dtype=np.float32)
        self.reward = np.zeros(capacity, dtype=np.float32)
        self.following = np.zeros((capacity, n_observed), dtype=np.float32)
        self.is_terminal = np.zeros(capacity, dtype=np.float32)

    def __len__(self) -> int:
        return min(self.n_written, self.capacity)

    def add(
        self,
        observation: Float[ndarray, "n o"],
        action: Float[ndarray, "n a"],
        reward: Float[ndarray, "n"],
        following: Float[ndarray, "n o"],
        is_terminal: Bool[ndarray, "n"],
    ) -> None:
        """Stores n transitions."""
        place = (self.n_written + np.arange(len(reward))) % self.capacity
        self.observation[place], self.action[place], self.reward[place] = observation, action, reward
        self.following[place], self.is_terminal[place] = following, is_terminal
        self.n_written += len(reward)

    def sample(self, n: int, rng: np.random.Generator) -> Batch:
        """Draws n transitions, with replacement."""
        pick = rng.integers(len(self), size=n)
        return (
            self.observation[pick], self.action[pick], self.reward[pick], self.following[pick], self.is_terminal[pick]
        )  # fmt: skip

    def state(self) -> dict[str, ndarray]:
        """What was stored, for a checkpoint."""
        n = len(self)
        arrays = {name: getattr(self, name)[:n].copy() for name in self._ARRAYS}
        return {**arrays, "n_written": np.array(self.n_written)}

    def restore(self, state: dict[str, ndarray]) -> None:
        """The inverse of :meth:`state`."""
        self.n_written = int(state["n_written"])
        for name in self._ARRAYS:
            getattr(self, name)[: len(self)] = state[name]

    _ARRAYS = ("observation", "action", "reward", "following", "is_terminal")
