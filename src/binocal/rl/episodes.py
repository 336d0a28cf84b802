"""Episodes of a batch of rigs, from their starts to arrival or to the last step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.rl.agent_kind import AgentKind
from binocal.rl.registration import MAX_STEPS
from binocal.rl.rig_batches import RigBatch, remaining_sigma
from binocal.rl.task import (
    has_arrived,
    initial,
    observation,
    reward,
    transition,
)
from binocal.shapes import Bool, Float, Int
from binocal.solvers.arrays import take_rigs
from binocal.solvers.board_views import BundleEstimate

COMPACTION_SHARE = 0.8  # a batch is packed when fewer of its rigs than this still run

ActionFunction = Callable[[ndarray], ndarray]
"""From observations (rigs, o) to actions (rigs, a)."""


@dataclass(frozen=True, slots=True, eq=False)
class Transitions:
    """One step of every rig that still ran; ``rig`` says which of the rigs it was."""

    rig: Int[ndarray, "n"]
    observation: Float[ndarray, "n o"]
    action: Float[ndarray, "n a"]
    reward: Float[ndarray, "n"]
    following: Float[ndarray, "n o"]
    is_terminal: Bool[ndarray, "n"]


@dataclass(frozen=True, slots=True, eq=False)
class EpisodeOutcome:
    """How the episodes ended. Rigs that did not arrive count ``MAX_STEPS`` iterations; ``total_reward`` is discounted."""

    n_iterations: Int[ndarray, "rigs"]
    has_arrived: Bool[ndarray, "rigs"]
    total_reward: Float[ndarray, "rigs"]


def run_episodes(
    rigs: RigBatch,
    start: BundleEstimate,
    policy: ActionFunction,
    kind: AgentKind,
    *,
    tolerance_sigma: float,
    max_steps: int = MAX_STEPS,
    discount: float = 1.0,
    on_step: Callable[[Transitions], None] | None = None,
) -> EpisodeOutcome:
    """Runs every case once. Rigs that arrived leave the batch."""
    n_iterations = np.full(rigs.n_rigs, MAX_STEPS)
    arrived = np.zeros(rigs.n_rigs, dtype=bool)
    total = np.zeros(rigs.n_rigs)
    rig = np.arange(rigs.n_rigs)
    running = rigs
    state = initial(running.problem, start, kind)
    seen = observation(running.problem, state, kind)
    sigma = remaining_sigma(running, state.loop)
    for step in range(max_steps):
        action = policy(seen)
        state = transition(running.problem, state, action, kind)
        following = observation(running.problem, state, kind)
        after = remaining_sigma(running, state.loop)
        is_terminal = has_arrived(after, tolerance_sigma)
        earned = reward(sigma, after, tolerance_sigma)
        is_live = ~arrived[rig]
        total[rig[is_live]] += discount**step * earned[is_live]
        if on_step is not None:
            on_step(
                Transitions(
                    rig[is_live],
                    seen[is_live],
                    action[is_live],
                    earned[is_live],
                    following[is_live],
                    is_terminal[is_live],
                )
            )
        new = rig[is_live & is_terminal]
        n_iterations[new], arrived[new] = step + 1, True
        seen, sigma = following, after
        is_live = ~arrived[rig]
        if not is_live.any():
            break
        if is_live.mean() < COMPACTION_SHARE:
            keep = np.flatnonzero(is_live)
            running, rig, seen, sigma = running.select(keep), rig[keep], seen[keep], sigma[keep]
            state = take_rigs(state, keep)
    return EpisodeOutcome(n_iterations, arrived, total)
