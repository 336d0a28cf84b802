"""What every calibrator does that ends in the joint problem.

Closed-form start, view diagnosis, joint robust solve, judgement. Calibrators differ in the minimiser that they bring.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy import ndarray

from binocal.calibrators import trust
from binocal.calibrators.base import MIN_VIEWS, CalibrationRequest
from binocal.calibrators.summary import joint_problem, plain_lengths2, summarize
from binocal.errors import CalibrationError, TooFewViewsError
from binocal.evidence import Detections
from binocal.initialization.diagnosis import Diagnosis, diagnose_views
from binocal.initialization.verified_start import estimate_verified_start
from binocal.result import RejectedView, StereoCalibration
from binocal.shapes import Float
from binocal.solvers import robust
from binocal.solvers.bundle import BundleEstimate, BundleProblem, residual_lengths2
from binocal.solvers.covariance import inliers
from binocal.solvers.least_squares import RESUMED_DAMPING, START_DAMPING, LoopOptions, Minimum, minimize
from binocal.solvers.polish import polish_exact
from binocal.solvers.whitening import corner_weights, estimate_misfit_px

CLEAN_OUTLIER_SHARE = 0.01  # Gaussian noise leaves none, a good real set a few in a thousand
CLEAN_ITERATIONS = 12  # ordinary sets take 4 to 6
CLEAN_IMAGE_OUTLIER_SHARE = 0.05  # of one image: four corners of 88
CLEAN_RATIO = 2.0  # RMS of the worst image over the median one's; noise alone reaches 1.3 at 88 corners, 1.7 at 12
CLEAN_HOMOGRAPHY_RATIO = 1.2  # over what free homographies leave, lens and all
CLEAN_NOISE_SHARE = 0.01  # corner noise over corner spacing: half of what small real images reach
CLEAN_SPACING_VIEWS = 4  # tell the spacing to a tenth, which is all that this doubt needs
CLEAN_CENTRE_SHARE = 0.08  # of the image's size; lenses sit within 0.1
CLEAN_FOCAL_SIGMA_SHARE = 0.005  # the scene's geometry is then beyond question: weak sets start at 0.01
CLEAN_BASELINE_SIGMA_SHARE = 0.02
MISFIT_ROUNDS = 3  # the second usually finds nothing to change
MISFIT_SHARE = 0.1  # of the noise variance; less changes the weights by too little to matter
MIN_VIEW_INLIER_SHARE = (
    0.5  # a view most of whose corners in one camera contradict the rest is not an observation of this board
)


class Minimizer(Protocol):
    """What finds a robust minimum near a start, as :func:`binocal.solvers.least_squares.minimize` does."""

    def __call__(
        self,
        problem: BundleProblem,
        start: BundleEstimate,
        options: LoopOptions | None = None,
        *,
        scale_px: Float[ndarray, "*batch"] | None = None,
    ) -> Minimum:
        """The minimum; ``scale_px`` is a first guess of the kernel's scale."""
        ...


def calibrate_jointly(
    detections: Detections, request: CalibrationRequest, *, minimizer: Minimizer = minimize
) -> StereoCalibration:
    """Joint maximum-likelihood calibration from a closed-form start (see :class:`binocal.calibrators.base.Calibrator`).

    Deterministic: ``request.seed`` is not used.
    """
    if not isinstance(detections, Detections):
        raise TypeError(f"the joint solve works from Detections of a board; got {type(detections).__name__}")
    request.check_options()
    minimizer = _stoppable(minimizer, request)
    clean = _calibrate_clean(detections, request, minimizer)
    if clean is not None:
        return clean
    request.check_stop()
    diagnosis = diagnose_views(detections, request.model, has_skew=request.skew)
    rejected = diagnosis.rejected
    used = np.nonzero(diagnosis.is_used)[0]
    n_iterations = 0
    start: BundleEstimate | None = None
    while True:
        if len(used) < MIN_VIEWS:
            raise TooFewViewsError(len(used), MIN_VIEWS, {r.name: r.reason for r in rejected})
        views = diagnosis.detections.select(used)
        start = _start(diagnosis, used) if start is None else start
        problem, minimum, misfit_px, n = solve_with_misfit(views, request, start, partial(_solve, minimizer))
        n_iterations += n
        bad = _misfits(views, problem, minimum) if minimum.is_converged else {}
        if not bad:
            break
        keep = np.array([i not in bad for i in range(len(used))])
        rejected += tuple(RejectedView(views.names[i], reason) for i, reason in bad.items())
        start = _take_views(minimum.estimate, keep)
        used = used[keep]

    calibration = summarize(
        views,
        problem,
        minimum,
        request,
        rejected=rejected,
        notes=dict(zip(detections.names, diagnosis.notes, strict=True)),
        warnings=diagnosis.warnings,
        n_iterations=n_iterations,
        misfit_px=misfit_px,
    )
    return trust.judged(calibration, is_converged=bool(minimum.is_converged))


def _stoppable(minimizer: Minimizer, request: CalibrationRequest) -> Minimizer:
    """The minimiser, which asks whether to go on before each solve."""
    if request.should_stop is None:
        return minimizer

    def minimize_unless_stopped(*args: Any, **kwargs: Any) -> Minimum:
        request.check_stop()
        return minimizer(*args, **kwargs)

    return minimize_unless_stopped


def _calibrate_clean(
    detections: Detections, request: CalibrationRequest, minimizer: Minimizer
) -> StereoCalibration | None:
    """The calibration of views in which nothing is wrong, or None where that is not proven.

    Verification is cheaper than diagnosis: a rig that fits every image as well as a homography of the image's own,
    gives every corner weight, and is well determined leaves nothing to repair, to reject or to warn of. Any doubt, and
    the long way decides and names the culprit.
    """
    if detections.n_views < MIN_VIEWS:
        return None
    start = estimate_verified_start(detections, request.model)
    if start is None:
        return None
    estimate = BundleEstimate(
        start.parameters, start.R_left_board, start.t_left_board, start.R_right_left, start.t_right_left
    )
    problem, minimum, misfit_px, n_iterations = solve_with_misfit(
        detections, request, estimate, partial(_solve_clean, minimizer)
    )
    if not minimum.is_converged or not _fits_evenly(problem, minimum, start.homography_px):
        return None
    try:
        calibration = summarize(
            detections,
            problem,
            polish_exact(problem, minimum),
            request,
            rejected=(),
            notes={},
            warnings=(),
            n_iterations=n_iterations,
            misfit_px=misfit_px,
        )
        warnings = trust.check_observability(calibration)
    except CalibrationError:
        return None
    # check_fit asks for less than what is asked for here
    return calibration if not warnings and _is_beyond_doubt(calibration) else None


def _fits_evenly(problem: BundleProblem, minimum: Minimum, homography_px: float) -> bool:
    """Whether every image fits alike, and all of them as well as homographies of their own."""
    used = inliers(problem, minimum)
    n_seen = np.concatenate([camera.is_seen.sum(axis=1) for camera in problem.cameras])
    n_used = np.concatenate([is_used.sum(axis=1) for is_used in used])
    if (n_used < (1 - CLEAN_IMAGE_OUTLIER_SHARE) * n_seen).any():
        return False
    whitened2 = _sums(tuple(e.r2_px2 for e in minimum.equations.cameras), used)
    plain2 = _sums(plain_lengths2(problem, minimum), used) if problem.is_whitened else whitened2
    mean2 = np.sort(whitened2 / n_seen)
    even = mean2[-1] < CLEAN_RATIO**2 * max(mean2[len(mean2) // 2], robust.SCALE_FLOOR_PX**2)
    rms_px = np.sqrt(plain2.sum() / (2 * n_seen.sum()))
    return bool(even and rms_px < CLEAN_HOMOGRAPHY_RATIO * homography_px + robust.SCALE_FLOOR_PX)


def _sums(lengths2: tuple[ndarray, ...], used: tuple[ndarray, ...]) -> Float[ndarray, "images"]:
    """Sum over the used corners of every image."""
    return np.concatenate([np.where(u, px2, 0.0).sum(axis=1) for px2, u in zip(lengths2, used, strict=True)])


def _is_beyond_doubt(calibration: StereoCalibration) -> bool:
    """Whether the rig is so well determined and so ordinary that no check of the long way could object."""
    rig, sigma = calibration.rig, calibration.covariance.sigma
    if calibration.warnings or rig.is_swapped:
        return False
    spacing_px = trust.corner_spacing_px(calibration.evidence.detections, CLEAN_SPACING_VIEWS)
    if not calibration.noise_px < CLEAN_NOISE_SHARE * spacing_px:
        return False
    for side, camera in (("left", rig.left), ("right", rig.right)):
        size = np.array(camera.size_wh)
        offset = np.abs(camera.parameters[2:4] - (size - 1) / 2)
        focal = [sigma[f"{side}.{name}"] / value for name, value in zip(("fx", "fy"), camera.parameters, strict=False)]
        if np.any(offset > CLEAN_CENTRE_SHARE * size) or max(focal) > CLEAN_FOCAL_SIGMA_SHARE:
            return False
    sigma_t = np.sqrt(sum(sigma[f"translation.{axis}"] ** 2 for axis in "xyz"))
    return bool(sigma_t < CLEAN_BASELINE_SIGMA_SHARE * rig.baseline_m)


def _start(diagnosis: Diagnosis, used: np.ndarray) -> BundleEstimate:
    return BundleEstimate(
        (diagnosis.left.parameters, diagnosis.right.parameters),
        diagnosis.R_left_board[used],
        diagnosis.t_left_board[used],
        diagnosis.T_right_left.R,
        diagnosis.T_right_left.t,
    )


def solve_with_misfit(
    views: Detections,
    request: CalibrationRequest,
    start: BundleEstimate,
    solve: Callable[..., tuple[Minimum, int]],
) -> tuple[BundleProblem, Minimum, float, int]:
    """The joint problem, its minimum, the misfit that its corner weights count, and the iterations it took.

    All corners count alike at first: where the board or the lens model misfit, covariances alone would take half of the
    corners for outliers. What the residuals exceed the covariances by is the misfit; with it the solve goes on from its
    own end, until the misfit stands. ``solve`` takes problem, start, and the damping to begin with.
    """
    plain = problem = joint_problem(views, request)
    minimum, n_iterations = solve(problem, start)
    misfit_px = 0.0
    for attempt in range(MISFIT_ROUNDS if views.has_covariances else 0):
        if not minimum.is_converged:
            break
        found_px = estimate_misfit_px(views, residual_lengths2(plain, minimum.estimate))
        if attempt and abs(found_px**2 - misfit_px**2) < MISFIT_SHARE * float(minimum.scale_px) ** 2:
            break
        misfit_px = found_px
        problem = joint_problem(views, request, corner_weights(views, misfit_px))
        minimum, n = solve(problem, minimum.estimate, damping=RESUMED_DAMPING)
        n_iterations += n
    return problem, minimum, misfit_px, n_iterations


def _solve_clean(
    minimizer: Minimizer, problem: BundleProblem, start: BundleEstimate, *, damping: float = START_DAMPING
) -> tuple[Minimum, int]:
    minimum = minimizer(problem, start, LoopOptions(max_iterations=CLEAN_ITERATIONS, initial_damping=damping))
    return minimum, int(minimum.n_iterations)


def _solve(
    minimizer: Minimizer, problem: BundleProblem, start: BundleEstimate, *, damping: float = START_DAMPING
) -> tuple[Minimum, int]:
    """The robust optimum, and the iterations it took.

    The redescending kernel goes straight to the estimate. Where it leaves out more than a few corners, or fails,
    Cauchy's kernel, which never lets go of a corner, starts it a second time, and the lower robust cost wins: falling
    cost alone does not prove the right minimum.
    """
    best = minimizer(problem, start, LoopOptions(initial_damping=damping))
    n_iterations = int(best.n_iterations)
    n_seen = sum(int(c.is_seen.sum()) for c in problem.cameras)
    n_used = sum(int(used.sum()) for used in inliers(problem, best))
    if not best.is_converged or n_used < (1 - CLEAN_OUTLIER_SHARE) * n_seen:
        loose = minimize(problem, start, LoopOptions(kernel="cauchy", scale_factor=2.0, tolerance_sigma=1.0))
        other = minimize(problem, loose.estimate, LoopOptions(), scale_px=loose.scale_px / 2)
        n_iterations += int(loose.n_iterations + other.n_iterations)
        if _is_better(problem, other, best):
            best = other
    return polish_exact(problem, best), n_iterations


def _is_better(problem: BundleProblem, a: Minimum, b: Minimum) -> bool:
    """Converged rather than not, then the lower cost under the smaller scale of the two."""
    if bool(a.is_converged) != bool(b.is_converged):
        return bool(a.is_converged)
    scale = np.minimum(a.scale_px, b.scale_px)
    costs = [sum(float(robust.costs(e.r2_px2, scale, "hampel").sum()) for e in m.equations.cameras) for m in (a, b)]
    return costs[0] < costs[1]


def _misfits(views: Detections, problem: BundleProblem, minimum: Minimum) -> dict[int, str]:
    """Views most of whose corners in a camera got no weight, and why."""
    bad: dict[int, str] = {}
    lengths2 = plain_lengths2(problem, minimum)
    for side, camera, px2, used in zip(
        ("left", "right"), problem.cameras, lengths2, inliers(problem, minimum), strict=True
    ):
        n_seen, n_used = camera.is_seen.sum(axis=1), used.sum(axis=1)
        for i in np.nonzero((n_seen > 0) & (n_used < MIN_VIEW_INLIER_SHARE * n_seen))[0]:
            typical_px = float(np.sqrt(np.median(px2[i][camera.is_seen[i]])))
            bad[int(i)] = (
                f"{n_seen[i] - n_used[i]} of {n_seen[i]} {side} corners contradict the other views "
                f"(typically {typical_px:.1f} px off); check the corner order and that both images were taken together"
            )
    return bad


def _take_views(estimate: BundleEstimate, keep: np.ndarray) -> BundleEstimate:
    return BundleEstimate(
        estimate.parameters,
        estimate.R_left_board[keep],
        estimate.t_left_board[keep],
        estimate.R_right_left,
        estimate.t_right_left,
    )
