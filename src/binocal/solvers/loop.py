"""The one guarded loop of every robust solve: a controller chooses how an iteration is done, the guards decide what becomes of it.

An iteration linearises, solves the step that the controller's :class:`~binocal.solvers.loop_state.Action` asks for, evaluates one
candidate, and keeps it only where it is possible and the robust cost falls. Classical controllers and the learned one go through
the same :func:`iterate`. Two sets of rules say how the kernel's scale follows the residuals and which guards are worth their time:
:data:`NEAR` for starts that any solver takes well, which every solve ends with, and :data:`FAR` for long steps, whose
controllers see more of the state. All functions are pure and work on a batch of rigs.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy import ndarray

from binocal.shapes import Bool, Float, Int
from binocal.solvers import robust
from binocal.solvers.arrays import choose_rigs
from binocal.solvers.board_views import BundleEquations, BundleEstimate, BundleProblem, BundleStep
from binocal.solvers.controllers import Marquardt, Schedule
from binocal.solvers.loop_state import Action, Controller, LoopState

CLOSING_RATIO = 0.9  # the scale fell by more than this in a step: the kernel is still closing
SETTLED_SHARE = 0.01  # of the scale; a difference that no weight feels
START_DAMPING = 1e-6
RESUMED_DAMPING = 1e-9  # of a solve that begins near its minimum: more would take short steps there for arrival
ARRIVAL_DAMPING = 1e-5  # more would make a step short on its own
MAX_DAMPING = 1e8
EXACT_SHARE = 1e-4  # of the tolerance where corners are exact


@dataclass(frozen=True, slots=True)
class LoopRules:
    """Which guards an iteration has, and how the kernel's scale follows the residuals.

    ``is_observed``: the controller looks at the undamped step and at the last gain. Then also: the scale is that of the better
    one of estimate and candidate and opens when the controller asks, a rejected candidate leaves it as it was; steps that turn
    the rig too far are shortened; views that an early step threw off go back to their start. Otherwise: the scale is that of
    the candidate where that is smaller, rejected or not, until it stops falling, and settles on that of the estimate.
    """

    is_observed: bool


FAR = LoopRules(is_observed=True)
NEAR = LoopRules(is_observed=False)


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

    @property
    def controller(self) -> Marquardt:
        """Levenberg-Marquardt as the classical solve takes it: nearly Gauss-Newton, quick to let a damping go."""
        return Marquardt(self.initial_damping, fall=30.0, schedule=Schedule((self.scale_factor,)))


@dataclass(frozen=True, slots=True, eq=False)
class Minimum:
    """Where the loop ended. ``equations`` were linearised at ``estimate`` with ``kernel``, the kernel's scale is ``scale_px``."""

    estimate: BundleEstimate
    equations: BundleEquations
    scale_px: Float[ndarray, "*batch"]
    kernel: robust.Kernel
    n_iterations: Int[ndarray, "*batch"]
    is_converged: Bool[ndarray, "*batch"]
    options: LoopOptions = field(default_factory=LoopOptions)


@dataclass(frozen=True, slots=True, eq=False)
class _Kept:
    """The better one of estimate and candidate, rig by rig, and the scale under which they competed."""

    is_kept: Bool[ndarray, "*batch"]
    estimate: BundleEstimate
    equations: BundleEquations
    cost_px2: Float[ndarray, "*batch"]
    scale_px: Float[ndarray, "*batch"]


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """One candidate's robust cost and that of the estimate before it, both under the same scale."""

    cost_px2: Float[ndarray, "*batch"]
    before_px2: Float[ndarray, "*batch"]


class Watch(Protocol):
    """What ends a loop. It sees every iteration and may count."""

    is_running: Bool[ndarray, "*batch"] | None
    """Rigs whose candidates may be kept; None: all."""

    def is_over(self, state: LoopState) -> bool:
        """Whether to end before the controller is asked."""
        ...

    def ends_before(self, state: LoopState, action: Action, step: BundleStep) -> bool:
        """Whether to end instead of evaluating the step."""
        ...

    def record(self, state: LoopState, action: Action, trial: Trial) -> None:
        """Take note of an iteration; ``state`` is that after it."""
        ...


def begin(
    problem: BundleProblem,
    start: BundleEstimate,
    kernel: robust.Kernel,
    scale_px: float | Float[ndarray, "*batch"] | None = None,
    *,
    rules: LoopRules = FAR,
    scale_factor: float = 1.0,
    equations: BundleEquations | None = None,
) -> LoopState:
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
    newton = problem.solve_step(start, equations, np.zeros(mad.shape)) if rules.is_observed else None
    kept = np.ones(mad.shape, dtype=bool)
    return LoopState(
        start,
        equations,
        equations.cost_px2,
        scale,
        mad,
        kept,
        start,
        ~kept,
        kernel != "squared",
        newton,
        np.ones(mad.shape),
        mad,
        newton,
    )


def run(
    problem: BundleProblem,
    state: LoopState,
    controller: Controller,
    kernel: robust.Kernel,
    rules: LoopRules,
    watch: Watch,
) -> LoopState:
    """The loop itself: iterations of a controller until the watch ends them."""
    memory = controller.start(state.scale_px.shape)
    while not watch.is_over(state):
        action, memory = controller.choose(problem, state, memory)
        step = propose(problem, state, action, kernel, rules)
        if watch.ends_before(state, action, step):
            break
        state, trial = iterate(problem, state, action, step, kernel, rules, watch.is_running)
        watch.record(state, action, trial)
    return state


def advance(
    problem: BundleProblem, state: LoopState, action: Action, kernel: robust.Kernel, rules: LoopRules = FAR
) -> LoopState:
    """One iteration with a given action."""
    return iterate(problem, state, action, propose(problem, state, action, kernel, rules), kernel, rules)[0]


def propose(
    problem: BundleProblem, state: LoopState, action: Action, kernel: robust.Kernel, rules: LoopRules = FAR
) -> BundleStep:
    """The step that an action asks for."""
    if not rules.is_observed:
        return problem.solve_step(state.estimate, state.equations, action.damping)
    pose_damping = action.damping if action.pose_damping is None else action.damping + action.pose_damping
    step = state.newton
    if action.increment is not None or action.stretch is not None or np.any(pose_damping > 0):
        step = problem.solve_step(
            state.estimate,
            state.equations,
            action.damping,
            action.stretch,
            increment=action.increment,
            pose_damping=pose_damping,
        )
    step = problem.limited(step)
    if action.bend is None or not np.any(action.bend > 0):
        return step
    straight = problem.straightened(state.estimate, step, action.bend)
    mad = straight.noise_estimate_px(straight.residual_lengths2(state.estimate))
    scale = np.maximum(action.scale_factor * np.where(np.isfinite(mad), mad, state.mad_px), robust.SCALE_FLOOR_PX)
    equations = straight.linearize(state.estimate, scale, kernel)
    correction = straight.solve_step(state.estimate, equations, action.damping, pose_damping=pose_damping)
    return problem.corrected(step, correction, action.bend > 0)


def iterate(
    problem: BundleProblem,
    state: LoopState,
    action: Action,
    step: BundleStep,
    kernel: robust.Kernel,
    rules: LoopRules,
    is_running: Bool[ndarray, "*batch"] | None = None,
) -> tuple[LoopState, Trial]:
    """One candidate evaluated, and kept where it is possible and lowers the robust cost."""
    candidate = problem.retract(state.estimate, step)
    if rules.is_observed and kernel == "hampel":
        candidate = problem.with_lost_views_restored(candidate, state.equations, state.start)
    mad, scale = _look_ahead(problem, state, action, candidate, rules)
    trial = problem.linearize(candidate, scale, kernel)
    before = _cost_under(state.equations, state.cost_px2, state.scale_px, scale, kernel)
    is_kept = trial.cost_px2 < before
    if rules.is_observed:
        is_kept = is_kept & np.isfinite(mad) & np.isfinite(step.predicted_px2)
    if is_running is not None:
        is_kept = is_running & is_kept
    estimate, equations, cost = candidate, trial, trial.cost_px2
    if not is_kept.all():
        estimate = choose_rigs(is_kept, candidate, state.estimate) if is_kept.any() else state.estimate
        equations = choose_rigs(is_kept, trial, state.equations) if is_kept.any() else state.equations
        cost = np.where(is_kept, trial.cost_px2, before)
    kept = _Kept(is_kept, estimate, equations, cost, scale)
    tried = Trial(trial.cost_px2, before)
    if rules.is_observed:
        return _observed(problem, state, kept, kernel, mad, step, tried), tried
    return _settled(problem, state, kept, kernel, action, is_running), tried


def _look_ahead(
    problem: BundleProblem, state: LoopState, action: Action, candidate: BundleEstimate, rules: LoopRules
) -> tuple[Float[ndarray, "*batch"], Float[ndarray, "*batch"]]:
    """MAD noise of the candidate and the scale under which it competes: closer already where its fit is better.

    It costs a quarter of an iteration and saves the one that would only close the kernel.
    """
    if not (rules.is_observed or state.is_closing):
        return state.mad_px, state.scale_px
    ahead = problem.noise_estimate_px(problem.residual_lengths2(candidate))
    if rules.is_observed:
        best = np.where(np.isfinite(ahead), np.minimum(ahead, state.mad_px), state.mad_px)
        return ahead, np.maximum(action.scale_factor * best, robust.SCALE_FLOOR_PX)
    scaled = action.scale_factor * ahead
    return ahead, np.where(scaled < state.scale_px, scaled, state.scale_px)


def _cost_under(
    equations: BundleEquations,
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


def _observed(
    problem: BundleProblem,
    state: LoopState,
    kept: _Kept,
    kernel: robust.Kernel,
    ahead_px: Float[ndarray, "*batch"],
    step: BundleStep,
    trial: Trial,
) -> LoopState:
    """The state for a controller that observes: the scale is the candidate's where it was kept, else what it was."""
    is_kept, scale, mad, cost = kept.is_kept, kept.scale_px, ahead_px, kept.cost_px2
    if not is_kept.all():
        scale, mad = np.where(is_kept, scale, state.scale_px), np.where(is_kept, mad, state.mad_px)
        cost = np.where(is_kept, cost, state.cost_px2)
    newton = problem.solve_step(kept.estimate, kept.equations, np.zeros(mad.shape)) if is_kept.any() else state.newton
    gain = np.full(mad.shape, -1.0)
    fall = np.subtract(trial.before_px2, trial.cost_px2, out=np.zeros(mad.shape), where=is_kept)
    np.divide(fall, np.maximum(step.predicted_px2, 1e-30), out=gain, where=is_kept)
    return replace(
        state,
        estimate=kept.estimate,
        equations=kept.equations,
        cost_px2=cost,
        scale_px=scale,
        mad_px=mad,
        is_kept=is_kept,
        newton=newton,
        gain=np.minimum(gain, 3.0),
        previous_mad_px=state.mad_px,
        previous_newton=state.newton,
    )


def _settled(
    problem: BundleProblem,
    state: LoopState,
    kept: _Kept,
    kernel: robust.Kernel,
    action: Action,
    is_running: Bool[ndarray, "*batch"] | None,
) -> LoopState:
    """The state whose scale has moved to the estimate's MAD noise where a candidate was kept, until it hardly moves."""
    noise = problem.noise_estimate_px(kept.equations.r2_px2)
    wanted = np.maximum(action.scale_factor * noise, 1e-300)
    is_settled = (np.abs(wanted - kept.scale_px) < SETTLED_SHARE * kept.scale_px) | (kernel == "squared")
    fell = wanted < CLOSING_RATIO * state.scale_px
    is_closing = state.is_closing and bool(np.any(fell if is_running is None else fell & is_running))
    scale = np.where(kept.is_kept & ~is_settled, wanted, kept.scale_px)
    cost = _cost_under(kept.equations, kept.cost_px2, kept.scale_px, scale, kernel)
    return LoopState(
        kept.estimate,
        kept.equations,
        cost,
        scale,
        noise,
        kept.is_kept,
        state.start,
        is_settled,
        is_closing,
        state.newton,
        state.gain,
        state.previous_mad_px,
        state.previous_newton,
    )


class Arrival:
    """The classical stop rule, and what it has found: where a solve has arrived, and after how many iterations."""

    def __init__(self, state: LoopState, options: LoopOptions) -> None:
        batch = state.scale_px.shape
        self.options = options
        self.is_running = np.isfinite(state.cost_px2)
        self.is_converged = np.zeros(batch, dtype=bool)
        self.n_iterations = np.zeros(batch, dtype=int)
        self._count = 0

    def is_over(self, state: LoopState) -> bool:
        """Whether the iterations ran out or nothing runs."""
        return self._count == self.options.max_iterations or not self.is_running.any()

    def ends_before(self, state: LoopState, action: Action, step: BundleStep) -> bool:
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

    def record(self, state: LoopState, action: Action, trial: Trial) -> None:
        """Count, and stop what has arrived with this step."""
        self.n_iterations += self.is_running
        # exact corners: go on while the cost still falls by half, down to its rounding floor
        is_floor = ~self._is_exact | ~(trial.cost_px2 < 0.5 * trial.before_px2)
        # a rejected step that was already too short to matter is convergence too
        done = self.is_running & self._is_short & is_floor & (state.is_settled | ~state.is_kept)
        self.is_converged |= done
        self.is_running &= ~done


def minimize(
    problem: BundleProblem,
    start: BundleEstimate,
    options: LoopOptions | None = None,
    *,
    scale_px: float | Float[ndarray, "*batch"] | None = None,
    equations: BundleEquations | None = None,
) -> Minimum:
    """Robust minimum near ``start`` by Levenberg-Marquardt.

    ``scale_px`` is a first guess of the kernel's scale (found from the residuals if None); ``equations`` may be those of the
    start under that scale, if they are at hand.

    ``is_converged`` is False where the iterations ran out, or where no damping made the cost fall although a step was
    due.
    """
    options = options or LoopOptions()
    state = begin(
        problem,
        start,
        options.kernel,
        scale_px,
        rules=NEAR,
        scale_factor=options.scale_factor,
        equations=equations,
    )
    arrival = Arrival(state, options)
    state = run(problem, state, options.controller, options.kernel, NEAR, arrival)
    return Minimum(
        state.estimate,
        state.equations,
        state.scale_px,
        options.kernel,
        arrival.n_iterations,
        arrival.is_converged,
        options,
    )
