"""A robust solve whose far phase is led by a controller, and whose end is the classical one.

The controller, learned or not, chooses while the rig's steps are so long that the way they are taken matters. It can waste
iterations and nothing else: a candidate is kept only if it lowers the robust cost and stays in front of the cameras, three
rejections in a row or a number that is not finite hand the solve over, and the classical loop finishes from the best point
in any case, to its own stop rule.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from binocal.geometry import so3
from binocal.solvers.board_views import (
    BundleEstimate,
    BundleProblem,
)
from binocal.solvers.controllers import Controller
from binocal.solvers.least_squares import RESUMED_DAMPING, LoopOptions, Minimum, minimize
from binocal.solvers.steering import Action, LoopState, advance, begin

if TYPE_CHECKING:
    from numpy import ndarray

NEAR_SIGMA = 3.0  # over all unknowns, a fraction of it for each: two classical steps end there whoever leads
FAR_TURN_RAD, FAR_SHIFT_SHARE = 0.01, 0.1  # of the next step of the rig: below both, projections hardly bend along it
FAR_PX = 20.0  # a typical corner nearer than this is a start that any solver takes well; closed-form ones reach 10
MAX_LED_ITERATIONS = 15
MAX_REJECTIONS = 3
PROGRESS_WINDOW = 4  # iterations in which the way that is left must have halved


@dataclass(frozen=True, slots=True)
class LedIteration:
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
class SteeredMinimum:
    """The minimum and the way to it. ``handed_over`` says why a guard ended the lead early; empty if none did.

    ``left_off`` is where the controller's last iteration came to.
    """

    problem: BundleProblem
    minimum: Minimum
    led: tuple[LedIteration, ...]
    handed_over: str
    left_off: BundleEstimate

    @property
    def remaining_sigma(self) -> float:
        """How far R and T were from the minimum where the controller left off, in standard deviations (norm over all six).

        0 where it was not asked.
        """
        return _way_left_sigma(self.problem, self.left_off, self.minimum) if self.led else 0.0


def minimize_steered(
    problem: BundleProblem,
    start: BundleEstimate,
    controller: Controller,
    options: LoopOptions | None = None,
    *,
    scale_px: float | ndarray | None = None,
) -> SteeredMinimum:
    """The robust minimum of one rig near ``start``: see the module's text."""
    options = options or LoopOptions()
    noise_px = scale_px
    if noise_px is None:
        noise_px = problem.noise_estimate_px(problem.residual_lengths2(start))
        scale_px = options.scale_factor * noise_px
    if np.isfinite(noise_px) and noise_px < FAR_PX:  # near: no more is spent than without a controller
        return SteeredMinimum(problem, minimize(problem, start, options, scale_px=scale_px), (), "", start)
    state = begin(problem, start, options.kernel, noise_px if np.isfinite(noise_px) else None)
    memory = controller.start(state.mad_px.shape)
    led: list[LedIteration] = []
    handed_over, n_rejected = "", 0
    while len(led) < MAX_LED_ITERATIONS:
        decrement = float(state.decrement_sigma)
        if not np.isfinite(decrement) or not np.isfinite(state.equations.cost_px2):
            handed_over = "the equations are singular or the start is impossible"
            break
        if decrement < NEAR_SIGMA or not _is_far(state):
            break
        if len(led) >= PROGRESS_WINDOW and decrement > 0.5 * led[-PROGRESS_WINDOW].decrement_sigma:
            handed_over = f"the way left did not halve in {PROGRESS_WINDOW} iterations"
            break
        action, memory = controller.choose(problem, state, memory)
        if not _is_finite(action):
            handed_over = "the controller's output was not finite"
            break
        state = advance(problem, state, action, options.kernel)
        led.append(_record(action, decrement, state))
        n_rejected = 0 if led[-1].is_kept else n_rejected + 1
        if n_rejected == MAX_REJECTIONS:
            handed_over = f"{MAX_REJECTIONS} rejected steps in a row"
            break
    else:
        handed_over = f"not near after {MAX_LED_ITERATIONS} iterations"
    if led:
        tail = replace(options, initial_damping=min(options.initial_damping, RESUMED_DAMPING))
        minimum = minimize(problem, state.estimate, tail, scale_px=options.scale_factor * state.mad_px)
    else:
        minimum = minimize(problem, start, options, scale_px=state.scale_px, equations=state.equations)
    total = replace(minimum, n_iterations=minimum.n_iterations + len(led))
    return SteeredMinimum(problem, total, tuple(led), handed_over, state.estimate)


def _is_far(state: LoopState) -> bool:
    """Whether the fit is so bad and the rig's next step so long that how it is taken matters."""
    if float(state.mad_px) < FAR_PX:
        return False
    xi = state.newton.shared[-6:]
    turn, shift = float(np.linalg.norm(xi[:3])), float(np.linalg.norm(xi[3:]))
    return turn > FAR_TURN_RAD or shift > FAR_SHIFT_SHARE * float(np.linalg.norm(state.estimate.T_right_left.t))


def _way_left_sigma(problem: BundleProblem, last: BundleEstimate, minimum: Minimum) -> float:
    """Mahalanobis length of R, T from the controller's last point to the minimum, all else free."""
    goal = minimum.estimate
    turn = so3.log(last.T_right_left.R @ goal.T_right_left.R.T)
    shift = last.T_right_left.t - goal.T_right_left.t - np.cross(turn, goal.T_right_left.t)
    information = problem.shared_information(goal, minimum.equations)
    xi = np.concatenate([turn, shift])
    rig = np.linalg.inv(np.linalg.inv(information)[-6:, -6:])  # all other shared unknowns eliminated
    return float(np.sqrt(max(xi @ rig @ xi, 0.0)) / minimum.scale_px)


def _record(action: Action, decrement: float, state: LoopState) -> LedIteration:
    stretch = (1.0, 1.0) if action.stretch is None else action.stretch.tolist()
    return LedIteration(
        float(action.damping),
        0.0 if action.pose_damping is None else float(action.pose_damping),
        float(action.scale_factor),
        float(stretch[0]),
        float(stretch[1]),
        0.0 if action.bend is None else float(action.bend),
        decrement,
        bool(state.is_kept),
    )


def _is_finite(action: Action) -> bool:
    parts = (
        action.damping,
        action.scale_factor,
        action.stretch,
        action.bend,
        action.pose_damping,
        action.increment,
    )
    return all(part is None or bool(np.isfinite(part).all()) for part in parts)
