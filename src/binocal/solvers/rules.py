"""How the kernel's scale follows the residuals, and which guards an iteration has: near the optimum and far from it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy import ndarray

from binocal.shapes import Bool, Float
from binocal.solvers import robust
from binocal.solvers.loop_state import Action, LoopState, Observed, Outcome
from binocal.solvers.problem import E, Equations, Problem, Q, S, SteerableProblem

CLOSING_RATIO = 0.9  # the scale fell by more than this in a step: the kernel is still closing
SETTLED_SHARE = 0.01  # of the scale; a difference that no weight feels


@runtime_checkable
class Rules(Protocol[E, Q, S]):
    """What :func:`binocal.solvers.loop.iterate` leaves open."""

    def observe_start(
        self, problem: Problem[E, Q, S], start: E, equations: Q, mad_px: Float[ndarray, "*batch"]
    ) -> Observed[S] | None:
        """What controllers may look at before the first iteration."""
        ...

    def propose(self, problem: Problem[E, Q, S], state: LoopState[E, Q, S], action: Action, kernel: robust.Kernel) -> S:
        """The step that an action asks for."""
        ...

    def candidate(self, problem: Problem[E, Q, S], state: LoopState[E, Q, S], step: S, kernel: robust.Kernel) -> E:
        """The estimate that the step leads to."""
        ...

    def look_ahead(
        self, problem: Problem[E, Q, S], state: LoopState[E, Q, S], action: Action, candidate: E
    ) -> tuple[Float[ndarray, "*batch"], Float[ndarray, "*batch"]]:
        """MAD noise of the candidate, and the scale under which it competes with the estimate."""
        ...

    def is_possible(self, step: S, ahead_px: Float[ndarray, "*batch"]) -> Bool[ndarray, "*batch"] | bool:
        """Where a candidate may be kept if its cost is lower."""
        ...

    def next_state(
        self,
        problem: Problem[E, Q, S],
        state: LoopState[E, Q, S],
        outcome: Outcome[E, Q, S],
        kernel: robust.Kernel,
        is_running: Bool[ndarray, "*batch"] | None,
    ) -> LoopState[E, Q, S]:
        """The state after an iteration."""
        ...


@dataclass(frozen=True, slots=True)
class Near(Rules[E, Q, S]):
    """For starts that any solver takes well; every solve ends under these rules.

    The kernel's scale is that of the candidate where that is smaller, rejected or not, until it stops falling, and settles on
    that of the estimate. Nothing is computed for observers.
    """

    def observe_start(
        self, problem: Problem[E, Q, S], start: E, equations: Q, mad_px: Float[ndarray, "*batch"]
    ) -> None:
        """Nothing."""

    def propose(self, problem: Problem[E, Q, S], state: LoopState[E, Q, S], action: Action, kernel: robust.Kernel) -> S:
        """The damped step."""
        return problem.solve_step(state.estimate, state.equations, action.damping)

    def candidate(self, problem: Problem[E, Q, S], state: LoopState[E, Q, S], step: S, kernel: robust.Kernel) -> E:
        """The estimate moved by the step."""
        return problem.retract(state.estimate, step)

    def look_ahead(
        self, problem: Problem[E, Q, S], state: LoopState[E, Q, S], action: Action, candidate: E
    ) -> tuple[Float[ndarray, "*batch"], Float[ndarray, "*batch"]]:
        """The smaller scale of the two while the kernel closes.

        It costs a quarter of an iteration and saves the one that would only close the kernel.
        """
        if not state.is_closing:
            return state.mad_px, state.scale_px
        ahead = problem.noise_estimate_px(problem.residual_lengths2(candidate))
        scaled = action.scale_factor * ahead
        return ahead, np.where(scaled < state.scale_px, scaled, state.scale_px)

    def is_possible(self, step: S, ahead_px: Float[ndarray, "*batch"]) -> Bool[ndarray, "*batch"] | bool:
        """Everywhere: an impossible candidate's cost is infinite."""
        return True

    def next_state(
        self,
        problem: Problem[E, Q, S],
        state: LoopState[E, Q, S],
        outcome: Outcome[E, Q, S],
        kernel: robust.Kernel,
        is_running: Bool[ndarray, "*batch"] | None,
    ) -> LoopState[E, Q, S]:
        """The scale moves to the estimate's MAD noise where a candidate was kept, until it hardly moves."""
        noise = problem.noise_estimate_px(outcome.equations.r2_px2)
        wanted = np.maximum(outcome.action.scale_factor * noise, 1e-300)
        is_settled = (np.abs(wanted - outcome.scale_px) < SETTLED_SHARE * outcome.scale_px) | (kernel == "squared")
        fell = wanted < CLOSING_RATIO * state.scale_px
        is_closing = state.is_closing and bool(np.any(fell if is_running is None else fell & is_running))
        scale = np.where(outcome.is_kept & ~is_settled, wanted, outcome.scale_px)
        cost = cost_under(outcome.equations, outcome.cost_px2, outcome.scale_px, scale, kernel)
        return LoopState(
            outcome.estimate,
            outcome.equations,
            cost,
            scale,
            noise,
            outcome.is_kept,
            state.start,
            is_settled,
            is_closing,
            None,
        )


@dataclass(frozen=True, slots=True)
class Patient(Near[E, Q, S]):
    """:class:`Near` for valleys that bend within a standard deviation: every candidate's views are at their best before it is judged.

    A long step along such a valley moves all poses, and what it leaves of them to second order would hide that it is right. The
    problem must be a :class:`binocal.solvers.problem.SteerableProblem`.
    """

    def candidate(self, problem: Problem[E, Q, S], state: LoopState[E, Q, S], step: S, kernel: robust.Kernel) -> E:
        """The estimate moved by the step, then its views alone by theirs."""
        moved = problem.retract(state.estimate, step)
        return _steerable(problem).with_views_at_best(moved, state.scale_px, kernel)


@dataclass(frozen=True, slots=True)
class Far(Rules[E, Q, S]):
    """For long steps, whose controllers look at the undamped step and at the last gain.

    The kernel's scale is that of the better one of estimate and candidate and opens when the controller asks; a rejected
    candidate leaves it as it was. Steps that go too far are shortened; views that an early step threw off return to their start.
    The problem must be a :class:`binocal.solvers.problem.SteerableProblem`.
    """

    def observe_start(
        self, problem: Problem[E, Q, S], start: E, equations: Q, mad_px: Float[ndarray, "*batch"]
    ) -> Observed[S]:
        """The undamped step; a gain of 1."""
        newton = problem.solve_step(start, equations, np.zeros(mad_px.shape))
        return Observed(newton, np.ones(mad_px.shape), mad_px, newton)

    def propose(self, problem: Problem[E, Q, S], state: LoopState[E, Q, S], action: Action, kernel: robust.Kernel) -> S:
        """The step with the action's alterations, shortened, and corrected to second order where that is asked for."""
        steerable = _steerable(problem)
        pose_damping = action.damping if action.pose_damping is None else action.damping + action.pose_damping
        step = state.newton
        if action.increment is not None or action.stretch is not None or np.any(pose_damping > 0):
            step = steerable.solve_step(
                state.estimate,
                state.equations,
                action.damping,
                action.stretch,
                increment=action.increment,
                pose_damping=pose_damping,
            )
        step = steerable.limited(step)
        if action.bend is None or not np.any(action.bend > 0):
            return step
        straight = steerable.straightened(state.estimate, step, action.bend)
        mad = straight.noise_estimate_px(straight.residual_lengths2(state.estimate))
        scale = np.maximum(action.scale_factor * np.where(np.isfinite(mad), mad, state.mad_px), robust.SCALE_FLOOR_PX)
        equations = straight.linearize(state.estimate, scale, kernel)
        correction = straight.solve_step(state.estimate, equations, action.damping, pose_damping=pose_damping)
        return steerable.corrected(step, correction, action.bend > 0)

    def candidate(self, problem: Problem[E, Q, S], state: LoopState[E, Q, S], step: S, kernel: robust.Kernel) -> E:
        """The estimate moved by the step, lost views put back."""
        moved = problem.retract(state.estimate, step)
        if kernel != "hampel":
            return moved
        return _steerable(problem).with_lost_views_restored(moved, state.equations, state.start)

    def look_ahead(
        self, problem: Problem[E, Q, S], state: LoopState[E, Q, S], action: Action, candidate: E
    ) -> tuple[Float[ndarray, "*batch"], Float[ndarray, "*batch"]]:
        """The scale that the action asks for over the better MAD noise of the two."""
        ahead = problem.noise_estimate_px(problem.residual_lengths2(candidate))
        best = np.where(np.isfinite(ahead), np.minimum(ahead, state.mad_px), state.mad_px)
        return ahead, np.maximum(action.scale_factor * best, robust.SCALE_FLOOR_PX)

    def is_possible(self, step: S, ahead_px: Float[ndarray, "*batch"]) -> Bool[ndarray, "*batch"]:
        """Where there was a step, and most corners lie in front of their cameras."""
        return np.isfinite(ahead_px) & np.isfinite(step.predicted_px2)

    def next_state(
        self,
        problem: Problem[E, Q, S],
        state: LoopState[E, Q, S],
        outcome: Outcome[E, Q, S],
        kernel: robust.Kernel,
        is_running: Bool[ndarray, "*batch"] | None,
    ) -> LoopState[E, Q, S]:
        """The scale is the candidate's where it was kept, else what it was."""
        is_kept, scale, mad, cost = outcome.is_kept, outcome.scale_px, outcome.ahead_px, outcome.cost_px2
        if not is_kept.all():
            scale, mad = np.where(is_kept, scale, state.scale_px), np.where(is_kept, mad, state.mad_px)
            cost = np.where(is_kept, cost, state.cost_px2)
        newton = state.newton
        if is_kept.any():
            newton = problem.solve_step(outcome.estimate, outcome.equations, np.zeros(mad.shape))
        gain = np.full(mad.shape, -1.0)
        fall = np.subtract(outcome.before_px2, outcome.trial_px2, out=np.zeros(mad.shape), where=is_kept)
        np.divide(fall, np.maximum(outcome.step.predicted_px2, 1e-30), out=gain, where=is_kept)
        return replace(
            state,
            estimate=outcome.estimate,
            equations=outcome.equations,
            cost_px2=cost,
            scale_px=scale,
            mad_px=mad,
            is_kept=is_kept,
            observed=Observed(newton, np.minimum(gain, 3.0), state.mad_px, state.newton),
        )


NEAR: Near[Any, Any, Any] = Near()
PATIENT: Patient[Any, Any, Any] = Patient()
FAR: Far[Any, Any, Any] = Far()


def cost_under(
    equations: Equations,
    cost_px2: Float[ndarray, "*batch"],
    known_px: Float[ndarray, "*batch"],
    scale_px: Float[ndarray, "*batch"],
    kernel: robust.Kernel,
) -> Float[ndarray, "*batch"]:
    """Robust cost of equations under a scale; ``cost_px2`` is that under ``known_px``."""
    if scale_px is known_px:
        return cost_px2
    is_new = scale_px != known_px
    return np.where(is_new, equations.cost_under(scale_px, kernel), cost_px2) if is_new.any() else cost_px2


def _steerable(problem: Problem[E, Q, S]) -> SteerableProblem[E, Q, S]:
    if not hasattr(problem, "straightened"):
        raise TypeError(f"{type(problem).__name__} has no steps that a controller could alter: solve it with minimize")
    return problem  # type: ignore[return-value]
