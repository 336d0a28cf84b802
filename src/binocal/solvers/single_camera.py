"""One camera refined on its own, so that views can be judged and the joint solve starts close."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray

from binocal.cameras import CameraModel
from binocal.solvers.bundle import BundleEstimate, BundleProblem, CameraObservations
from binocal.solvers.least_squares import LoopOptions, minimize

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

ENOUGH_VIEWS = 24  # more views do not bring the start of the joint solve closer, they only cost time


@dataclass(frozen=True, slots=True, eq=False)
class RefinedCamera:
    """Intrinsics at the robust optimum of one camera's own views, and the noise seen there."""

    parameters: Float[ndarray, "p"]
    noise_px: float
    is_converged: bool


def refine_camera(
    model: CameraModel,
    parameters: Float[ndarray, "p"],
    R_camera_board: Float[ndarray, "views 3 3"],
    t_camera_board: Float[ndarray, "views 3"],
    object_points: Float[ndarray, "n 3"],
    corners_px: Float[ndarray, "views n 2"],
    is_usable: Bool[ndarray, "views"],
    *,
    skew: bool = False,
) -> RefinedCamera:
    """Robust optimum over at most 24 of the usable views, evenly spread, from a start in its basin."""
    views = np.nonzero(is_usable)[0]
    if len(views) > ENOUGH_VIEWS:
        views = views[np.linspace(0, len(views) - 1, ENOUGH_VIEWS).round().astype(int)]
    problem = BundleProblem(
        np.ascontiguousarray(np.asarray(object_points, dtype=float).T),
        (CameraObservations.from_corners(model, corners_px[views], skew=skew),),
    )
    start = BundleEstimate((np.asarray(parameters, dtype=float),), R_camera_board[views], t_camera_board[views])
    result = minimize(
        problem, start, LoopOptions(kernel="cauchy", scale_factor=2.0, tolerance_sigma=0.3, initial_damping=1e-3)
    )
    return RefinedCamera(
        result.estimate.parameters[0], float(result.scale_px) / 2.0, bool(result.is_converged)
    )
