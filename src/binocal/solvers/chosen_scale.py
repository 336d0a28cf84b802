"""Rules for problems whose kernel has a scale in pixels that the controller chooses, up or down, iteration by iteration.

Where half of the residuals and more may be those of wrong matches no median tells the noise, so the scale is no multiple of
one: the problem assumes a noise, one pixel say, and an action's factor times that is the scale. A step is taken with the weights
of the scale that its action asks for, and its candidate competes under that scale.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol, cast, runtime_checkable

import numpy as np
from numpy import ndarray

from binocal.shapes import Bool, Float
from binocal.solvers import robust
from binocal.solvers.loop_state import Action, LoopState, Observed, Outcome
from binocal.solvers.problem import E, Equations, Problem, Q, S
from binocal.solvers.rules import Near


@runtime_checkable
class WeighableEquations(Equations, Protocol):
    """Equations that can be had under another kernel without their residuals being computed anew."""

    def under(self, scale_px: Float[ndarray, "*batch"], kernel: robust.Kernel) -> WeighableEquations:
        """The same residuals with the weights and cost of a kernel."""
        ...


@dataclass(frozen=True, slots=True)
class ChosenScale(Near[E, Q, S]):
    """See the module. Controllers may look at the undamped step under the last scale, and at the fall of the last cost.

    ``Observed.gain`` is here the share of the cost by which the last candidate lowered it, 0 where it was rejected.
    """

    def observe_start(  # type: ignore[override]
        self, problem: Problem[E, Q, S], start: E, equations: Q, mad_px: Float[ndarray, "*batch"]
    ) -> Observed[S]:
        """The undamped step; no fall yet."""
        newton = problem.solve_step(start, equations, np.zeros(mad_px.shape))
        return Observed(newton, np.zeros(mad_px.shape), mad_px, newton)

    def propose(self, problem: Problem[E, Q, S], state: LoopState[E, Q, S], action: Action, kernel: robust.Kernel) -> S:
        """The damped step under the scale that the action asks for."""
        weighed = cast(Q, _weighable(state.equations).under(_scale_px(state, action), kernel))
        return problem.solve_step(state.estimate, weighed, action.damping)

    def look_ahead(
        self, problem: Problem[E, Q, S], state: LoopState[E, Q, S], action: Action, candidate: E
    ) -> tuple[Float[ndarray, "*batch"], Float[ndarray, "*batch"]]:
        """The assumed noise, and the scale that the action asks for."""
        return state.mad_px, _scale_px(state, action)

    def is_possible(self, step: S, ahead_px: Float[ndarray, "*batch"]) -> Bool[ndarray, "*batch"]:
        """Where there was a step."""
        return np.isfinite(step.predicted_px2)

    def next_state(
        self,
        problem: Problem[E, Q, S],
        state: LoopState[E, Q, S],
        outcome: Outcome[E, Q, S],
        kernel: robust.Kernel,
        is_running: Bool[ndarray, "*batch"] | None,
    ) -> LoopState[E, Q, S]:
        """The scale is the one that was asked for, whether the candidate was kept or not."""
        scale = outcome.scale_px
        equations = cast(Q, _weighable(outcome.equations).under(scale, kernel))
        newton = problem.solve_step(outcome.estimate, equations, np.zeros(scale.shape))
        fall = (outcome.before_px2 - outcome.cost_px2) / np.maximum(outcome.before_px2, 1e-300)
        return replace(
            state,
            estimate=outcome.estimate,
            equations=equations,
            cost_px2=outcome.cost_px2,
            scale_px=scale,
            is_kept=outcome.is_kept,
            observed=Observed(newton, fall, state.mad_px, state.newton),
        )


CHOSEN_SCALE: ChosenScale[Any, Any, Any] = ChosenScale()


class Counted:
    """Ends a loop after so many iterations (:class:`binocal.solvers.loop.Watch`)."""

    is_running = None

    def __init__(self, n_iterations: int) -> None:
        self.n_left = n_iterations

    def is_over(self, state: LoopState[Any, Any, Any]) -> bool:
        """Whether none is left."""
        return self.n_left == 0

    def ends_before(self, state: LoopState[Any, Any, Any], action: Action, step: Any) -> bool:
        """Never: what is not finite is rejected as a candidate."""
        return False

    def record(self, state: LoopState[Any, Any, Any], outcome: Outcome[Any, Any, Any]) -> None:
        """One less."""
        self.n_left -= 1


def _scale_px(state: LoopState[Any, Any, Any], action: Action) -> Float[ndarray, "*batch"]:
    return np.broadcast_to(action.scale_factor * state.mad_px, state.mad_px.shape)


def _weighable(equations: Any) -> WeighableEquations:
    if not hasattr(equations, "under"):
        raise TypeError(f"{type(equations).__name__} cannot be weighed anew: solve the problem with minimize")
    return equations
