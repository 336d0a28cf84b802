"""Board poses seen by a rig that is already known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
from numpy import ndarray

from binocal.cameras import StereoRig, camera_model
from binocal.evidence import Detections
from binocal.geometry import SE3, so3
from binocal.initialization.poses import estimate_poses
from binocal.initialization.solid_targets import is_solid, solid_poses
from binocal.shapes import Bool, Float
from binocal.solvers.arrays import choose_rigs
from binocal.solvers.board_views import (
    BundleEstimate,
    BundleMinimum,
    BundleProblem,
    CameraObservations,
)
from binocal.solvers.minimization import LoopOptions, minimize
from binocal.solvers.whitening import CornerWeights

MIN_CORNERS = 4  # a planar pose has six unknowns; three corners leave several solutions


@dataclass(frozen=True, slots=True, eq=False)
class PosedViews:
    """One pose per view. Where ``is_found`` is False (too few corners) the pose is the identity and means nothing.

    ``left_r2_px2`` and ``right_r2_px2`` are squared residual lengths, whitened where the corners have weights, NaN where
    a corner was not seen or the pose was not found.
    """

    T_left_board: SE3
    is_found: Bool[ndarray, "views"]
    left_r2_px2: Float[ndarray, "views n"]
    right_r2_px2: Float[ndarray, "views n"]


def estimate_board_poses(
    rig: StereoRig, detections: Detections, start: SE3 | None = None, weights: CornerWeights | None = None
) -> PosedViews:
    """Robust maximum-likelihood pose of the board in every view, intrinsics and rig held.

    ``start`` holds one ``T_left_board`` per view that is known to be close. Without it the closed-form poses of both
    cameras are tried, and the one that fits both images better is kept. All corners count alike without ``weights``.
    """
    if start is not None:
        is_found = detections.left_is_seen.sum(axis=1) + detections.right_is_seen.sum(axis=1) >= MIN_CORNERS
        candidates = [start]
    else:
        candidates, is_found = _closed_form_starts(rig, detections)
    problem = _one_view_problems(rig, detections, weights or CornerWeights())
    found = (_solve(problem, rig, T_left_board, is_close=start is not None) for T_left_board in candidates)
    best = reduce(lambda best, other: _better(other, best), found)
    r2 = [
        np.where(camera.is_seen[:, 0] & is_found[:, None], e.r2_px2[:, 0], np.nan)
        for camera, e in zip(problem.cameras, best.equations.cameras, strict=True)
    ]
    R = np.where(is_found[:, None, None], so3.project_to_rotation(best.estimate.T_left_board.R[:, 0]), np.eye(3))
    t = np.where(is_found[:, None], best.estimate.T_left_board.t[:, 0], 0.0)
    return PosedViews(SE3(R, t), is_found, r2[0], r2[1])


def _closed_form_starts(rig: StereoRig, detections: Detections) -> tuple[list[SE3], ndarray]:
    """``T_left_board`` from the left and from the right images, each filled with the other's where it has none."""
    starts = []
    T = rig.T_right_left
    for camera, px in ((rig.left, detections.left_px), (rig.right, detections.right_px)):
        found = (solid_poses if is_solid(detections.object_points_m) else estimate_poses)(
            camera.model, camera.parameters, detections.object_points_m, px
        )
        R, t = found.R, found.t
        if camera is rig.right:
            R, t = T.R.T @ R, (t - T.t) @ T.R
        starts.append((R, t, found.is_usable))
    (R_l, t_l, ok_l), (R_r, t_r, ok_r) = starts
    neither = ~(ok_l | ok_r)
    candidates = []
    for R, t, ok, R_other, t_other in ((R_l, t_l, ok_l, R_r, t_r), (R_r, t_r, ok_r, R_l, t_l)):
        R, t = np.where(ok[:, None, None], R, R_other), np.where(ok[:, None], t, t_other)
        R[neither], t[neither] = np.eye(3), [0.0, 0.0, 1.0]
        candidates.append(SE3.unchecked(R, t))
    return candidates, ~neither


def _one_view_problems(rig: StereoRig, detections: Detections, weights: CornerWeights) -> BundleProblem:
    """Every view as a rig of its own in a batch, so that each has its own robust scale and damping."""
    cameras = tuple(
        CameraObservations.from_corners(
            camera_model(camera.model), px, intrinsics=False, whitening=whitening
        ).each_view_alone()
        for camera, px, whitening in (
            (rig.left, detections.left_px, weights.left),
            (rig.right, detections.right_px, weights.right),
        )
    )
    return BundleProblem(np.ascontiguousarray(detections.object_points_m.T), cameras, is_rig_free=False)


def _solve(problem: BundleProblem, rig: StereoRig, T_left_board: SE3, *, is_close: bool) -> BundleMinimum:
    start = BundleEstimate.of_rig(rig, T_left_board[:, None])
    if is_close:
        return minimize(problem, start, LoopOptions(tolerance_sigma=0.1))
    loose = minimize(problem, start, LoopOptions(kernel="cauchy", scale_factor=2.0, tolerance_sigma=0.1))
    return minimize(problem, loose.estimate, scale_px=loose.scale_px / 2)


def _better(a: BundleMinimum, b: BundleMinimum) -> BundleMinimum:
    """View by view, the minimum with the smaller scale."""
    take = a.scale_px < b.scale_px
    return replace(
        a,
        estimate=choose_rigs(take, a.estimate, b.estimate),
        equations=choose_rigs(take, a.equations, b.equations),
        scale_px=np.where(take, a.scale_px, b.scale_px),
    )
