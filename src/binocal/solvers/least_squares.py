"""The guarded robust Levenberg-Marquardt loop over a batch of rigs.

A candidate is kept only if the robust cost falls; a rejected one raises the damping. The scale of the kernel follows
the median residual (MAD) of the estimate that is kept, so the kernel closes by itself as the fit improves.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy import ndarray

from binocal.shapes import Bool, Float, Int
from binocal.solvers import robust
from binocal.solvers.arrays import choose_rigs
from binocal.solvers.board_views import (
    BundleEquations,
    BundleEstimate,
    BundleProblem,
)

CLOSING_RATIO = 0.9  # the scale fell by more than this in a step: the kernel is still closing
START_DAMPING = 1e-6
RESUMED_DAMPING = 1e-9  # of a solve that begins near its minimum: more would take short steps there for arrival
ARRIVAL_DAMPING = 1e-5  # more would make a step short on its own


@dataclass(frozen=True, slots=True)
class LoopOptions:
    """How the loop runs."""

    kernel: robust.Kernel = "hampel"
    scale_factor: float = 1.0
    """Kernel scale over the MAD noise estimate; above 1 the kernel is kept open on purpose."""
    max_iterations: int = 50
    tolerance_sigma: float = 0.02
    """Stop where the next step would be shorter than this: its norm over all unknowns, in standard deviations of the
    estimate; for one parameter among hundreds it is far shorter. On exact corners the tolerance is 10⁴ times smaller."""
    initial_damping: float = START_DAMPING
    damping_fall: float = 30.0
    damping_rise: float = 10.0
    least_raised_damping: float = (
        1e-6  # weak directions have eigenvalues of 1e-7 of the diagonal: less would not be felt
    )
    max_damping: float = 1e8


@dataclass(frozen=True, slots=True, eq=False)
class Minimum:
    """Where the loop ended. ``equations`` were linearised at ``estimate`` with ``kernel`` and ``scale_px``."""

    estimate: BundleEstimate
    equations: BundleEquations
    scale_px: Float[ndarray, "*batch"]
    kernel: robust.Kernel
    n_iterations: Int[ndarray, "*batch"]
    is_converged: Bool[ndarray, "*batch"]
    options: LoopOptions = field(default_factory=LoopOptions)


def minimize(
    problem: BundleProblem,
    start: BundleEstimate,
    options: LoopOptions | None = None,
    *,
    scale_px: Float[ndarray, "*batch"] | None = None,
    equations: BundleEquations | None = None,
) -> Minimum:
    """Robust minimum near ``start``.

    ``scale_px`` is a first guess of the kernel's scale (found from the residuals if None); ``equations`` may be those of the
    start under that scale, if they are at hand.

    ``is_converged`` is False where the iterations ran out, or where no damping made the cost fall although a step was
    due.
    """
    options = options or LoopOptions()
    kernel = options.kernel
    batch = start.T_left_board.t.shape[:-2]
    if scale_px is None:
        noise_px = problem.noise_estimate_px(problem.residual_lengths2(start))
        scale = options.scale_factor * np.where(np.isfinite(noise_px), noise_px, 1.0)
    else:
        scale = np.broadcast_to(np.asarray(scale_px, dtype=float), batch).copy()
    equations = problem.linearize(start, scale, kernel) if equations is None else equations
    estimate, cost = start, equations.cost_px2
    damping = np.full(batch, options.initial_damping)
    is_settled = np.zeros(batch, dtype=bool)
    n_iterations = np.zeros(batch, dtype=int)
    is_converged = np.zeros(batch, dtype=bool)
    is_running = np.isfinite(cost)
    is_closing = kernel != "squared"
    for _ in range(options.max_iterations):
        if not is_running.any():
            break
        scale_before = scale
        step = problem.solve_step(estimate, equations, damping)
        step_px = np.sqrt(np.maximum(2 * step.predicted_px2, 0))
        is_exact = scale <= options.scale_factor * robust.SCALE_FLOOR_PX
        is_short = step_px < options.tolerance_sigma * scale * np.where(is_exact, 1e-4, 1.0)
        arrived = is_running & is_short & is_settled & ~is_exact & (damping < ARRIVAL_DAMPING)
        is_converged |= arrived
        is_running &= ~arrived
        if not is_running.any():
            break
        candidate = problem.retract(estimate, step)
        if (
            is_closing
        ):  # a look ahead costs a quarter of an iteration and saves the one that would only close the kernel
            ahead_px = options.scale_factor * problem.noise_estimate_px(problem.residual_lengths2(candidate))
            closer = np.where(is_running & (ahead_px < scale), ahead_px, scale)
            cost = np.where(closer < scale, equations.cost_under(closer, kernel), cost)
            scale = closer
        trial = problem.linearize(candidate, scale, kernel)
        n_iterations += is_running
        is_better = trial.cost_px2 < cost
        take = is_running & is_better
        if take.all():
            estimate, equations = candidate, trial
        elif take.any():
            estimate = choose_rigs(take, candidate, estimate)
            equations = choose_rigs(take, trial, equations)
        mad = np.maximum(
            options.scale_factor * problem.noise_estimate_px(tuple(e.r2_px2 for e in equations.cameras)), 1e-300
        )
        is_settled = (np.abs(mad - scale) < 0.01 * scale) | (kernel == "squared")
        is_closing = is_closing and bool(np.any(is_running & (mad < CLOSING_RATIO * scale_before)))
        damping = np.where(
            take, damping / options.damping_fall, np.where(is_running, _raised(damping, options), damping)
        )
        # exact corners: go on while the cost still falls by half, down to its rounding floor
        is_floor = ~is_exact | ~(trial.cost_px2 < 0.5 * cost)
        # a rejected step that was already too short to matter is convergence too
        done = is_running & is_short & is_floor & (is_settled | ~take)
        is_converged |= done
        is_running &= ~done & (damping < options.max_damping)
        new_scale = np.where(take & ~is_settled, mad, scale)
        changed = new_scale != scale
        if np.any(changed):
            scale = new_scale
            cost = np.where(changed, equations.cost_under(scale, kernel), np.where(take, equations.cost_px2, cost))
        else:
            cost = np.where(take, equations.cost_px2, cost)
    return Minimum(estimate, equations, scale, kernel, n_iterations, is_converged, options)


def _raised(damping: ndarray, options: LoopOptions) -> ndarray:
    return np.maximum(damping * options.damping_rise, options.least_raised_damping)
