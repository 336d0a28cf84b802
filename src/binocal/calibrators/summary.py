"""From a solver's minimum to the calibration that a user gets. Shared by every calibrator that ends in the joint problem."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray

from binocal import __version__
from binocal.calibrators.base import CalibrationOptions
from binocal.cameras import Camera, StereoRig
from binocal.detections import Detections
from binocal.geometry import SE3, so3
from binocal.result import (
    Covariance,
    OutlierCorner,
    RejectedView,
    ResidualSummary,
    StereoCalibration,
    ViewResult,
)
from binocal.solvers.bundle import BundleEstimate, BundleProblem
from binocal.solvers.covariance import inliers, residual_noise_px, shared_covariance, shared_names
from binocal.solvers.least_squares import Minimum

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


def rig_of(estimate: BundleEstimate, detections: Detections, model: str) -> StereoRig:
    """The rig at an estimate."""
    R = so3.project_to_rotation(estimate.R_right_left)
    return StereoRig(
        Camera(model, detections.left_size_wh, estimate.parameters[0]),
        Camera(model, detections.right_size_wh, estimate.parameters[1]),
        SE3(R, estimate.t_right_left),
        detections.is_metric,
    )


def summarize(
    detections: Detections,
    problem: BundleProblem,
    minimum: Minimum,
    options: CalibrationOptions,
    *,
    calibrator: str,
    rejected: tuple[RejectedView, ...],
    notes: Mapping[str, str],
    warnings: tuple[str, ...],
    n_iterations: int,
) -> StereoCalibration:
    """Rig, covariance, residuals per view, and the corners that were given no weight.

    ``detections`` are the views of ``problem``, in its order; ``notes`` maps a view's name to what was repaired in it.

    Raises:
        DegenerateGeometryError: The information matrix is singular, or there are fewer measurements than unknowns.
    """
    noise_px = residual_noise_px(problem, minimum)
    covariance = shared_covariance(problem, minimum.estimate, minimum.equations, noise_px)
    used = inliers(problem, minimum)
    r2 = [e.r2_px2 for e in minimum.equations.cameras]
    views = tuple(
        _view_result(detections, problem, used, r2, index, notes.get(name, ""))
        for index, name in enumerate(detections.names)
    )
    return StereoCalibration(
        rig=rig_of(minimum.estimate, detections, options.model),
        covariance=Covariance(shared_names(problem), covariance),
        rms=ResidualSummary(
            _rms(r2[0][used[0]]), _rms(r2[1][used[1]]), _rms(np.concatenate([r2[0][used[0]], r2[1][used[1]]]))
        ),
        noise_px=noise_px,
        views=views,
        rejected=rejected,
        warnings=(*warnings, *_outlier_warning(views)),
        n_iterations=n_iterations,
        provenance={
            "binocal": __version__,
            "python": platform.python_version(),
            "numpy": np.__version__,
            "calibrator": calibrator,
            "model": options.model,
            "skew": options.skew,
            "seed": options.seed,
        },
    )


def _rms(r2: Float[ndarray, "n"]) -> float:
    return float(np.sqrt(r2.mean())) if r2.size else float("nan")


def _view_result(
    detections: Detections,
    problem: BundleProblem,
    used: tuple[Bool[ndarray, "views n"], ...],
    r2: list[Float[ndarray, "views n"]],
    index: int,
    note: str,
) -> ViewResult:
    outliers = []
    for side, camera, is_used, lengths2 in zip(("left", "right"), problem.cameras, used, r2, strict=True):
        for corner in np.nonzero(camera.is_seen[index] & ~is_used[index])[0]:
            outliers.append(OutlierCorner(side, int(corner), float(np.sqrt(lengths2[index, corner]))))
    inlier_r2 = [lengths2[index][is_used[index]] for is_used, lengths2 in zip(used, r2, strict=True)]
    return ViewResult(
        name=detections.names[index],
        rms_px=_rms(np.concatenate(inlier_r2)),
        left_rms_px=_rms(inlier_r2[0]),
        right_rms_px=_rms(inlier_r2[1]),
        n_corners=int(sum(c.is_seen[index].sum() for c in problem.cameras)),
        outliers=tuple(outliers),
        note=note,
    )


def _outlier_warning(views: tuple[ViewResult, ...]) -> tuple[str, ...]:
    n_outliers = sum(v.n_outliers for v in views)
    n_corners = sum(v.n_corners for v in views)
    if n_outliers <= 0.01 * n_corners:  # a few wild corners are every real set's share
        return ()
    view, worst = max(((v, o) for v in views for o in v.outliers), key=lambda pair: pair[1].distance_px)
    return (
        f"{n_outliers} of {n_corners} corners ({100 * n_outliers / n_corners:.1f} %) do not fit and were given no weight; "
        f"the worst is {worst.camera} corner {worst.corner} of view {view.name}, {worst.distance_px:.1f} px off.",
    )
