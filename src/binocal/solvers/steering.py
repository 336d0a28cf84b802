"""One guarded iteration of the robust solve, with everything that a controller may choose laid open.

The loop is the same for every controller, classical or learned: linearise, step, evaluate one candidate, keep it only if
the robust cost falls. A controller chooses, rig by rig and iteration by iteration, the damping, the kernel's scale, how
far rotation and translation follow the step, and how much of the step's second-order correction is added. All functions
are pure and work on a batch of rigs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.geometry import SE3
from binocal.kernels import LastIteration
from binocal.kernels import observe as _observe
from binocal.shapes import Bool, Float
from binocal.solvers import robust
from binocal.solvers.arrays import choose_rigs
from binocal.solvers.board_views import (
    BundleEquations,
    BundleEstimate,
    BundleProblem,
    BundleStep,
)

MAX_CORRECTION = 1.0  # of the step itself, in rotation: beyond, the series does not converge
HARMLESS_TURN_RAD = 0.02  # a correction below this needs no such check
LOST_SHARE = 0.9  # of the cost that a view has when none of its left corners carries weight
LONGEST_TURN_RAD = 1.5  # a linear step that turns a camera further has lost all meaning


@dataclass(frozen=True, slots=True, eq=False)
class Action:
    """What a controller chooses for the next iteration; one value for each rig.

    ``damping`` is Marquardt's, 0 for Gauss-Newton; ``pose_damping`` holds the board poses back beyond it. ``scale_factor`` times
    the MAD noise is the kernel's scale. ``stretch`` multiplies the steps of rotation and translation. ``bend``
    above 0 asks for a corrected step, and is the share of the projections' second order that it follows.
    ``increment``, if given, takes the place of the rig's own step (rotation, translation; the paper's action).
    """

    damping: Float[ndarray, "*batch"]
    scale_factor: Float[ndarray, "*batch"]
    stretch: Float[ndarray, "*batch 2"] | None = None
    bend: Float[ndarray, "*batch"] | None = None
    pose_damping: Float[ndarray, "*batch"] | None = None
    increment: Float[ndarray, "*batch 6"] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class LoopState:
    """Where a batch of robust solves stands.

    ``newton`` is the undamped step from here, ``start_poses`` the board poses of the start. The others say what the last iteration
    did: whether its candidate was kept,
    actual over predicted fall of the cost, and the MAD noise and newton step before it.
    """

    estimate: BundleEstimate
    equations: BundleEquations
    newton: BundleStep
    scale_px: Float[ndarray, "*batch"]
    mad_px: Float[ndarray, "*batch"]
    is_kept: Bool[ndarray, "*batch"]
    gain: Float[ndarray, "*batch"]
    previous_mad_px: Float[ndarray, "*batch"]
    previous_newton: BundleStep
    start_poses: SE3

    @property
    def decrement_sigma(self) -> Float[ndarray, "*batch"]:
        """Length of the Gauss-Newton step over all unknowns, in standard deviations of the estimate."""
        return np.sqrt(np.maximum(2 * self.newton.predicted_px2, 0)) / self.mad_px


def begin(
    problem: BundleProblem,
    start: BundleEstimate,
    kernel: robust.Kernel,
    scale_px: float | Float[ndarray, "*batch"] | None = None,
) -> LoopState:
    """The state at a start; ``scale_px`` is a first guess of the kernel's scale (found from the residuals if None).

    Rigs whose start is impossible (a corner behind its camera) have an infinite cost.
    """
    if scale_px is None:
        mad = problem.noise_estimate_px(problem.residual_lengths2(start))
        mad = np.where(np.isfinite(mad), mad, 1.0)
    else:
        mad = np.broadcast_to(np.asarray(scale_px, dtype=float), start.T_left_board.t.shape[:-2]).copy()
    equations = problem.linearize(start, mad, kernel)
    newton = problem.solve_step(start, equations, np.zeros(mad.shape))
    ones = np.ones(mad.shape)
    return LoopState(start, equations, newton, mad, mad, ones > 0, ones, mad, newton, start.T_left_board)


def advance(problem: BundleProblem, state: LoopState, action: Action, kernel: robust.Kernel) -> LoopState:
    """One iteration: a candidate is evaluated, and kept where it is possible and lowers the robust cost."""
    step = propose(problem, state, action, kernel)
    candidate = _with_lost_views_restored(problem, state, problem.retract(state.estimate, step), kernel)
    ahead = problem.noise_estimate_px(problem.residual_lengths2(candidate))
    is_possible = np.isfinite(ahead) & np.isfinite(step.predicted_px2)
    mad = np.where(is_possible, ahead, state.mad_px)
    # the kernel may close as fast as the fit improves, and opens only when asked to
    scale = np.maximum(action.scale_factor * np.minimum(mad, state.mad_px), robust.SCALE_FLOOR_PX)
    trial = problem.linearize(candidate, scale, kernel)
    before = state.equations.cost_under(scale, kernel)
    is_kept = is_possible & (trial.cost_px2 < before)
    if is_kept.all():
        estimate, equations = candidate, trial
    else:
        estimate = choose_rigs(is_kept, candidate, state.estimate)
        equations = choose_rigs(is_kept, trial, state.equations)
        scale, mad = np.where(is_kept, scale, state.scale_px), np.where(is_kept, mad, state.mad_px)
    newton = problem.solve_step(estimate, equations, np.zeros(mad.shape)) if is_kept.any() else state.newton
    gain = np.full(mad.shape, -1.0)
    fall = np.subtract(before, trial.cost_px2, out=np.zeros(mad.shape), where=is_kept)
    np.divide(fall, np.maximum(step.predicted_px2, 1e-30), out=gain, where=is_kept)
    return LoopState(
        estimate,
        equations,
        newton,
        scale,
        mad,
        is_kept,
        np.minimum(gain, 3.0),
        state.mad_px,
        state.newton,
        state.start_poses,
    )


def propose(problem: BundleProblem, state: LoopState, action: Action, kernel: robust.Kernel) -> BundleStep:
    """The step that an action asks for."""
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
    step = _limited(step)
    if action.bend is None or not np.any(action.bend > 0):
        return step
    straight = problem.straightened(state.estimate, step, action.bend)
    mad = straight.noise_estimate_px(straight.residual_lengths2(state.estimate))
    scale = np.maximum(action.scale_factor * np.where(np.isfinite(mad), mad, state.mad_px), robust.SCALE_FLOOR_PX)
    equations = straight.linearize(state.estimate, scale, kernel)
    correction = straight.solve_step(state.estimate, equations, action.damping, pose_damping=pose_damping)
    longest = np.maximum(MAX_CORRECTION * _turn_rad(step), HARMLESS_TURN_RAD)
    is_sound = (action.bend > 0) & np.isfinite(correction.predicted_px2) & (_turn_rad(correction) <= longest)
    return replace(
        step,
        shared=step.shared + np.where(is_sound[..., None], correction.shared, 0.0),
        views=step.views + np.where(is_sound[..., None, None], correction.views, 0.0),
    )


def _with_lost_views_restored(
    problem: BundleProblem, state: LoopState, candidate: BundleEstimate, kernel: robust.Kernel
) -> BundleEstimate:
    """The candidate with the poses of views back at the start whose left corners have all lost their weight.

    A redescending kernel gives a view that an early step threw off no way back; the start's pose fitted the left image.
    """
    if kernel != "hampel":
        return candidate
    left = problem.cameras[0]
    no_weight = robust.HAMPEL_LIMIT * np.square(state.equations.scale_px)[..., None] * left.is_seen.sum(axis=-1)
    is_lost = (state.equations.cameras[0].cost_px2 > LOST_SHARE * no_weight) & (no_weight > 0)
    if not is_lost.any():
        return candidate
    return replace(candidate, T_left_board=choose_rigs(is_lost, state.start_poses, candidate.T_left_board))


OBSERVED = (
    "log10 length of the Gauss-Newton step, sigmas",
    "rotation's share of the rig's decrement",
    "the rig's share of the whole decrement",
    "log10 least pivot of the equilibrated shared equations",
    "log10 rotation step of the rig, rad",
    "log10 translation step of the rig over the baseline",
    "log10 RMS rotation step of the boards, rad",
    "log10 RMS translation step of the boards over their distance",
    "log2 lower quartile of the residual lengths over the MAD noise",
    "log2 median of the same",
    "log2 upper quartile of the same",
    "log2 ninth decile of the same",
    "share of corners beyond 3.5 MAD noise",
    "share of corners beyond 7",
    "log2 residual, right over left",
    "spread of the views' log2 residuals, left",
    "spread of the views' log2 residuals, right",
    "log10 number of corners, over 1000",
    "log10 kernel scale over the MAD noise",
    "log10 MAD noise over that before the last iteration",
    "log10 Gauss-Newton step over that before the last iteration",
    "gain ratio of the last iteration",
    "last candidate kept",
    "cosine of this and the last rig step",
)
"""What :func:`observe` returns, in order."""


def observe(problem: BundleProblem, state: LoopState) -> Float[ndarray, "*batch f"]:
    """Scale-free numbers of the state, all of them at hand: residuals, the solver's own equations, the last iteration."""
    last = LastIteration(state.scale_px, state.gain, state.is_kept, state.previous_mad_px, state.previous_newton)
    return _observe(
        tuple(e.r2_px2 for e in state.equations.cameras),
        tuple(camera.is_seen for camera in problem.cameras),
        state.mad_px,
        state.newton,
        state.estimate.T_right_left.t,
        state.estimate.T_left_board.t,
        last,
    )


def _turn_rad(step: BundleStep) -> Float[ndarray, "*batch"]:
    omega = step.shared[..., -6:-3]
    return np.sqrt((omega * omega).sum(axis=-1))


def _limited(step: BundleStep) -> BundleStep:
    """The step, shortened where it would turn the rig by more than a camera can turn and still see the board."""
    turn = _turn_rad(step)
    if not (turn > LONGEST_TURN_RAD).any():
        return step
    share = np.minimum(1.0, LONGEST_TURN_RAD / np.maximum(turn, 1e-300))
    return replace(step, shared=step.shared * share[..., None], views=step.views * share[..., None, None])
