"""Board poses seen by a rig that is already known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray

from binocal.cameras import StereoRig, camera_model
from binocal.detections import Detections
from binocal.geometry import SE3
from binocal.initialization.poses import estimate_poses
from binocal.solvers.bundle import BundleEstimate, BundleProblem, CameraObservations
from binocal.solvers.least_squares import LoopOptions, minimize

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

MIN_CORNERS = 4  # a planar pose has six unknowns; three corners leave several solutions


@dataclass(frozen=True, slots=True, eq=False)
class BoardPoses:
    """One pose per view. Where ``is_found`` is False (too few corners) the pose is the identity and means nothing.

    ``left_r2_px2`` and ``right_r2_px2`` are squared residual lengths, NaN where a corner was not seen or the pose was not found.
    """

    T_left_board: SE3
    is_found: Bool[ndarray, "views"]
    left_r2_px2: Float[ndarray, "views n"]
    right_r2_px2: Float[ndarray, "views n"]


def estimate_board_poses(rig: StereoRig, detections: Detections) -> BoardPoses:
    """Robust maximum-likelihood pose of the board in every view, intrinsics and rig held.

    The start is the closed-form pose of whichever camera fits both pictures better.
    """
    object_points = np.ascontiguousarray(detections.object_points_m.T)
    T = rig.T_right_left
    models = [camera_model(c.model) for c in (rig.left, rig.right)]
    corners = (detections.left_px, detections.right_px)
    starts = []
    for index, camera in enumerate((rig.left, rig.right)):
        found = estimate_poses(camera.model, camera.parameters, detections.object_points_m, corners[index])
        R, t = found.R, found.t
        if index == 1:
            R, t = T.R.T @ R, (t - T.t) @ T.R
        starts.append((R, t, found.is_usable))
    cameras = tuple(
        CameraObservations.from_corners(model, px, intrinsics=False) for model, px in zip(models, corners, strict=True)
    )
    n_views = detections.n_views
    # every view is a rig of its own in a batch, so that each has its own robust scale and damping
    batch = tuple(
        CameraObservations(c.model, c.pixels[:, None], c.is_seen[:, None], c.is_free) for c in cameras
    )
    problem = BundleProblem(object_points, batch, is_rig_free=False)

    def solve(R: ndarray, t: ndarray) -> tuple[BundleEstimate, ndarray, list[ndarray]]:
        start = BundleEstimate(
            tuple(np.broadcast_to(c.parameters, (n_views, len(c.parameters))) for c in (rig.left, rig.right)),
            R[:, None],
            t[:, None],
            np.broadcast_to(T.R, (n_views, 3, 3)),
            np.broadcast_to(T.t, (n_views, 3)),
        )
        loose = minimize(problem, start, LoopOptions(kernel="cauchy", scale_factor=2.0, tolerance_sigma=0.1))
        final = minimize(problem, loose.estimate, LoopOptions(), scale_px=loose.scale_px / 2)
        r2 = [e.r2_px2[:, 0] for e in final.equations.cameras]
        return final.estimate, final.scale_px, r2

    is_found = starts[0][2] | starts[1][2]
    R0 = np.where(starts[0][2][:, None, None], starts[0][0], starts[1][0])
    t0 = np.where(starts[0][2][:, None], starts[0][1], starts[1][1])
    R1 = np.where(starts[1][2][:, None, None], starts[1][0], starts[0][0])
    t1 = np.where(starts[1][2][:, None], starts[1][1], starts[0][1])
    for R, t in ((R0, t0), (R1, t1)):
        R[~is_found], t[~is_found] = np.eye(3), [0.0, 0.0, 1.0]
    first, scale_first, r2_first = solve(R0, t0)
    second, scale_second, r2_second = solve(R1, t1)
    use_second = scale_second < scale_first
    R = np.where(use_second[:, None, None], second.R_left_board[:, 0], first.R_left_board[:, 0])
    t = np.where(use_second[:, None], second.t_left_board[:, 0], first.t_left_board[:, 0])
    r2 = []
    for camera, a, b in zip(cameras, r2_first, r2_second, strict=True):
        chosen = np.where(use_second[:, None], b, a)
        r2.append(np.where(camera.is_seen & is_found[:, None], chosen, np.nan))
    R[~is_found], t[~is_found] = np.eye(3), 0.0
    return BoardPoses(SE3(R, t), is_found, r2[0], r2[1])
