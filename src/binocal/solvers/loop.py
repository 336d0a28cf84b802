"""The one guarded loop of every robust solve: a controller chooses how an iteration is done, the guards decide what becomes of it.

An iteration linearises, solves the step that the controller's :class:`~binocal.solvers.loop_state.Action` asks for, evaluates one
candidate, and keeps it only where it is possible and the robust cost falls. Classical controllers and the learned one go through
the same :func:`iterate`; so does every problem with the methods of :class:`binocal.solvers.problem.Problem`. How the kernel's
scale follows the residuals, and which further guards there are, is said by :mod:`binocal.solvers.rules`. All functions are pure
and work on a batch of rigs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy import ndarray

from binocal.shapes import Bool, Float
from binocal.solvers import robust
from binocal.solvers.arrays import choose_rigs
from binocal.solvers.loop_state import Action, Controller, LoopState, Outcome
from binocal.solvers.problem import E, Problem, Q, S
from binocal.solvers.rules import FAR, Rules, cost_under

Listener = Callable[[Any, LoopState[Any, Any, Any], int], None]
"""What is told of every iteration: the problem, the state after it, and its number; 0 is the start of a loop."""
_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)


@contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """Within it every loop of this thread tells the listener of its iterations; what comes out is the same."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


@runtime_checkable
class Watch(Protocol):
    """What ends a loop. It sees every iteration and may count."""

    @property
    def is_running(self) -> Bool[ndarray, "*batch"] | None:
        """Rigs whose candidates may be kept; None: all."""
        ...

    def is_over(self, state: LoopState[Any, Any, Any]) -> bool:
        """Whether to end before the controller is asked."""
        ...

    def ends_before(self, state: LoopState[Any, Any, Any], action: Action, step: Any) -> bool:
        """Whether to end instead of evaluating the step."""
        ...

    def record(self, state: LoopState[Any, Any, Any], outcome: Outcome[Any, Any, Any]) -> None:
        """Take note of an iteration; ``state`` is that after it."""
        ...


def begin(
    problem: Problem[E, Q, S],
    start: E,
    kernel: robust.Kernel,
    scale_px: float | Float[ndarray, "*batch"] | None = None,
    *,
    rules: Rules[E, Q, S] = FAR,
    scale_factor: float = 1.0,
    equations: Q | None = None,
) -> LoopState[E, Q, S]:
    """The state at a start; ``scale_px`` is a first guess of the kernel's scale (found from the residuals if None).

    ``equations`` may be those of the start under that scale, if they are at hand. Rigs whose start is impossible (a corner
    behind its camera) have an infinite cost.
    """
    if scale_px is None:
        mad = problem.noise_estimate_px(problem.residual_lengths2(start))
        mad = np.where(np.isfinite(mad), mad, 1.0)
        scale = scale_factor * mad
    else:
        mad = scale = np.broadcast_to(np.asarray(scale_px, dtype=float), start.batch).copy()
    equations = problem.linearize(start, scale, kernel) if equations is None else equations
    kept = np.ones(mad.shape, dtype=bool)
    observed = rules.observe_start(problem, start, equations, mad)
    is_closing = kernel != "squared"
    return LoopState(start, equations, equations.cost_px2, scale, mad, kept, start, ~kept, is_closing, observed)


def run(
    problem: Problem[E, Q, S],
    state: LoopState[E, Q, S],
    controller: Controller,
    kernel: robust.Kernel,
    rules: Rules[E, Q, S],
    watch: Watch,
) -> LoopState[E, Q, S]:
    """The loop itself: iterations of a controller until the watch ends them."""
    memory, listener, n_done = controller.start(state.scale_px.shape), _listener.get(), 0
    if listener is not None:
        listener(problem, state, n_done)
    while not watch.is_over(state):
        action, memory = controller.choose(problem, state, memory)
        step = rules.propose(problem, state, action, kernel)
        if watch.ends_before(state, action, step):
            break
        outcome = iterate(problem, state, action, step, kernel, rules, watch.is_running)
        state = rules.next_state(problem, state, outcome, kernel, watch.is_running)
        watch.record(state, outcome)
        n_done += 1
        if listener is not None:
            listener(problem, state, n_done)
    return state


def advance(
    problem: Problem[E, Q, S],
    state: LoopState[E, Q, S],
    action: Action,
    kernel: robust.Kernel,
    rules: Rules[E, Q, S] = FAR,
) -> LoopState[E, Q, S]:
    """One iteration with a given action."""
    outcome = iterate(problem, state, action, rules.propose(problem, state, action, kernel), kernel, rules)
    return rules.next_state(problem, state, outcome, kernel, None)


def iterate(
    problem: Problem[E, Q, S],
    state: LoopState[E, Q, S],
    action: Action,
    step: S,
    kernel: robust.Kernel,
    rules: Rules[E, Q, S],
    is_running: Bool[ndarray, "*batch"] | None = None,
) -> Outcome[E, Q, S]:
    """One candidate evaluated, and kept where it is possible and lowers the robust cost."""
    candidate = rules.candidate(problem, state, step, kernel)
    ahead, scale = rules.look_ahead(problem, state, action, candidate)
    trial = problem.linearize(candidate, scale, kernel)
    before = cost_under(state.equations, state.cost_px2, state.scale_px, scale, kernel)
    is_kept = (trial.cost_px2 < before) & rules.is_possible(step, ahead)
    if is_running is not None:
        is_kept = is_running & is_kept
    estimate, equations, cost = candidate, trial, trial.cost_px2
    if not is_kept.all():
        estimate = choose_rigs(is_kept, candidate, state.estimate) if is_kept.any() else state.estimate
        equations = choose_rigs(is_kept, trial, state.equations) if is_kept.any() else state.equations
        cost = np.where(is_kept, trial.cost_px2, before)
    return Outcome(action, step, is_kept, estimate, equations, cost, scale, ahead, trial.cost_px2, before)
