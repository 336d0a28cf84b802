"""Where episodes take place: rigs or sets of matches, their starts, and what a step was worth, for each kind of agent."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy import ndarray

from binocal.rl import match_batches, rig_batches
from binocal.rl.agent_kind import AgentKind
from binocal.rl.epipolar_task import N_STEPS
from binocal.rl.registration import MAX_STEPS
from binocal.rl.task import Judgement, TaskState

C = TypeVar("C", bound="Cases")


@runtime_checkable
class Cases(Protocol):
    """A batch of problems whose solution is known: :mod:`binocal.rl.rig_batches`, :mod:`binocal.rl.match_batches`."""

    @property
    def problem(self) -> Any:
        """What the solver sees of them."""
        ...

    @property
    def n_rigs(self) -> int:
        """How many."""
        ...

    def select(self: C, index: ndarray) -> C:
        """Some of them."""
        ...


@dataclass(frozen=True, slots=True)
class CaseFunctions:
    """What training asks of cases of one kind. ``failed_steps`` is what an episode counts that did not arrive."""

    failed_steps: int
    sample_starts: Callable[[Any, np.random.Generator], Any]
    remaining_sigma: Callable[[Any, Any], ndarray]
    """Of cases and the state of their loops."""
    judge: Callable[[Any, ndarray, TaskState, float], Judgement]
    """Of cases, their distance before a step, their state after it, and the distance that counts as arrived."""


@cache
def cases_of(kind: AgentKind) -> CaseFunctions:
    """Those of a kind of agent."""
    if kind == AgentKind.DRL_STREETS:
        own = match_batches
        return CaseFunctions(2 * N_STEPS, own.sample_starts, own.remaining_sigma, own.judge)
    return CaseFunctions(MAX_STEPS, rig_batches.sample_starts, rig_batches.remaining_sigma, rig_batches.judge)
