"""The tasks side by side: what episodes, networks and controllers ask of each kind of agent."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

from numpy import ndarray

from binocal.rl import epipolar_task, task
from binocal.rl.agent_kind import AgentKind
from binocal.rl.task import TaskState
from binocal.solvers.loop_state import Action


@dataclass(frozen=True, slots=True)
class Task:
    """Pure functions over a batch of problems: rigs with their corners, or sets of matches."""

    action_names: tuple[str, ...]
    observation_names: tuple[str, ...]
    initial: Callable[[Any, Any], TaskState]
    """Of a problem and a start."""
    observation: Callable[[Any, TaskState], ndarray]
    transition: Callable[[Any, TaskState, ndarray], TaskState]
    """The state after an action (n, a)."""
    solver_action: Callable[[Any, TaskState, ndarray], Action]
    """What an action asks of the solver."""


@cache
def task_of(kind: AgentKind) -> Task:
    """The task of a kind of agent."""
    if kind == AgentKind.DRL_STREETS:
        own = epipolar_task
        return Task(own.CHOSEN, own.OBSERVED, own.initial, own.observation, own.transition, own.solver_action)
    return Task(
        task.STEERING if kind == AgentKind.DRL else task.INCREMENTS,
        task.observation_names(kind),
        partial(task.initial, kind=kind),
        partial(task.observation, kind=kind),
        partial(task.transition, kind=kind),
        partial(task.solver_action, kind=kind),
    )
