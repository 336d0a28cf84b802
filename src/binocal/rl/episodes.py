"""Episodes of a batch of rigs or sets of matches, from their starts to arrival or to the last step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.rl.agent_kind import AgentKind
from binocal.rl.cases import Cases, cases_of
from binocal.rl.registration import MAX_STEPS
from binocal.rl.tasks import task_of
from binocal.shapes import Bool, Float, Int
from binocal.solvers.arrays import take_rigs

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
    """How the episodes ended. Rigs that did not arrive count ``failed_steps`` of their kind; ``total_reward`` is discounted."""

    n_iterations: Int[ndarray, "rigs"]
    has_arrived: Bool[ndarray, "rigs"]
    total_reward: Float[ndarray, "rigs"]


def run_episodes(
    rigs: Cases,
    start: Any,
    policy: ActionFunction,
    kind: AgentKind,
    *,
    tolerance_sigma: float,
    max_steps: int = MAX_STEPS,
    discount: float = 1.0,
    on_step: Callable[[Transitions], None] | None = None,
) -> EpisodeOutcome:
    """Runs every case once: rigs, or sets of matches, of a batch. Those whose episode ended leave the batch."""
    task, cases = task_of(kind), cases_of(kind)
    n_iterations = np.full(rigs.n_rigs, cases.failed_steps)
    arrived, ended = np.zeros(rigs.n_rigs, dtype=bool), np.zeros(rigs.n_rigs, dtype=bool)
    total = np.zeros(rigs.n_rigs)
    rig = np.arange(rigs.n_rigs)
    running = rigs
    state = task.initial(running.problem, start)
    seen = task.observation(running.problem, state)
    sigma = cases.remaining_sigma(running, state.loop)
    for step in range(max_steps):
        action = policy(seen)
        state = task.transition(running.problem, state, action)
        following = task.observation(running.problem, state)
        judged = cases.judge(running, sigma, state, tolerance_sigma)
        is_live = ~ended[rig]
        total[rig[is_live]] += discount**step * judged.reward[is_live]
        if on_step is not None:
            on_step(
                Transitions(
                    rig[is_live],
                    seen[is_live],
                    action[is_live],
                    judged.reward[is_live],
                    following[is_live],
                    judged.is_terminal[is_live],
                )
            )
        new = rig[is_live & judged.has_arrived]
        n_iterations[new], arrived[new] = step + 1, True
        ended[rig[is_live & judged.is_terminal]] = True
        seen, sigma = following, judged.sigma
        is_live = ~ended[rig]
        if not is_live.any():
            break
        if is_live.mean() < COMPACTION_SHARE:
            keep = np.flatnonzero(is_live)
            running, rig, seen, sigma = running.select(keep), rig[keep], seen[keep], sigma[keep]
            state = take_rigs(state, keep)
    return EpisodeOutcome(n_iterations, arrived, total)
