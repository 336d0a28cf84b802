"""A robust solve whose far phase has a controller of its own, and whose end is the classical one.

The controller, learned or not, chooses while the rig's steps are so long that the way they are taken matters. It can waste
iterations and nothing else: the loop keeps a candidate only if it lowers the robust cost and stays in front of the cameras,
three rejections in a row or a number that is not finite end its phase, and the classical controller finishes from the best
estimate in any case, to its own stop rule.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.geometry import so3
from binocal.solvers.board_views import BundleEstimate, BundleMinimum, BundleProblem, BundleState, BundleStep
from binocal.solvers.loop import begin, run
from binocal.solvers.loop_state import Action, Controller, Outcome
from binocal.solvers.minimization import RESUMED_DAMPING, LoopOptions, minimize
from binocal.solvers.rules import FAR

NEAR_SIGMA = 3.0  # over all unknowns, a fraction of it for each: two classical steps end there whoever controls
FAR_TURN_RAD, FAR_SHIFT_SHARE = 0.01, 0.1  # of the next step of the rig: below both, projections hardly bend along it
FAR_PX = 20.0  # a typical corner nearer than this is a start that any solver takes well; closed-form ones reach 10
MAX_CONTROLLED_ITERATIONS = 15
MAX_REJECTIONS = 3
PROGRESS_WINDOW = 4  # iterations in which the distance that is left must have halved


@dataclass(frozen=True, slots=True)
class ControlledIteration:
    """What a controller chose in one iteration of one rig, and what came of it.

    ``decrement_sigma`` is the Gauss-Newton step's length over all unknowns before it, in standard deviations.
    """

    damping: float
    pose_damping: float
    scale_factor: float
    rotation_stretch: float
    translation_stretch: float
    bend: float
    decrement_sigma: float
    is_kept: bool


@dataclass(frozen=True, slots=True, eq=False)
class ControlledMinimum:
    """The minimum and how it was reached.

    ``fallback_reason`` says why a guard ended the controlled phase early; empty if none did. ``last_controlled`` is the
    estimate that the phase ended with.
    """

    problem: BundleProblem
    minimum: BundleMinimum
    controlled: tuple[ControlledIteration, ...]
    fallback_reason: str
    last_controlled: BundleEstimate

    @property
    def remaining_sigma(self) -> float:
        """How far R and T were from the minimum when the controlled phase ended, in standard deviations (norm over all six).

        0 where there was none.
        """
        return _remaining_sigma(self.problem, self.last_controlled, self.minimum) if self.controlled else 0.0


class FarPhase:
    """What ends the controlled phase: it is near, or a guard; and what happened in it."""

    is_running = None

    def __init__(self, *, leads_when_near: bool = False) -> None:
        self.leads_when_near = leads_when_near
        self.iterations: list[ControlledIteration] = []
        self.fallback_reason = ""
        self._decrement = np.inf
        self._n_rejected = 0

    def is_over(self, state: BundleState) -> bool:
        """Whether the solve is near, or goes nowhere."""
        done = self.iterations
        if self.fallback_reason:
            return True
        if len(done) == MAX_CONTROLLED_ITERATIONS:
            self.fallback_reason = f"not near after {MAX_CONTROLLED_ITERATIONS} iterations"
            return True
        self._decrement = float(state.decrement_sigma)
        if not np.isfinite(self._decrement) or not np.isfinite(state.cost_px2):
            self.fallback_reason = "the equations are singular or the start is impossible"
        elif self._decrement < NEAR_SIGMA or not (self.leads_when_near or _is_far(state)):
            return True
        elif len(done) >= PROGRESS_WINDOW and self._decrement > 0.5 * done[-PROGRESS_WINDOW].decrement_sigma:
            self.fallback_reason = f"the distance left did not halve in {PROGRESS_WINDOW} iterations"
        return bool(self.fallback_reason)

    def ends_before(self, state: BundleState, action: Action, step: BundleStep) -> bool:
        """Whether the controller asked for what is no number."""
        if not action.is_finite:
            self.fallback_reason = "the controller's output was not finite"
        return bool(self.fallback_reason)

    def record(self, state: BundleState, outcome: Outcome[Any, Any, Any]) -> None:
        """Take note; too many rejections in a row end the phase."""
        self.iterations.append(_record(outcome.action, self._decrement, state))
        self._n_rejected = 0 if state.is_kept else self._n_rejected + 1
        if self._n_rejected == MAX_REJECTIONS:
            self.fallback_reason = f"{MAX_REJECTIONS} rejected steps in a row"


def minimize_controlled(
    problem: BundleProblem,
    start: BundleEstimate,
    controller: Controller,
    options: LoopOptions | None = None,
    *,
    scale_px: float | ndarray | None = None,
    leads_when_near: bool = False,
) -> ControlledMinimum:
    """The robust minimum of one rig near ``start``: see the module's text.

    A controller is asked only for a rig whose whole transform is free. With ``leads_when_near`` it goes on where any solver would
    take the step well, until the next step is shorter than ``NEAR_SIGMA``: the steps are then the controller's own.
    """
    options = options or LoopOptions()
    noise_px = scale_px
    if noise_px is None:
        noise_px = problem.noise_estimate_px(problem.residual_lengths2(start))
        scale_px = options.scale_factor * noise_px
    is_movable = problem.is_stereo and problem.is_rig_free and problem.held_part is None
    is_near = not leads_when_near and np.isfinite(noise_px) and noise_px < FAR_PX
    if not is_movable or is_near:  # no more is spent than without a controller
        known_px = scale_px if np.isfinite(noise_px) else None
        return ControlledMinimum(problem, minimize(problem, start, options, scale_px=known_px), (), "", start)
    state = begin(problem, start, options.kernel, noise_px if np.isfinite(noise_px) else None)
    phase = FarPhase(leads_when_near=leads_when_near)
    end = run(problem, state, controller, options.kernel, FAR, phase)
    if phase.iterations:
        tail = replace(options, initial_damping=min(options.initial_damping, RESUMED_DAMPING))
        minimum = minimize(problem, end.estimate, tail, scale_px=options.scale_factor * end.mad_px)
    else:
        minimum = minimize(problem, start, options, scale_px=state.scale_px, equations=state.equations)
    total = replace(minimum, n_iterations=minimum.n_iterations + len(phase.iterations))
    return ControlledMinimum(problem, total, tuple(phase.iterations), phase.fallback_reason, end.estimate)


def _is_far(state: BundleState) -> bool:
    """Whether the fit is so bad and the rig's next step so long that how it is taken matters."""
    if float(state.mad_px) < FAR_PX:
        return False
    xi = state.newton.shared[-6:]
    turn, shift = float(np.linalg.norm(xi[:3])), float(np.linalg.norm(xi[3:]))
    return turn > FAR_TURN_RAD or shift > FAR_SHIFT_SHARE * float(np.linalg.norm(state.estimate.T_right_left.t))


def _remaining_sigma(problem: BundleProblem, last: BundleEstimate, minimum: BundleMinimum) -> float:
    """Mahalanobis length of R, T from the last controlled estimate to the minimum, all else free."""
    goal = minimum.estimate
    turn = so3.log(last.T_right_left.R @ goal.T_right_left.R.T)
    shift = last.T_right_left.t - goal.T_right_left.t - np.cross(turn, goal.T_right_left.t)
    information = problem.shared_information(goal, minimum.equations)
    xi = np.concatenate([turn, shift])
    rig = np.linalg.inv(np.linalg.inv(information)[-6:, -6:])  # all other shared unknowns eliminated
    return float(np.sqrt(max(xi @ rig @ xi, 0.0)) / minimum.scale_px)


def _record(action: Action, decrement: float, state: BundleState) -> ControlledIteration:
    stretch = (1.0, 1.0) if action.stretch is None else action.stretch.tolist()
    return ControlledIteration(
        float(action.damping),
        0.0 if action.pose_damping is None else float(action.pose_damping),
        float(action.scale_factor),
        float(stretch[0]),
        float(stretch[1]),
        0.0 if action.bend is None else float(action.bend),
        decrement,
        bool(state.is_kept),
    )
