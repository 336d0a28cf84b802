"""The last judge: is a solved rig a result, or only a number?

Each check either raises with the culprit's name or adds a sentence to the warnings. None of them changes the rig.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray

from binocal.detections import Detections
from binocal.errors import DegenerateGeometryError, InconsistentViewsError, NotConvergedError
from binocal.result import StereoCalibration

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_NOISE_SHARE = 0.08
"""Corner noise over corner spacing.

Real pictures reach 0.02 (270x180); a wrong corner order or board leaves 0.3 and more.
"""
MAX_FOCAL_SIGMA_SHARE = 0.05
"""Relative standard deviation of a focal length.

Fronto-parallel views leave 0.07-0.6 at 0.1-0.5 px, three good views 0.001-0.004.
"""
WARN_FOCAL_SIGMA_SHARE = 0.01
MAX_BASELINE_SIGMA_SHARE = 0.2
"""Standard deviation of the translation over the baseline. One pose repeated leaves 0.4-3, six weak views 0.01-0.05."""
MIN_NORMAL_SPREAD_DEG = 2.0
"""Spread of the board's directions below which views count as parallel.

Unless the focal lengths are known in spite of it.
"""
PARALLEL_FOCAL_SIGMA_SHARE = 0.002
MAX_OUTLIER_SHARE = 0.3  # a robust fit that drops more than this has chosen one story among several

_ADD_TILTS = "add views with the board tilted 20-45 deg about both axes, at different distances"


def check_convergence(is_converged: bool, n_iterations: int) -> None:
    """Raises NotConvergedError unless the solver reached a minimum."""
    if not is_converged:
        raise NotConvergedError(
            f"the joint solve did not reach a minimum in {n_iterations} iterations; "
            f"the views may leave parameters undetermined: {_ADD_TILTS}."
        )


def check_fit(detections: Detections, noise_px: float, n_outliers: int, n_corners: int) -> None:
    """Raises InconsistentViewsError where the corners cannot be a picture of this board."""
    spacing_px = corner_spacing_px(detections)
    if noise_px > MAX_NOISE_SHARE * spacing_px:
        raise InconsistentViewsError(
            f"the corners do not fit the board: residuals of {noise_px:.2f} px where corners are {spacing_px:.1f} px apart; "
            "check the board's columns, rows and corner order, and that left and right pictures were taken together."
        )
    if n_outliers > MAX_OUTLIER_SHARE * n_corners:
        raise InconsistentViewsError(
            f"{n_outliers} of {n_corners} corners contradict the rest; "
            "check the corner order, the pairing of left and right, and the camera model."
        )


def check_observability(calibration: StereoCalibration, normals: Float[ndarray, "views 3"]) -> tuple[str, ...]:
    """Warnings about weak geometry. ``normals`` are the board's directions in the left frame, one per view.

    Raises:
        DegenerateGeometryError: The views do not determine the rig.
    """
    sigma = calibration.covariance.sigma
    warnings = []
    spread_deg = normal_spread_deg(normals)
    for side, camera in (("left", calibration.rig.left), ("right", calibration.rig.right)):
        share = max(sigma[f"{side}.fx"] / camera.parameters[0], sigma[f"{side}.fy"] / camera.parameters[1])
        if share > MAX_FOCAL_SIGMA_SHARE or (spread_deg < MIN_NORMAL_SPREAD_DEG and share > PARALLEL_FOCAL_SIGMA_SHARE):
            raise DegenerateGeometryError(
                f"the views do not determine the {side} focal length (standard deviation {100 * share:.1f} %): "
                f"the board's directions differ by only {spread_deg:.1f} deg (fronto-parallel or repeated views); {_ADD_TILTS}."
            )
        if share > WARN_FOCAL_SIGMA_SHARE:
            warnings.append(
                f"the {side} focal length is known only to {100 * share:.1f} % (one standard deviation); {_ADD_TILTS}."
            )
    sigma_t = float(np.sqrt(sum(sigma[f"translation.{axis}"] ** 2 for axis in "xyz")))
    baseline = calibration.rig.baseline_m
    if sigma_t > MAX_BASELINE_SIGMA_SHARE * baseline:
        raise DegenerateGeometryError(
            f"the views do not determine the translation between the cameras (standard deviation {100 * sigma_t / baseline:.0f} % "
            f"of the baseline); {_ADD_TILTS}."
        )
    return tuple(warnings)


def normal_spread_deg(normals: Float[ndarray, "views 3"]) -> float:
    """RMS angle between the directions and their mean."""
    unit = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    mean = unit.sum(axis=0)
    mean /= np.linalg.norm(mean)
    angles = np.arctan2(np.linalg.norm(np.cross(unit, mean), axis=1), unit @ mean)
    return float(np.degrees(np.sqrt(np.mean(angles**2))))


def corner_spacing_px(detections: Detections) -> float:
    """Median distance in the pictures of corners that are neighbours on the board."""
    points = detections.object_points_m
    index = np.arange(len(points))
    distance = np.linalg.norm(points[:, None] - points[None], axis=-1)
    distance[index, index] = np.inf
    nearest = np.argmin(distance, axis=1)
    gaps = [np.linalg.norm(px[:, nearest] - px, axis=-1) for px in (detections.left_px, detections.right_px)]
    return float(np.nanmedian(np.concatenate(gaps, axis=None)))


def with_warnings(calibration: StereoCalibration, normals: Float[ndarray, "views 3"]) -> StereoCalibration:
    """The calibration with every warning of this room put first; raises as the checks do."""
    return replace(calibration, warnings=(*check_observability(calibration, normals), *calibration.warnings))
