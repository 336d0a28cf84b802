"""From the nominal minimum to the board and the exposures as they were: which of them are freed, and the minimum then.

The nominal problem is solved first, so that corner orders, bad views and outliers are dealt with as ever. Then two questions are
put to its equations: does the board differ from its drawing (:mod:`binocal.solvers.board_shape`), and do the cameras alone fit
better than the pair (:mod:`binocal.solvers.exposures`)? What the data deny stays as it was drawn.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.calibrators.base import BoardShapeChoice, ExposureChoice
from binocal.set_checks.pair_motion import LEAST_T, PairMotion, measure_freed_motion, measure_pair_motion
from binocal.shapes import Float, Int
from binocal.solvers import robust
from binocal.solvers.board_shape import ShapeEvidence, doubt_flatness, estimate_variances
from binocal.solvers.board_views import BundleEstimate, BundleMinimum, BundleProblem
from binocal.solvers.covariance import inliers
from binocal.solvers.exposures import (
    APART_RATIO,
    APART_T,
    LESS_APART_T,
    PairFit,
    compare_with_cameras_alone,
    count_coordinates,
    determined_deviations,
    effective_points,
    estimate_deviation_sigma,
    with_deviations,
)
from binocal.solvers.jackknife import excess_of_scores
from binocal.solvers.joint_system import ReducedSystem, solve_symmetric
from binocal.solvers.minimization import RESUMED_DAMPING, LoopOptions, Minimum, minimize
from binocal.solvers.real_views import (
    RealViewsEquations,
    RealViewsMinimum,
    RealViewsProblem,
    cameras_information,
)
from binocal.solvers.shape_model import ShapeModel, stated_information

MAX_ROUNDS = 4  # of variances and minimum; the second usually finds nothing to change
SETTLED_SHARE = 0.1  # of a standard deviation of the offsets, the largest
SETTLED_LOG = 0.1  # of a standard deviation of the deviations
MAX_STRETCHES = 8
RIG_TOLERANCE_SIGMA = 0.3  # over all parameters of the rig: a twentieth of a standard deviation for one
COARSE = LoopOptions(tolerance_sigma=0.5, max_iterations=4)
FINE = LoopOptions(tolerance_sigma=0.3, max_iterations=3, initial_damping=RESUMED_DAMPING)
SCREENED_VIEWS = 16  # for a first look
LINEAR_SHARE = 0.1  # of the pair's noise that the cameras leave alone: below, the linear look is not to be believed
LESSENED_SHARE = 0.005  # of the corners, of Gaussian noise it is 0.002
OPENED = 3.0  # times the kernel's scale, for the comparison of the cameras
MIN_POINTS = 9  # fewer are determined by their poses and the lens
MIN_VIEWS_TO_FREE = 4
MIN_FREEDOM_SHARE = 0.25  # of the measurements: what must be left once every point is free


@dataclass(frozen=True, slots=True, eq=False)
class RealViewsSolve:
    """The minimum with what was freed and why, its shared equations, and the noise of a corner coordinate."""

    problem: RealViewsProblem
    minimum: RealViewsMinimum
    reduced: ReducedSystem
    """At the minimum, priors weighed against ``noise_px``."""
    noise_px: float
    """NaN where more was freed than the corners tell."""
    nominal_noise_px: float
    """With the board as drawn and the exposures together."""
    nominal_bundle: BundleEstimate
    """Where the nominal solve ended."""
    pair: PairFit
    motion: PairMotion | None = None
    shape: ShapeEvidence | None = None
    n_iterations: int = 0
    boards: Int[ndarray, "n"] | None = None
    """Which board each point is of, -1 for those that are as drawn; None where all are of one."""

    @property
    def shape_model(self) -> ShapeModel:
        """How the boards may differ from their drawings."""
        return ShapeModel.of_points(self.problem.nominal.object_points, self.boards)


def solve_real_views(
    nominal: BundleProblem,
    known: BundleMinimum,
    *,
    board_shape: BoardShapeChoice = "auto",
    exposure: ExposureChoice = "auto",
    points_sigma_m: Float[ndarray, "n"] | None = None,
    boards: Int[ndarray, "n"] | None = None,
) -> RealViewsSolve:
    """Free what the data say is not as drawn, from the nominal minimum; and points that are known to a standard deviation only.

    ``boards`` says of which board each point is, -1 for those that stay as drawn; None where all are of one.
    """
    problem = RealViewsProblem(nominal)
    estimate = problem.start(known.estimate)
    at_end = known.equations
    equations = RealViewsEquations(at_end.cameras, (), at_end.cost_px2, at_end.prior_energy, at_end.scale_px)
    minimum: RealViewsMinimum = Minimum(
        estimate, equations, known.scale_px, known.kernel, known.n_iterations, known.is_converged, known.options
    )
    solve = replace(_measured(problem, minimum), boards=boards)
    if points_sigma_m is not None:
        solve = with_points_freed(solve, points_sigma_m)
    elif board_shape != "flat" and _can_free(problem, solve, board_shape):
        solve = _settled_or(solve, _with_board_freed(solve, board_shape))
    solve = _with_pair_compared(solve)
    if exposure == "apart" or (exposure == "auto" and _are_apart(solve)):
        freed = _settled_or(solve, _with_exposures_freed(solve, board_shape))
        solve = solve if freed is solve else _compared_after(freed)
    return solve


def with_points_freed(solve: RealViewsSolve, sigma_m: Float[ndarray, "n"]) -> RealViewsSolve:
    """The solve with its points free within standard deviations of their coordinates, or as it was where that has no minimum."""
    information = stated_information(solve.problem.nominal.object_points, sigma_m)
    return _settled_or(solve, _minimized(replace(solve.problem, shape_information=information), solve, FINE, None))


def _settled_or(before: RealViewsSolve, freed: RealViewsSolve) -> RealViewsSolve:
    """What was freed, where that reached a minimum, or where there was none before either."""
    has_arrived = bool(freed.minimum.is_converged) and np.isfinite(freed.noise_px)
    return freed if has_arrived or not before.minimum.is_converged else before


def _with_pair_compared(solve: RealViewsSolve) -> RealViewsSolve:
    """Each camera alone against the pair, and what moved where the pair leaves more than chance; the board within its prior.

    The kernel is opened for it: at its own scale it lets go of the corners of displaced views, and hides them. Where it holds
    almost all corners with full weight, nothing is hidden.
    """
    problem, estimate, minimum = solve.problem, solve.minimum.estimate, solve.minimum
    if _holds_nearly_all(problem, minimum):
        equations, together = minimum.equations, solve.reduced
    else:
        equations, together = problem.linearize(estimate, OPENED * minimum.scale_px, "hampel"), None
    pair = compare_with_cameras_alone(problem, estimate, equations, solve.noise_px, together)
    motion = None
    if pair.excess > LEAST_T:  # T is never larger
        motion = measure_pair_motion(problem, estimate, equations, pair)
    return replace(solve, pair=pair, motion=motion)


def _holds_nearly_all(problem: RealViewsProblem, minimum: RealViewsMinimum) -> bool:
    """Whether the kernel lessens no more corners than it does of pure noise."""
    limit2 = (robust.HAMPEL_FLAT * float(minimum.scale_px)) ** 2
    n_lessened = sum(int(np.count_nonzero(r2 > limit2)) for r2 in minimum.equations.r2_px2)
    n_seen = sum(int(np.count_nonzero(c.is_seen)) for c in problem.cameras)
    return minimum.kernel == "hampel" and n_lessened < LESSENED_SHARE * n_seen


def _compared_after(solve: RealViewsSolve) -> RealViewsSolve:
    """The comparison anew where the exposures are free: far motion is not linear."""
    minimum, pair = solve.minimum, solve.pair
    motion = measure_freed_motion(solve.problem, minimum.estimate, minimum.equations, solve.noise_px) or solve.motion
    excess = pair.excess if motion is None else motion.excess
    freedom = count_coordinates(solve.problem, minimum.equations) * pair.excess_sigma**2 / 2  # for each relative pose
    pair_px = solve.noise_px * float(np.sqrt(1 + max(excess - 1, 0.0) / freedom))
    return replace(solve, pair=replace(pair, alone_px=solve.noise_px, pair_px=pair_px, excess=excess), motion=motion)


def _are_apart(solve: RealViewsSolve) -> bool:
    """Whether the relative poses scatter by clearly more than images leave on their own, or by too much for a linear look."""
    if not solve.pair.alone_px > LINEAR_SHARE * solve.pair.pair_px:
        return True
    if solve.motion is None:
        return False
    limit = LESS_APART_T if solve.pair.ratio > APART_RATIO else APART_T
    return limit < solve.motion.T


def _can_free(problem: RealViewsProblem, solve: RealViewsSolve, board_shape: BoardShapeChoice) -> bool:
    """Whether views and corners suffice to tell the board's shape from all else."""
    sizes = [problem.nominal.object_points.shape[1]]
    if solve.boards is not None:
        sizes = np.bincount(solve.boards[solve.boards >= 0]).tolist()
    n_views = int(solve.reduced.is_determined.sum())
    counts = _n_coordinates(problem, solve.minimum)
    left = counts - 6 * n_views - solve.reduced.n_shared - sum(3 * n - 7 for n in sizes)
    is_enough = (
        min(sizes, default=0) >= MIN_POINTS and n_views >= MIN_VIEWS_TO_FREE and left > MIN_FREEDOM_SHARE * counts
    )
    return is_enough or board_shape == "warp"


def _n_coordinates(problem: RealViewsProblem, minimum: RealViewsMinimum) -> float:
    used = inliers(problem, minimum)
    return sum(c.n_coordinates(of_camera) for c, of_camera in zip(problem.cameras, used, strict=True))


def _with_board_freed(solve: RealViewsSolve, board_shape: BoardShapeChoice) -> RealViewsSolve:
    problem = solve.problem
    points, model = problem.nominal.object_points, solve.shape_model
    if board_shape in ("warp", "free"):
        information = model.warp_information(points) if board_shape == "warp" else model.weak_information()
        solve = _minimized(replace(problem, shape_information=information), solve, FINE, solve.shape)
        if not np.isfinite(solve.noise_px):
            return solve
        return replace(solve, shape=_evidence(solve, model, None))  # for what it says of the print's scale
    if not _looks_bent(solve, model):
        return solve
    shape = _first_evidence(solve, model)
    if shape.is_flat:
        return replace(solve, shape=shape)
    for attempt in range(MAX_ROUNDS):
        problem = replace(solve.problem, shape_information=model.information(shape.variances))
        solve = _minimized(problem, solve, FINE if attempt else COARSE, shape)
        if not np.isfinite(solve.noise_px):
            break
        before, shape = shape.variances, _evidence(solve, model, shape)
        if _is_settled(before, shape.variances, model):
            break
    return replace(solve, shape=shape)


def _looks_bent(solve: RealViewsSolve, model: ShapeModel) -> bool:
    """Whether the board's shape is worth a closer look; information from some of the views, scores from all."""
    minimum, problem = solve.minimum, solve.problem
    some = _some_views(len(minimum.estimate.deviations))
    part, estimate = problem.of_views(minimum.estimate, some)
    equations = part.linearize(estimate, minimum.scale_px, minimum.kernel, with_points=True)
    own = sum((e.information.sum(axis=0) for e in equations.points), np.zeros((6, 1)))
    equations = replace(equations, points=tuple(e.in_modes(model.modes) for e in equations.points))
    reduced = part.reduced(estimate, equations, of_views=False)
    score = problem.points_gradient(minimum.estimate, minimum.scale_px, minimum.kernel)
    n_seen = [sum(int(c.is_seen.sum()) for c in p.cameras) for p in (part, problem)]
    taken = 3 * len(some) / n_seen[0]  # six of two coordinates a corner
    share = n_seen[0] / n_seen[1]
    return doubt_flatness(model, reduced, own, score, solve.noise_px, share=share, taken=taken).is_any


def _some_views(n_views: int) -> Int[ndarray, "k"]:
    """All views, or so many evenly spread ones that they decide whether a closer look is due."""
    return np.unique(np.linspace(0, n_views - 1, min(n_views, SCREENED_VIEWS)).round().astype(int))


def _first_evidence(solve: RealViewsSolve, model: ShapeModel) -> ShapeEvidence:
    """From the equations at the nominal board, every point all but free."""
    minimum = solve.minimum
    weak = replace(solve.problem, shape_information=model.weak_information())
    equations = weak.linearize(minimum.estimate, minimum.scale_px, minimum.kernel)
    reduced = weak.reduced(minimum.estimate, equations)
    x = solve_symmetric(reduced.information, reduced.gradient)
    rss = equations.rss_px2 - float(x @ reduced.gradient) - float(np.sum(reduced.y**2))
    fitted = 6 * reduced.is_determined.sum() + reduced.n_shared + model.basis.shape[1]
    noise_px = float(np.sqrt(max(rss, 0.0) / max(_n_coordinates(weak, minimum) - fitted, 1)))
    return estimate_variances(model, reduced, np.zeros(len(model.basis)), max(noise_px, robust.SCALE_FLOOR_PX))


def _evidence(solve: RealViewsSolve, model: ShapeModel, before: ShapeEvidence | None) -> ShapeEvidence:
    """The variances anew. What views have in common counts as noise: it bends the board too, but not the next set's."""
    offset = (solve.minimum.estimate.points - solve.problem.nominal.object_points).reshape(-1)
    excess, _ = excess_of_scores(solve.reduced, solve.noise_px)
    noise_px = solve.noise_px * float(np.sqrt(max(excess, 1.0)))
    start = None if before is None else before.variances
    return estimate_variances(model, solve.reduced, offset, noise_px, start)


def _is_settled(before: Float[ndarray, "5"], after: Float[ndarray, "5"], model: ShapeModel) -> bool:
    old, new = (np.sqrt(variances / model.scales) for variances in (before, after))
    return bool(np.abs(old - new).max() < SETTLED_SHARE * max(old.max(), new.max()))


def _with_exposures_freed(solve: RealViewsSolve, board_shape: BoardShapeChoice) -> RealViewsSolve:
    """The solve with deviations of the right poses; a board that only they had bent is as drawn again."""
    model = solve.shape_model
    sigma: tuple[float, float] | None = None
    for attempt in range(MAX_ROUNDS):
        before = sigma
        sigma = estimate_deviation_sigma(solve.problem, solve.minimum.estimate, solve.minimum.equations, solve.noise_px)
        problem = replace(with_deviations(solve.problem, solve.minimum.estimate, sigma), deviation_sigma=sigma)
        if attempt and solve.shape is not None and board_shape == "auto" and problem.shape_information is not None:
            shape = _evidence(solve, model, solve.shape)
            information = None if shape.is_flat else model.information(shape.variances)
            problem = replace(problem, shape_information=information)
            solve = replace(solve, shape=shape, minimum=solve.minimum if information is not None else _as_drawn(solve))
        solve = _minimized(problem, solve, FINE if attempt else COARSE, solve.shape)
        if not np.isfinite(solve.noise_px):
            break
        if before and max(abs(np.log(a / b)) for a, b in zip(before, sigma, strict=True)) < SETTLED_LOG:
            break
    return solve


def _as_drawn(solve: RealViewsSolve) -> RealViewsMinimum:
    """The minimum with the board's points back where they are drawn, for a solve that holds them where they are."""
    estimate = replace(solve.minimum.estimate, points=solve.problem.nominal.object_points)
    return replace(solve.minimum, estimate=estimate)


def _minimized(
    problem: RealViewsProblem, solve: RealViewsSolve, options: LoopOptions, shape: ShapeEvidence | None
) -> RealViewsSolve:
    """The minimum as far as the rig is concerned.

    A redescending kernel that closes on hundreds of points gives up one corner after the other for dozens of iterations, which move
    points and poses and leave the rig where it is. So the loop runs in short stretches and ends with the rig's own step.
    """
    for _ in range(MAX_STRETCHES):
        minimum = minimize(problem, solve.minimum.estimate, options)
        n_iterations = solve.n_iterations + int(minimum.n_iterations)
        measured = _measured(problem, minimum)
        solve = replace(
            solve,
            problem=problem,
            minimum=minimum,
            reduced=measured.reduced,
            noise_px=measured.noise_px,
            shape=shape,
            n_iterations=n_iterations,
        )
        if bool(minimum.is_converged) or not np.isfinite(solve.noise_px):
            break
        if rig_step_sigma(solve) < RIG_TOLERANCE_SIGMA:
            return replace(solve, minimum=replace(minimum, is_converged=np.asarray(True)))
    return solve


def rig_step_sigma(solve: RealViewsSolve) -> float:
    """Length of the next step over the cameras' and the rig's parameters, in standard deviations."""
    reduced = solve.reduced
    x = solve_symmetric(reduced.information, reduced.gradient)[: reduced.n_shared]
    return float(np.sqrt(max(x @ cameras_information(reduced) @ x, 0.0)) / solve.noise_px)


def _measured(problem: RealViewsProblem, minimum: RealViewsMinimum) -> RealViewsSolve:
    """The solve with its noise: weighted residuals, corrected for all that was fitted, priors counted."""
    reduced = problem.reduced(minimum.estimate, minimum.equations)
    scale = float(minimum.equations.scale_px)
    fitted = 6 * reduced.is_determined.sum() + problem.n_free + effective_points(problem, reduced)
    fitted += determined_deviations(problem, reduced, scale)
    freedom = _n_coordinates(problem, minimum) - fitted
    noise_px = float(np.sqrt(minimum.equations.rss_px2 / freedom)) if freedom > 0 else np.nan
    if problem.has_priors and np.isfinite(noise_px):
        weighed = replace(minimum.equations, scale_px=np.asarray(max(noise_px, robust.SCALE_FLOOR_PX)))
        reduced = problem.reduced(minimum.estimate, weighed)
    return RealViewsSolve(problem, minimum, reduced, noise_px, noise_px, minimum.estimate.bundle, PairFit(1.0, 1.0))
