"""Imitation of a one-step search: the same actor, taught by supervised learning instead of by a critic.

In every state that the student meets, a number of actions around its own and at random are tried on the simulated rig, and the one
that leaves the shortest distance to the optimum is the target action. It needs the truth of every rig and several evaluations of
each step, which the actor-critic does not; it looks one step ahead only, which the actor-critic does not either.
Source: Ross, Gordon & Bagnell 2011, "A reduction of imitation learning and structured prediction to no-regret online
learning" (DAgger: the student's own states, the expert's actions).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy import ndarray

from binocal.rl.cases import Cases, cases_of
from binocal.rl.policy import Policy
from binocal.rl.task import TaskState
from binocal.rl.tasks import task_of
from binocal.rl.training.networks import Actor
from binocal.rl.training.replay import ReplayBuffer
from binocal.rl.training.td3 import TD3Options
from binocal.rl.training.trainer import CENTRES, MAX_TRAINING_STEPS, TrainingOptions, policy_of
from binocal.solvers.arrays import take_rigs

N_TRIED = 16  # actions tried in each state
SEARCH_SPREAD = 0.3
UPDATES_PER_STEP = 4
LEAST_GAIN_DECADES = 0.02  # a smaller gain is noise of the search, not a target


class Imitation:
    """A run of imitation: the student, its target actions, generators."""

    def __init__(self, options: TrainingOptions, pools: list[tuple[Cases, float]]) -> None:
        self.options, self.pools = options, pools
        td3: TD3Options = options.td3
        self.task, self.cases = task_of(options.kind), cases_of(options.kind)
        n_observed, n = len(self.task.observation_names), len(self.task.action_names)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(options.seed)
            self.actor = Actor(n_observed, n, td3.actor_widths, CENTRES[options.kind])
        self.optimiser = torch.optim.Adam(self.actor.parameters(), lr=td3.learning_rate)
        self.rng = np.random.default_rng([options.seed, 4])
        self.target_actions = ReplayBuffer(options.capacity, n_observed, n)
        self.n_steps, self.n_generations = 0, 0

    def generation(self) -> None:
        """One pool's episodes: search in every state, then learn from all target actions so far."""
        pool, tolerance = self.pools[self.n_generations % len(self.pools)]
        rigs = pool.select(self.rng.permutation(pool.n_rigs)[: self.options.rigs_per_generation])
        state = self.task.initial(rigs.problem, self.cases.sample_starts(rigs, self.rng))
        for _ in range(MAX_TRAINING_STEPS):
            seen = self.task.observation(rigs.problem, state)
            wanted, following = self._search(rigs, state, seen, tolerance)
            nothing = np.zeros(len(seen))
            self.target_actions.add(seen, wanted, nothing, np.zeros_like(seen), nothing > 0)
            if self.n_generations == 0:
                self._normalise()
            keep = np.flatnonzero(self.cases.remaining_sigma(rigs, following.loop) > tolerance)
            if not len(keep):
                break
            rigs = rigs.select(keep)
            state = take_rigs(following, keep)
            self._learn(UPDATES_PER_STEP)
        self.n_generations += 1

    def weights(self) -> dict[str, Any]:
        """The student's weights."""
        return {name: value.clone() for name, value in self.actor.state_dict().items()}

    def policy(self) -> Policy:
        """The student as a policy."""
        return policy_of(self.options.kind, self.weights(), {})

    def _search(self, rigs: Cases, state: TaskState, seen: ndarray, tolerance: float) -> tuple[ndarray, TaskState]:
        """The best action tried for each rig, and the state that the student's own action leads to."""
        with torch.no_grad():
            own = self.actor(torch.as_tensor(seen, dtype=torch.float32)).numpy().astype(float)
        following = self.task.transition(rigs.problem, state, own)
        best_action, best = own, self._decades(rigs, following, tolerance) - LEAST_GAIN_DECADES
        for trial in range(1, N_TRIED):
            if trial % 4:
                action = np.clip(own + SEARCH_SPREAD * self.rng.standard_normal(own.shape), -1, 1)
            else:
                action = self.rng.uniform(-1, 1, own.shape)
            left = self._decades(rigs, self.task.transition(rigs.problem, state, action), tolerance)
            is_better = left < best
            best_action = np.where(is_better[:, None], action, best_action)
            best = np.where(is_better, left, best)
        self.n_steps += N_TRIED * len(own)
        return best_action, following

    def _normalise(self) -> None:
        values = torch.as_tensor(self.target_actions.observation[: len(self.target_actions)])
        self.actor.mean.copy_(values.mean(dim=0))
        self.actor.spread.copy_(values.std(dim=0).clamp_min(1e-2))

    def _learn(self, n_updates: int) -> None:
        for _ in range(n_updates):
            observed, action, *_ = self.target_actions.sample(self.options.batch_size, self.rng)
            loss = torch.nn.functional.mse_loss(self.actor(torch.as_tensor(observed)), torch.as_tensor(action))
            self.optimiser.zero_grad(set_to_none=True)
            loss.backward()
            self.optimiser.step()

    def _decades(self, rigs: Cases, state: TaskState, tolerance: float) -> ndarray:
        """Decades that are left to the tolerance."""
        sigma = np.nan_to_num(self.cases.remaining_sigma(rigs, state.loop), nan=1e8)
        return np.log10(np.maximum(sigma, tolerance) / tolerance)
