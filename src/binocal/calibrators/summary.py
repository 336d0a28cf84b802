"""From detections to the joint problem, and from its minimum to the calibration that a user gets.

Shared by every calibrator that ends in the joint problem.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy import ndarray

from binocal.calibrators.base import CalibrationRequest
from binocal.calibrators.board_and_exposures import RealViewsSolve
from binocal.calibrators.given_points import points_as_given
from binocal.cameras import Camera, StereoRig, camera_model
from binocal.evidence import Detections
from binocal.findings import Finding, finding, refusal
from binocal.geometry import SE3
from binocal.initialization.solid_targets import is_solid
from binocal.result import (
    BoardShape,
    Covariance,
    Evidence,
    ExposureFit,
    OutlierCorner,
    RejectedView,
    ResidualSummary,
    StereoCalibration,
    ViewResult,
)
from binocal.shapes import Bool, Float, Int
from binocal.solvers.board_shape import describe_shape
from binocal.solvers.board_views import BundleEstimate, BundleMinimum, BundleProblem, CameraObservations
from binocal.solvers.covariance import inliers, real_covariance, shared_names
from binocal.solvers.joint_system import solve_symmetric
from binocal.solvers.principal_points import PRIOR_SHARE, has_centre_prior
from binocal.solvers.whitening import CornerWeights

SURE_SIGMAS = 3.0  # of a bow or stretch, to be named
NOTICEABLE_SHARE = 0.5  # of the corner noise
FARTHER_THAN_STATED = 1.5  # of the stated standard deviations, RMS over the points: right ones stay below 1
DOUBTFUL_SCALE = 0.0025  # relative standard deviation of the board's scale; good prints stay below 0.002


def joint_problem(
    views: Detections, request: CalibrationRequest, weights: CornerWeights | None = None
) -> BundleProblem:
    """The joint problem of these views, with the request's prior. All corners count alike without ``weights``.

    Raises:
        ValueError: The prior is about other cameras.
    """
    model, weights = camera_model(request.model), weights or CornerWeights()
    problem = BundleProblem(
        np.ascontiguousarray(views.object_points_m.T),
        tuple(
            replace(
                CameraObservations.from_corners(model, px, skew=request.skew, whitening=whitening), lengths2=lengths2
            )
            for px, whitening, lengths2 in (
                (views.left_px, weights.left, weights.left_lengths2),
                (views.right_px, weights.right, weights.right_lengths2),
            )
        ),
    )
    if request.prior is None:
        return problem
    request.prior.check(request.model, (views.left_size_wh, views.right_size_wh), is_metric=views.is_metric)
    return request.prior.applied(problem)


def plain_lengths2(problem: BundleProblem, minimum: BundleMinimum) -> tuple[Float[ndarray, "views n"], ...]:
    """Squared residual lengths of each camera in pixels, whatever the corners weigh."""
    if problem.is_whitened:
        return problem.unwhitened.residual_lengths2(minimum.estimate)
    return minimum.equations.r2_px2


def _plain_lengths2(solve: RealViewsSolve) -> tuple[Float[ndarray, "views n"], ...]:
    """The same of the final solve."""
    if solve.problem.is_whitened:
        return solve.problem.unwhitened.residual_lengths2(solve.minimum.estimate)
    return solve.minimum.equations.r2_px2


def rig_of(estimate: BundleEstimate, detections: Detections, model: str) -> StereoRig:
    """The rig at an estimate."""
    return StereoRig(
        Camera(model, detections.left_size_wh, estimate.parameters[0]),
        Camera(model, detections.right_size_wh, estimate.parameters[1]),
        SE3(estimate.T_right_left.R, estimate.T_right_left.t),
        detections.is_metric,
    )


def summarize(
    detections: Detections,
    solve: RealViewsSolve,
    request: CalibrationRequest,
    *,
    rejected: tuple[RejectedView, ...],
    notes: Mapping[str, str],
    findings: tuple[Finding, ...],
    n_iterations: int,
    misfit_px: float = 0.0,
) -> StereoCalibration:
    """Rig, covariance, residuals per view, and the corners that were given no weight.

    ``detections`` are the views of the problem, in its order; ``notes`` maps a view's name to what was repaired in it.

    Raises:
        DegenerateGeometryError: The information matrix is singular, or there are fewer measurements than unknowns.
    """
    problem, minimum = solve.problem, solve.minimum
    bundle = minimum.estimate.bundle
    if not np.isfinite(solve.noise_px):
        raise refusal(finding("too-few-measurements"))
    used = inliers(problem, minimum)
    covariance, mean_board_pose, agreement = real_covariance(
        problem, minimum.estimate, minimum.equations, solve.reduced, solve.noise_px
    )
    lengths2 = _plain_lengths2(solve)
    sums = np.array([np.where(u, px2, 0.0).sum(axis=1) for u, px2 in zip(used, lengths2, strict=True)])
    counts = np.array([is_used.sum(axis=1) for is_used in used])
    views = _view_results(detections, problem.nominal, lengths2, used, sums, counts, notes)
    left_px, right_px = _rms(sums.sum(axis=1), counts.sum(axis=1))
    all_px = _rms(sums.sum(), counts.sum())
    T_right_board = problem.camera_poses(minimum.estimate)[1] if problem.deviation_sigma is not None else None
    board_shape = _board_shape(solve, agreement.factor)
    return StereoCalibration(
        rig=rig_of(bundle, detections, request.model),
        covariance=Covariance(shared_names(problem.nominal), covariance),
        rms=ResidualSummary(float(left_px), float(right_px), float(all_px)),
        noise_px=solve.noise_px,
        nominal_noise_px=solve.nominal_noise_px,
        views=views,
        rejected=rejected,
        findings=(*findings, *_points_findings(solve, board_shape, detections)),
        n_iterations=n_iterations + solve.n_iterations,
        provenance={
            "corner_weights": {
                "covariances": detections.has_covariances,
                "image_noise": problem.nominal.is_whitened and not detections.has_covariances,
                "misfit_px": misfit_px,
            },
            "views_in_common": {
                "variance_ratio": agreement.excess,
                "variance_ratio_sigma": agreement.excess_sigma,
                "sigma_factor": agreement.factor,
            },
        },
        evidence=Evidence(
            detections,
            SE3(bundle.T_left_board.R, bundle.T_left_board.t),
            misfit_px,
            board_shape,
            None if T_right_board is None else SE3(T_right_board.R, T_right_board.t),
        ),
        exposure=_exposure(solve),
        mean_board_pose=mean_board_pose,
    )


def _board_shape(solve: RealViewsSolve, widening: float) -> BoardShape | None:
    """The board as estimated; its standard deviations are widened as those of the rig are."""
    problem, reduced = solve.problem, solve.reduced
    if problem.shape_information is None:
        return None
    nominal, points = problem.nominal.object_points, solve.minimum.estimate.points
    k = reduced.n_shared
    inverse = solve_symmetric(reduced.information, np.eye(len(reduced.information))[:, k:])[k:]
    covariance = inverse * (solve.noise_px * widening) ** 2
    model = solve.shape_model
    figures = max(
        (describe_shape(nominal[:, board], points[:, board], _of_points(covariance, board)) for board in model.boards),
        key=lambda of_board: of_board.bow,
    )
    scale_variance = 0.0 if solve.shape is None else model.scale_variance(nominal, solve.shape.variances)
    sigma = np.sqrt(np.maximum(np.diagonal(covariance), 0.0)).reshape(3, -1)
    return BoardShape(
        points.T,
        sigma.T,
        figures.bow,
        figures.bow_sigma,
        figures.stretch,
        figures.stretch_sigma,
        figures.in_plane_rms,
        float(np.sqrt(scale_variance)),
    )


def _of_points(covariance: Float[ndarray, "m m"], points: Int[ndarray, "k"]) -> Float[ndarray, "c c"]:
    """Of some points' coordinates, x of all points first."""
    n = len(covariance) // 3
    index = np.concatenate([points, n + points, 2 * n + points])
    return covariance[np.ix_(index, index)]


def _points_findings(solve: RealViewsSolve, shape: BoardShape | None, detections: Detections) -> tuple[Finding, ...]:
    """What there is to say of the points that moved: against what was stated of them, else as those of a flat board."""
    if detections.object_sigma_m is None and shape is None and is_solid(detections.object_points_m):
        return points_as_given(solve, detections)
    if detections.object_sigma_m is None or shape is None:
        return _shape_findings(solve, shape, detections.is_metric)
    moved = np.linalg.norm(shape.points_m - detections.object_points_m, axis=1) / np.sqrt(3)
    ratio = moved / np.where(detections.object_sigma_m > 0, detections.object_sigma_m, np.inf)
    rms = float(np.sqrt(np.mean(np.square(ratio[detections.object_sigma_m > 0])))) if ratio.any() else 0.0
    if rms < FARTHER_THAN_STATED:
        return ()
    worst = int(np.argmax(ratio))
    return (finding("points-beyond-their-sigma", ratio=rms, worst=worst, worst_ratio=float(ratio[worst])),)


def _shape_findings(solve: RealViewsSolve, shape: BoardShape | None, is_metric: bool) -> tuple[Finding, ...]:
    """A sentence where bow or stretch are beyond doubt and move corners noticeably."""
    if shape is None:
        return ()
    nominal = solve.problem.nominal.object_points
    half = 0.5 * max(float(np.ptp(nominal[:, board], axis=1).max()) for board in solve.shape_model.boards)
    is_bent = shape.bow_m > SURE_SIGMAS * shape.bow_sigma_m
    is_stretched = abs(shape.stretch) > SURE_SIGMAS * shape.stretch_sigma
    moved = max(shape.bow_m if is_bent else 0.0, abs(shape.stretch) * half if is_stretched else 0.0)
    bundle = solve.minimum.estimate.bundle
    distance = float(np.median(np.linalg.norm(bundle.T_left_board.t, axis=1)))
    moves_px = moved / distance * float(bundle.parameters[0][0])
    doubts: tuple[Finding, ...] = ()
    if shape.scale_sigma > DOUBTFUL_SCALE:
        stretch_percent, scale_percent = 100 * shape.stretch, 100 * shape.scale_sigma
        doubts = (finding("board-scale-uncertain", stretch_percent=stretch_percent, scale_percent=scale_percent),)
    if moves_px < NOTICEABLE_SHARE * solve.noise_px:
        return doubts
    unit, factor = ("mm", 1e3) if is_metric else ("board pitches", 1.0)
    return (
        *doubts,
        finding(
            "board-not-as-drawn",
            bow=factor * shape.bow_m,
            bow_sigma=factor * shape.bow_sigma_m,
            unit=unit,
            stretch_percent=100 * shape.stretch,
            stretch_sigma_percent=100 * shape.stretch_sigma,
            moves_px=moves_px,
            scale_percent=100 * shape.scale_sigma,
        ),
    )


def assumption_findings(solve: RealViewsSolve) -> tuple[Finding, ...]:
    """That the principal points were taken to lie near the middle."""
    if not has_centre_prior(solve.problem.nominal):
        return ()
    return (finding("principal-points-near-middle", share_percent=100 * PRIOR_SHARE),)


def noise_findings(solve: RealViewsSolve, names: Sequence[str], *, has_covariances: bool) -> tuple[Finding, ...]:
    """That images count by their noise, and from what to what it ranges."""
    if has_covariances or not solve.problem.is_whitened:
        return ()
    noise_px = {}
    for side, camera in zip(("left", "right"), solve.problem.cameras, strict=True):
        assert camera.whitening is not None  # both are, or none
        for view in np.flatnonzero(camera.is_seen.any(axis=1)).tolist():
            corner = int(np.argmax(camera.is_seen[view]))
            noise_px[side, names[view]] = solve.noise_px / float(camera.whitening[view, 0, corner])
    least, most = min(noise_px, key=noise_px.__getitem__), max(noise_px, key=noise_px.__getitem__)
    return (
        finding(
            "images-differ-in-noise",
            least_px=noise_px[least],
            least_camera=least[0],
            least_view=least[1],
            most_px=noise_px[most],
            most_camera=most[0],
            most_view=most[1],
        ),
    )


def _exposure(solve: RealViewsSolve) -> ExposureFit:
    sigma = solve.problem.deviation_sigma
    turn, shift = sigma or (0.0, 0.0)
    return ExposureFit(solve.pair.alone_px, solve.pair.pair_px, sigma is not None, turn, shift)


def _rms(total_px2: Float[ndarray, "*n"], count: Int[ndarray, "*n"]) -> Float[ndarray, "*n"]:
    return np.sqrt(np.where(count > 0, total_px2 / np.maximum(count, 1), np.nan))


def _view_results(
    detections: Detections,
    problem: BundleProblem,
    lengths2: tuple[Float[ndarray, "views n"], ...],
    used: tuple[Bool[ndarray, "views n"], ...],
    sums_px2: Float[ndarray, "2 views"],
    counts: Int[ndarray, "2 views"],
    notes: Mapping[str, str],
) -> tuple[ViewResult, ...]:
    outliers: dict[int, list[OutlierCorner]] = {}
    for side, camera, px2, is_used in zip(("left", "right"), problem.cameras, lengths2, used, strict=True):
        for view, corner in np.argwhere(camera.is_seen != is_used).tolist():
            distance_px = float(np.sqrt(px2[view, corner]))
            outliers.setdefault(view, []).append(OutlierCorner(side, corner, distance_px))
    rows = zip(
        detections.names,
        _rms(sums_px2.sum(axis=0), counts.sum(axis=0)).tolist(),
        *_rms(sums_px2, counts).tolist(),
        np.sum([c.is_seen.sum(axis=1) for c in problem.cameras], axis=0).tolist(),
        strict=True,
    )
    return tuple(
        ViewResult(name, all_px, left_px, right_px, n, tuple(outliers.get(i, ())), notes.get(name, ""))
        for i, (name, all_px, left_px, right_px, n) in enumerate(rows)
    )
