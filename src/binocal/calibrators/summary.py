"""From detections to the joint problem, and from its minimum to the calibration that a user gets.

Shared by every calibrator that ends in the joint problem.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy import ndarray

from binocal.calibrators.base import CalibrationRequest
from binocal.cameras import Camera, StereoRig, camera_model
from binocal.evidence import Detections
from binocal.findings import Finding
from binocal.geometry import SE3
from binocal.result import (
    Covariance,
    Evidence,
    OutlierCorner,
    RejectedView,
    ResidualSummary,
    StereoCalibration,
    ViewResult,
)
from binocal.shapes import Bool, Float, Int
from binocal.solvers.board_views import BundleEstimate, BundleMinimum, BundleProblem, CameraObservations
from binocal.solvers.covariance import inliers, residual_noise_px, shared_covariance, shared_names
from binocal.solvers.whitening import CornerWeights


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
            CameraObservations.from_corners(model, px, skew=request.skew, whitening=whitening)
            for px, whitening in ((views.left_px, weights.left), (views.right_px, weights.right))
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
    return tuple(e.r2_px2 for e in minimum.equations.cameras)


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
    problem: BundleProblem,
    minimum: BundleMinimum,
    request: CalibrationRequest,
    *,
    rejected: tuple[RejectedView, ...],
    notes: Mapping[str, str],
    findings: tuple[Finding, ...],
    n_iterations: int,
    misfit_px: float = 0.0,
) -> StereoCalibration:
    """Rig, covariance, residuals per view, and the corners that were given no weight.

    ``detections`` are the views of ``problem``, in its order; ``notes`` maps a view's name to what was repaired in it.

    Raises:
        DegenerateGeometryError: The information matrix is singular, or there are fewer measurements than unknowns.
    """
    used = inliers(problem, minimum)
    noise_px = residual_noise_px(problem, minimum, used)
    covariance = shared_covariance(problem, minimum.estimate, minimum.equations, noise_px)
    lengths2 = plain_lengths2(problem, minimum)
    sums = np.array([np.where(u, px2, 0.0).sum(axis=1) for u, px2 in zip(used, lengths2, strict=True)])
    counts = np.array([is_used.sum(axis=1) for is_used in used])
    views = _view_results(detections, problem, lengths2, used, sums, counts, notes)
    left_px, right_px = _rms(sums.sum(axis=1), counts.sum(axis=1))
    all_px = _rms(sums.sum(), counts.sum())
    return StereoCalibration(
        rig=rig_of(minimum.estimate, detections, request.model),
        covariance=Covariance(shared_names(problem), covariance),
        rms=ResidualSummary(float(left_px), float(right_px), float(all_px)),
        noise_px=noise_px,
        views=views,
        rejected=rejected,
        findings=findings,
        n_iterations=n_iterations,
        provenance={"corner_weights": {"covariances": problem.is_whitened, "misfit_px": misfit_px}},
        evidence=Evidence(detections, SE3(minimum.estimate.T_left_board.R, minimum.estimate.T_left_board.t), misfit_px),
    )


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
