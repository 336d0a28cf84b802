"""The classical robust solve: Levenberg-Marquardt in the guarded loop, to a stop rule in standard deviations."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Generic

import numpy as np
from numpy import ndarray

from binocal.shapes import Bool, Float, Int
from binocal.solvers import robust
from binocal.solvers.controllers import Marquardt, Schedule
from binocal.solvers.loop import begin, run
from binocal.solvers.loop_state import Action, LoopState, Outcome
from binocal.solvers.problem import E, Problem, Q, S, Step
from binocal.solvers.rules import NEAR, PATIENT

START_DAMPING = 1e-6
RESUMED_DAMPING = 1e-9  # of a solve that begins near its minimum: more would take short steps there for arrival
ARRIVAL_DAMPING = 1e-5  # more would make a step short on its own
MAX_DAMPING = 1e8
EXACT_SHARE = 1e-4  # of the tolerance where corners are exact


@dataclass(frozen=True, slots=True)
class LoopOptions:
    """How a classical solve runs."""

    kernel: robust.Kernel = "hampel"
    scale_factor: float = 1.0
    """Kernel scale over the MAD noise estimate; above 1 the kernel is kept open on purpose."""
    max_iterations: int = 50
    tolerance_sigma: float = 0.02
    """Stop where the next step would be shorter than this: its norm over all unknowns, in standard deviations of the
    estimate; for one parameter among hundreds it is far shorter. On exact corners the tolerance is 10⁴ times smaller."""
    initial_damping: float = START_DAMPING
    is_patient: bool = False
    """For problems on which the ordinary loop creeps (:class:`binocal.solvers.rules.Patient`): dearer iterations, steady damping."""

    @property
    def controller(self) -> Marquardt:
        """Levenberg-Marquardt as the classical solve takes it: nearly Gauss-Newton, quick to let a damping go."""
        if self.is_patient:
            return Marquardt(self.initial_damping, fall=3.0, rise=5.0, least_raised=1e-9)
        return Marquardt(self.initial_damping, fall=30.0, schedule=Schedule((self.scale_factor,)))


@dataclass(frozen=True, slots=True, eq=False)
class Minimum(Generic[E, Q]):
    """Where the loop ended. ``equations`` were linearised at ``estimate`` with ``kernel``, the kernel's scale is ``scale_px``."""

    estimate: E
    equations: Q
    scale_px: Float[ndarray, "*batch"]
    kernel: robust.Kernel
    n_iterations: Int[ndarray, "*batch"]
    is_converged: Bool[ndarray, "*batch"]
    options: LoopOptions = field(default_factory=LoopOptions)


class Arrival:
    """The classical stop rule, and what it has found: where a solve has arrived, and after how many iterations."""

    def __init__(self, state: LoopState[Any, Any, Any], options: LoopOptions) -> None:
        batch = state.scale_px.shape
        self.options = options
        self.is_running = np.isfinite(state.cost_px2)
        self.is_converged = np.zeros(batch, dtype=bool)
        self.n_iterations = np.zeros(batch, dtype=int)
        self._count = 0

    def is_over(self, state: LoopState[Any, Any, Any]) -> bool:
        """Whether the iterations ran out or nothing runs."""
        return self._count == self.options.max_iterations or not self.is_running.any()

    def ends_before(self, state: LoopState[Any, Any, Any], action: Action, step: Step) -> bool:
        """Whether every rig has arrived: its step is short, its scale settled, and no damping made the step short."""
        options, scale = self.options, state.scale_px
        self._count += 1
        self.is_running &= action.damping < MAX_DAMPING
        step_px = np.sqrt(np.maximum(2 * step.predicted_px2, 0))
        self._is_exact = scale <= options.scale_factor * robust.SCALE_FLOOR_PX
        self._is_short = step_px < options.tolerance_sigma * scale * np.where(self._is_exact, EXACT_SHARE, 1.0)
        arrived = (
            self.is_running & self._is_short & state.is_settled & ~self._is_exact & (action.damping < ARRIVAL_DAMPING)
        )
        self.is_converged |= arrived
        self.is_running &= ~arrived
        return not self.is_running.any()

    def record(self, state: LoopState[Any, Any, Any], outcome: Outcome[Any, Any, Any]) -> None:
        """Count, and stop what has arrived with this step."""
        self.n_iterations += self.is_running
        # exact corners: go on while the cost still falls by half, down to its rounding floor
        is_floor = ~self._is_exact | ~(outcome.trial_px2 < 0.5 * outcome.before_px2)
        # a rejected step that was already too short to matter is convergence too
        done = self.is_running & self._is_short & is_floor & (state.is_settled | ~state.is_kept)
        self.is_converged |= done
        self.is_running &= ~done


def minimize(
    problem: Problem[E, Q, S],
    start: E,
    options: LoopOptions | None = None,
    *,
    scale_px: float | Float[ndarray, "*batch"] | None = None,
    equations: Q | None = None,
) -> Minimum[E, Q]:
    """Robust minimum near ``start`` by Levenberg-Marquardt.

    ``scale_px`` is a first guess of the kernel's scale (found from the residuals if None); ``equations`` may be those of the
    start under that scale, if they are at hand.

    ``is_converged`` is False where the iterations ran out, or where no damping made the cost fall although a step was
    due.
    """
    options = options or LoopOptions()
    rules = PATIENT if options.is_patient else NEAR
    state = begin(
        problem,
        start,
        options.kernel,
        scale_px,
        rules=rules,
        scale_factor=options.scale_factor,
        equations=equations,
    )
    arrival = Arrival(state, options)
    state = run(problem, state, options.controller, options.kernel, rules, arrival)
    return Minimum(
        state.estimate,
        state.equations,
        state.scale_px,
        options.kernel,
        arrival.n_iterations,
        arrival.is_converged,
        options,
    )
