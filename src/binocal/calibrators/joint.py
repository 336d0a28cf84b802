"""What every calibrator does that ends in the joint problem.

Closed-form start, view diagnosis, joint robust solve, acceptance. Calibrators differ in the minimiser that they bring.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy import ndarray

from binocal import acceptance
from binocal.calibrators.base import MIN_VIEWS, CalibrationRequest
from binocal.calibrators.board_and_exposures import RealViewsSolve, solve_real_views
from binocal.calibrators.prior_check import check_disagreement, disagreement
from binocal.calibrators.set_checking import checked_as_a_whole, refuse_shifted_lists, without_copies
from binocal.calibrators.summary import joint_problem, plain_lengths2, rig_of, summarize
from binocal.errors import CalibrationError, TooFewViewsError
from binocal.evidence import Detections
from binocal.evidence.pixel_locking import RigLocking
from binocal.evidence.several_boards import boards_from_shot_to_shot
from binocal.findings import Finding, refusal
from binocal.geometry import SE3
from binocal.initialization.diagnosis import Diagnosis, diagnose_views
from binocal.initialization.verified_start import estimate_verified_start
from binocal.result import RejectedView, StereoCalibration
from binocal.shapes import Float
from binocal.solvers import robust
from binocal.solvers.board_views import BundleEstimate, BundleMinimum, BundleProblem
from binocal.solvers.covariance import inliers
from binocal.solvers.image_noise import with_image_noise
from binocal.solvers.minimization import RESUMED_DAMPING, LoopOptions, minimize
from binocal.solvers.pixel_locking import locking_at, locking_findings
from binocal.solvers.polish import polish_exact
from binocal.solvers.poses import estimate_board_poses
from binocal.solvers.principal_points import with_centre_prior
from binocal.solvers.whitening import corner_weights, estimate_misfit_px

CLEAN_OUTLIER_SHARE = 0.01  # Gaussian noise leaves none, a good real set a few in a thousand
PATIENT = LoopOptions(max_iterations=25, tolerance_sigma=0.1, initial_damping=1e-7, is_patient=True)
VALLEY_FALL = (
    30.0  # of the cost in squares of the noise: less, and the ordinary loop, still at it, creeps along a valley
)
FIRST_ITERATIONS = 6  # with all corners alike; enough to tell the noise of images
CLEAN_ITERATIONS = 12  # ordinary sets take 4 to 6
EXACT_SCALES = 1.5  # of the floor of the kernel's scale: corners without noise
POSE_ROUNDS = 3  # the rig that the first leaves shows more of them
OTHER_POSE_SHARE = 0.9  # of a view's cost: the same pose found anew costs the same to a percent
OUTLIER_SCALES = 5.0  # of the median residual: corners beyond do not choose between poses
ALIKE_POSES = np.cos(np.radians(1.0))
MISFIT_ROUNDS = 3  # the second usually finds nothing to change
LOCKING_ROUNDS = 2  # found, and fitted once more to what is left without it
MISFIT_SHARE = 0.1  # of the noise variance; less changes the weights by too little to matter


@runtime_checkable
class Minimizer(Protocol):
    """What finds a robust minimum near a start, as :func:`binocal.solvers.minimization.minimize` does."""

    def __call__(
        self,
        problem: BundleProblem,
        start: BundleEstimate,
        options: LoopOptions | None = None,
        *,
        scale_px: Float[ndarray, "*batch"] | None = None,
    ) -> BundleMinimum:
        """The minimum; ``scale_px`` is a first guess of the kernel's scale."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class NominalSolve:
    """The minimum of the nominal problem (board as drawn, exposures together), its views, and what was found on the way.

    ``views`` have their corner orders repaired; ``notes`` maps a view's name to what was repaired in it.
    """

    views: Detections
    problem: BundleProblem
    minimum: BundleMinimum
    misfit_px: float
    n_iterations: int
    rejected: tuple[RejectedView, ...] = ()
    notes: Mapping[str, str] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    locking: RigLocking = field(default_factory=RigLocking)
    """What was taken from the corners of ``problem``; ``views`` still have it."""


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
    given = detections
    detections, copies, doubts_of_copies = without_copies(given)
    clean = _calibrate_clean(detections, request, minimizer)
    if clean is not None:
        calibration, solve = clean
        return checked_as_a_whole(calibration, solve, given, copies, doubts_of_copies)
    request.check_stop()
    nominal = solve_diagnosed(detections, request, minimizer)
    solve = solve_as_they_were(nominal.problem, nominal.minimum, request, nominal.views)
    calibration = summarize(
        nominal.views,
        solve,
        request,
        rejected=nominal.rejected,
        notes=nominal.notes,
        findings=nominal.findings,
        n_iterations=nominal.n_iterations,
        misfit_px=nominal.misfit_px,
    )
    calibration = _with_locking(calibration, nominal.locking)
    try:
        accepted = acceptance.apply_rules(calibration, is_converged=bool(solve.minimum.is_converged))
    except CalibrationError as error:
        motion = acceptance.gross_motion(calibration.exposure, 0.0, "what is left does not determine the rig")
        if motion is not None:
            refuse_shifted_lists(calibration, solve)
            raise refusal(motion, error.rejected) from error
        raise
    return checked_as_a_whole(accepted, solve, given, copies, doubts_of_copies)


def solve_diagnosed(
    detections: Detections, request: CalibrationRequest, minimizer: Minimizer = minimize
) -> NominalSolve:
    """The nominal problem's minimum over the views that a diagnosis leaves, without those that contradict the others.

    Raises as :func:`binocal.initialization.diagnosis.diagnose_views`.
    """
    diagnosis = diagnose_views(detections, request.model, has_skew=request.skew)
    rejected = diagnosis.rejected
    used = np.nonzero(diagnosis.is_used)[0]
    n_iterations = 0
    start: BundleEstimate | None = None
    rounds = POSE_ROUNDS
    while True:
        if len(used) < MIN_VIEWS:
            raise TooFewViewsError(len(used), MIN_VIEWS, {r.name: r.reason for r in rejected})
        views = diagnosis.detections.select(used)
        start = _start(diagnosis, used) if start is None else start
        problem, minimum, misfit_px, n, locking = solve_unlocked(views, request, start, RobustSolver(minimizer))
        n_iterations += n
        other = _with_other_poses(views, request.model, problem, minimum) if rounds else None
        if other is not None:
            start, rounds = other, rounds - 1
            continue
        doubts = _check_prior(views, request, _start(diagnosis, used), (problem, minimum))
        bad = _contradicting(views, problem, minimum) if minimum.is_converged else {}
        if not bad:
            break
        keep = np.array([i not in bad for i in range(len(used))])
        rejected += tuple(RejectedView(views.names[i], found.text, found.code) for i, found in bad.items())
        start = replace(minimum.estimate, T_left_board=minimum.estimate.T_left_board[keep])
        used = used[keep]
    notes = dict(zip(detections.names, diagnosis.notes, strict=True))
    findings = (*doubts, *diagnosis.findings, *locking_findings(locking))
    return NominalSolve(views, problem, minimum, misfit_px, n_iterations, rejected, notes, findings, locking)


def solve_clean(
    detections: Detections, request: CalibrationRequest, minimizer: Minimizer = minimize
) -> NominalSolve | None:
    """The nominal problem's minimum over views in which nothing looks wrong, or None where that is not so.

    No rule about the rig is asked.
    """
    if detections.n_views < MIN_VIEWS:
        return None
    start = estimate_verified_start(detections, request.model)
    if start is None:
        return None
    estimate = BundleEstimate(
        start.parameters,
        SE3.unchecked(start.R_left_board, start.t_left_board),
        SE3.unchecked(start.R_right_left, start.t_right_left),
    )
    problem, minimum, misfit_px, n_iterations, locking = solve_unlocked(
        detections, request, estimate, RobustSolver(minimizer, is_clean=True)
    )
    if not minimum.is_converged or not _fits_evenly(problem, minimum, start.homography_px):
        return None
    if _check_prior(detections, request, estimate, (problem, minimum)):
        return None
    return NominalSolve(
        detections,
        problem,
        polish_exact(problem, minimum),
        misfit_px,
        n_iterations,
        findings=locking_findings(locking),
        locking=locking,
    )


def solve_as_they_were(
    problem: BundleProblem,
    minimum: BundleMinimum,
    request: CalibrationRequest,
    views: Detections,
) -> RealViewsSolve:
    """The minimum with board and exposures freed as the request and the data say; exact corners are of an exact board.

    Points that are known to a standard deviation only are freed within it. Of several boards each has a shape of its own where it
    is known from pair to pair.
    """
    request.check_stop()
    is_exact = bool(minimum.scale_px <= EXACT_SCALES * robust.SCALE_FLOOR_PX)
    board_shape, exposure = request.board_shape, request.exposure
    if is_exact:
        board_shape = "flat" if board_shape == "auto" else board_shape
        exposure = "together" if exposure == "auto" else exposure
    boards = None if views.shots is None else boards_from_shot_to_shot(views)
    if boards is not None and not (boards >= 0).any():
        boards, board_shape = None, "flat"
    return solve_real_views(
        problem,
        minimum,
        board_shape=board_shape,
        exposure=exposure,
        points_sigma_m=views.object_sigma_m,
        boards=boards,
    )


def _stoppable(minimizer: Minimizer, request: CalibrationRequest) -> Minimizer:
    """The minimiser, which asks whether to go on before each solve."""
    if request.should_stop is None:
        return minimizer

    def minimize_unless_stopped(*args: Any, **kwargs: Any) -> BundleMinimum:
        request.check_stop()
        return minimizer(*args, **kwargs)

    return minimize_unless_stopped


def _calibrate_clean(
    detections: Detections, request: CalibrationRequest, minimizer: Minimizer
) -> tuple[StereoCalibration, RealViewsSolve] | None:
    """The calibration of views in which nothing is wrong, and its solve, or None where that is not proven (:mod:`binocal.acceptance.proof`).

    With any doubt the views are diagnosed, which names the cause.
    """
    nominal = solve_clean(detections, request, minimizer)
    if nominal is None:
        return None
    solve = solve_as_they_were(nominal.problem, nominal.minimum, request, nominal.views)
    try:
        calibration = summarize(
            detections,
            solve,
            request,
            rejected=(),
            notes={},
            findings=nominal.findings,
            n_iterations=nominal.n_iterations,
            misfit_px=nominal.misfit_px,
        )
        calibration = _with_locking(calibration, nominal.locking)
    except CalibrationError:
        return None
    # The rules about the fit ask for less than the proof does.
    doubts = acceptance.findings_of_rules(calibration, (*acceptance.OBSERVABILITY, *acceptance.OUTLIERS))
    is_sound = not doubts and solve.minimum.is_converged and acceptance.is_beyond_doubt(calibration)
    return (calibration, solve) if is_sound else None


def _check_prior(
    views: Detections,
    request: CalibrationRequest,
    start: BundleEstimate,
    known: tuple[BundleProblem, BundleMinimum],
) -> tuple[Finding, ...]:
    """What there is to say of a prior beside these views, which are solved without it for that; ``known`` is the solve with it.

    Raises:
        InconsistentViewsError: The prior is not of this rig.
    """
    if request.prior is None:
        return ()
    request.check_stop()
    problem, minimum, _, _ = solve_with_misfit(views, replace(request, prior=None), start, RobustSolver(minimize))
    return check_disagreement(disagreement(request.prior, known, (problem, minimum)))


def _fits_evenly(problem: BundleProblem, minimum: BundleMinimum, homography_px: float) -> bool:
    n_seen = np.concatenate([camera.is_seen.sum(axis=1) for camera in problem.cameras])
    whitened2 = tuple(e.r2_px2 for e in minimum.equations.cameras)
    plain2 = plain_lengths2(problem, minimum) if problem.is_whitened else whitened2
    return acceptance.fits_evenly(n_seen, inliers(problem, minimum), whitened2, plain2, homography_px)


def _contradicting(views: Detections, problem: BundleProblem, minimum: BundleMinimum) -> dict[int, Finding]:
    left2, right2 = plain_lengths2(problem, minimum)
    left_used, right_used = inliers(problem, minimum)
    return acceptance.contradicting_views(views, (left2, right2), (left_used, right_used))


def _with_other_poses(
    views: Detections, model: str, problem: BundleProblem, minimum: BundleMinimum
) -> BundleEstimate | None:
    """The estimate with the other pose in each view where the rig found fits better by that; None where there is none.

    A board that a long lens sees has two poses that look nearly alike, and the solve may have ended with the wrong one in some
    views. Those bend the rig until they nearly fit: a minimum with small residuals and focal lengths a percent off.
    """
    estimate = minimum.estimate
    R, t = estimate.T_left_board.R.copy(), estimate.T_left_board.t.copy()
    posed = estimate_board_poses(rig_of(estimate, views, model), views)
    before2 = np.concatenate(plain_lengths2(problem, minimum), axis=1)
    after2 = np.concatenate([posed.left_r2_px2, posed.right_r2_px2], axis=1)
    most_px2 = OUTLIER_SCALES**2 * np.nanmedian(before2)
    costs = [np.nansum(np.minimum(r2, most_px2), axis=1) for r2 in (before2, after2)]
    alike = np.sum(R[:, :, 2] * posed.T_left_board.R[:, :, 2], axis=1)  # cosine between the boards' normals
    is_other = posed.is_found & (costs[1] < OTHER_POSE_SHARE * costs[0]) & (alike < ALIKE_POSES)
    if not is_other.any():
        return None
    R[is_other], t[is_other] = posed.T_left_board.R[is_other], posed.T_left_board.t[is_other]
    return replace(estimate, T_left_board=SE3(R, t))


def _start(diagnosis: Diagnosis, used: np.ndarray) -> BundleEstimate:
    return BundleEstimate(
        (diagnosis.left.parameters, diagnosis.right.parameters),
        SE3(diagnosis.R_left_board[used], diagnosis.t_left_board[used]),
        diagnosis.T_right_left,
    )


def _with_locking(calibration: StereoCalibration, locking: RigLocking) -> StereoCalibration:
    """The calibration with the curve that was taken from its corners in the provenance."""
    if not locking.is_found:
        return calibration
    return replace(calibration, provenance={**calibration.provenance, "pixel_locking": locking.document()})


def solve_unlocked(
    views: Detections,
    request: CalibrationRequest,
    start: BundleEstimate,
    solver: RobustSolver,
) -> tuple[BundleProblem, BundleMinimum, float, int, RigLocking]:
    """As :func:`solve_with_misfit`, from corners without their pixel locking, which is returned too.

    It is fitted to the residuals of the first minimum and once more to those of the minimum without it.
    """
    problem, minimum, misfit_px, n_iterations = solve_with_misfit(views, request, start, solver)
    locking = RigLocking()
    for _ in range(LOCKING_ROUNDS):
        found = locking_at(problem, minimum, views) if minimum.is_converged else RigLocking()
        if not found.is_found:
            break
        locking = found
        problem, minimum, misfit_px, n = solve_with_misfit(locking.corrected(views), request, minimum.estimate, solver)
        n_iterations += n
    return problem, minimum, misfit_px, n_iterations, locking


def solve_with_misfit(
    views: Detections, request: CalibrationRequest, start: BundleEstimate, solver: RobustSolver
) -> tuple[BundleProblem, BundleMinimum, float, int]:
    """The joint problem, its minimum, the misfit that its corner weights count, and the iterations it took.

    All corners count alike for the first steps. Then corners count by their covariances, or by the noise of their images where
    images differ (:mod:`binocal.solvers.image_noise`). Where the board or the lens model misfit, covariances alone would take half
    of the corners for outliers: what the residuals exceed them by is the misfit, which is large while the solve is far from its
    end. With it the solve goes on from where it is, until the misfit stands.
    """
    plain = problem = joint_problem(views, request)
    if request.prior is not None:
        start = request.prior.with_held_values(start)
    minimum = solver.first(plain, start)
    if request.prior is None:
        plain, minimum = with_centre_prior(plain, minimum, (views.left_size_wh, views.right_size_wh))
    lengths2, misfit_px, n_iterations = minimum.equations.r2_px2, 0.0, int(minimum.n_iterations)
    for attempt in range(MISFIT_ROUNDS):
        weighed = with_image_noise(views, plain, minimum.estimate, lengths2)
        if not weighed.has_covariances:
            known = None if attempt else minimum
            minimum, n = solver.solve(plain, start if known else minimum.estimate, known)
            return plain, minimum, 0.0, n_iterations + n
        found_px = estimate_misfit_px(weighed, lengths2)
        if attempt and abs(found_px**2 - misfit_px**2) < MISFIT_SHARE * float(minimum.scale_px) ** 2:
            break
        misfit_px = found_px
        problem = replace(joint_problem(views, request, corner_weights(weighed, misfit_px)), terms=plain.terms)
        minimum, n = solver.solve(problem, minimum.estimate)
        n_iterations += n
        if not minimum.is_converged:
            break
        lengths2 = plain.residual_lengths2(minimum.estimate)
    return problem, minimum, misfit_px, n_iterations


@dataclass(frozen=True, slots=True)
class RobustSolver:
    """Minimises the joint problem from a start; of clean views the first minimum is taken for the right one, in few iterations."""

    minimizer: Minimizer
    is_clean: bool = False

    def first(self, problem: BundleProblem, start: BundleEstimate) -> BundleMinimum:
        """Where a few iterations lead; enough of them for ordinary sets."""
        return self.minimizer(problem, start, LoopOptions(max_iterations=FIRST_ITERATIONS))

    def solve(
        self, problem: BundleProblem, start: BundleEstimate, known: BundleMinimum | None = None
    ) -> tuple[BundleMinimum, int]:
        """The robust optimum, and the iterations it took, those that led to the ``known`` minimum not counted.

        The redescending kernel goes straight to the estimate. Where it leaves out more than a few corners, or fails,
        Cauchy's kernel, which never lets go of a corner, starts it a second time, and the lower robust cost wins: falling
        cost alone does not prove the right minimum.
        """
        best, n_iterations = known, 0
        if best is None or not (best.is_converged or is_in_valley(problem, best)):
            allowed = CLEAN_ITERATIONS if self.is_clean else LoopOptions().max_iterations
            near = start if best is None else best.estimate
            best = self.minimizer(problem, near, LoopOptions(max_iterations=allowed, initial_damping=RESUMED_DAMPING))
            n_iterations = int(best.n_iterations)
        if not best.is_converged and is_in_valley(problem, best):
            best = minimize(problem, best.estimate, PATIENT)
            n_iterations += int(best.n_iterations)
        if self.is_clean:
            return best, n_iterations
        n_seen = sum(int(c.is_seen.sum()) for c in problem.cameras)
        n_used = sum(int(used.sum()) for used in inliers(problem, best))
        if not best.is_converged or n_used < (1 - CLEAN_OUTLIER_SHARE) * n_seen:
            loose = minimize(problem, start, LoopOptions(kernel="cauchy", scale_factor=2.0, tolerance_sigma=1.0))
            other = minimize(problem, loose.estimate, LoopOptions(), scale_px=loose.scale_px / 2)
            n_iterations += int(loose.n_iterations + other.n_iterations)
            if _is_better(problem, other, best):
                best = other
        return polish_exact(problem, best), n_iterations


def is_in_valley(problem: BundleProblem, minimum: BundleMinimum) -> bool:
    """Whether the normal equations promise little more."""
    step = problem.solve_step(minimum.estimate, minimum.equations, np.zeros(()))
    return bool(step.predicted_px2 < VALLEY_FALL * minimum.scale_px**2)


def _is_better(problem: BundleProblem, a: BundleMinimum, b: BundleMinimum) -> bool:
    """Converged rather than not, then the lower cost under the smaller scale of the two."""
    if bool(a.is_converged) != bool(b.is_converged):
        return bool(a.is_converged)
    scale = np.minimum(a.scale_px, b.scale_px)
    costs = [sum(float(robust.costs(e.r2_px2, scale, "hampel").sum()) for e in m.equations.cameras) for m in (a, b)]
    return costs[0] < costs[1]
