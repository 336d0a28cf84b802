"""``absolute-orientation``: the pose between the cameras by the singular value decomposition of points that each reconstructs alone.

Each camera is calibrated alone and reconstructs the board's points of every view; the rotation and translation that bring all left
points onto the right ones follow in closed form, and one pose per pair, not two, is then optimised over both images with the rig held.
The points count by how well both cameras place them: a board's depth is known worse the farther it is.

Source: the paper's related work [8] as its text describes it; Arun, Huang & Blostein 1987, "Least-squares fitting of two 3-D point
sets", with the weights of Horn 1987, section 5. Deviations: cameras by robust least squares; the paper's text leaves the weights
open. With the option ``refine`` the pose between the cameras is optimised along with the pairs' poses.
"""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.calibrators.base import CalibrationRequest
from binocal.calibrators.registry import refuse_unsuited
from binocal.calibrators.staged import (
    DiagnosedViews,
    StagedSolve,
    check_detections,
    diagnosed_views,
    poses_by_both,
    solve_camera,
    summarize_stages,
)
from binocal.errors import TooFewViewsError
from binocal.evidence import Detections
from binocal.geometry import SE3, so3
from binocal.result import StereoCalibration
from binocal.shapes import Float
from binocal.solvers.board_views import BundleEstimate, BundleProblem, CameraObservations
from binocal.solvers.minimization import minimize
from binocal.solvers.staged_covariance import (
    CameraStage,
    influence_of_corners,
    pose_stage_of_pixels,
    pose_stage_of_points,
)

NAME = "absolute-orientation"


def calibrate_absolute_orientation(evidence: Detections, request: CalibrationRequest) -> StereoCalibration:
    """The rig from the points that each camera reconstructs (see :class:`binocal.calibrators.base.Calibrator`).

    Covariance: through all stages, to first order, with each camera's own noise.
    """
    detections = check_detections(NAME, evidence)
    request.check_options("refine")
    refuse_unsuited(NAME, request)
    diagnosed = diagnosed_views(detections, request)
    request.check_stop()
    left, n_left, left_arrived = solve_camera(diagnosed, 0, request)
    request.check_stop()
    right, n_right, right_arrived = solve_camera(diagnosed, 1, request)
    request.check_stop()
    cameras, points = (left, right), diagnosed.views.object_points_m
    weights = _weights(cameras, points)
    n_pairs = int((weights > 0).any(axis=1).sum())
    if n_pairs < 1:
        raise TooFewViewsError(n_pairs, 1, remedy="add views in which both cameras see the board")
    T_right_left = fit_motion(left.T_camera_board.apply(points), right.T_camera_board.apply(points), weights)
    second = pose_stage_of_points(cameras, points, T_right_left, weights)
    T_left_board, n_iterations = poses_by_both(diagnosed, cameras, T_right_left), n_left + n_right
    fitted, n, has_arrived = _refined(diagnosed, cameras, T_left_board, T_right_left)
    n_iterations += n  # whether its pose is taken or only compared with
    if request.options.get("refine", False):
        T_right_left = fitted
        T_left_board = poses_by_both(diagnosed, cameras, T_right_left)
        px = (diagnosed.views.left_px, diagnosed.views.right_px)
        second = pose_stage_of_pixels(cameras, points, T_left_board, T_right_left, px, left.is_used & right.is_used)
    is_converged = left_arrived and right_arrived and has_arrived
    provenance = {"absolute_orientation": {"pairs": n_pairs, "refined": bool(request.options.get("refine", False))}}
    return summarize_stages(
        diagnosed,
        StagedSolve(cameras, T_right_left, second, T_left_board, n_iterations, is_converged, provenance, fitted),
    )


def fit_motion(
    points_a: Float[ndarray, "*views n 3"], points_b: Float[ndarray, "*views n 3"], weights: Float[ndarray, "*views n"]
) -> SE3:
    """``T_b_a`` that brings points a onto points b with the least weighted squared distance, in closed form.

    Source: Arun, Huang & Blostein 1987; the sign of the determinant after Umeyama 1991, eq. 43.
    """
    w = weights[..., None] / weights.sum()
    axes = tuple(range(w.ndim - 1))
    mean_a, mean_b = np.sum(w * points_a, axis=axes), np.sum(w * points_b, axis=axes)
    a, b = (points_a - mean_a).reshape(-1, 3), (points_b - mean_b).reshape(-1, 3)
    U, _, Vt = np.linalg.svd((b * w.reshape(-1, 1)).T @ a)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return SE3(R, mean_b - R @ mean_a)


def _weights(cameras: tuple[CameraStage, CameraStage], points: Float[ndarray, "n 3"]) -> Float[ndarray, "views n"]:
    """1 over the mean variance of a point's difference between the cameras, cameras' parameters held; 0 where either has no corner."""
    variance = np.zeros(cameras[0].is_used.shape)
    for camera in cameras:
        _, _, to_pose = influence_of_corners(camera, points)
        of_pose = camera.noise_px**2 * (to_pose @ to_pose.swapaxes(-1, -2))
        seen = camera.T_camera_board.apply(points)
        by_step = np.concatenate([-so3.hat(seen), np.broadcast_to(np.eye(3), (*seen.shape, 3))], axis=-1)
        variance += np.einsum("vnci,vij,vncj->vn", by_step, of_pose, by_step) / 3
    both = cameras[0].is_used & cameras[1].is_used
    return np.where(both, 1 / np.where(both, variance, 1.0), 0.0)


def _refined(
    diagnosed: DiagnosedViews, cameras: tuple[CameraStage, CameraStage], T_left_board: SE3, T_right_left: SE3
) -> tuple[SE3, int, bool]:
    """The pose between the cameras and one pose per pair of least squares in pixels, cameras held."""
    views = diagnosed.views
    observed = tuple(
        CameraObservations.from_corners(camera.model, np.where(camera.is_used[..., None], px, np.nan), intrinsics=False)
        for camera, px in zip(cameras, (views.left_px, views.right_px), strict=True)
    )
    problem = BundleProblem(np.ascontiguousarray(views.object_points_m.T), observed)
    start = BundleEstimate((cameras[0].parameters, cameras[1].parameters), T_left_board, T_right_left)
    minimum = minimize(problem, start)
    T = minimum.estimate.T_right_left
    return SE3.unchecked(T.R, T.t), int(minimum.n_iterations), bool(minimum.is_converged)
