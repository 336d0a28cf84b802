"""``opencv``: cv2's own calibration as its users call it, with a covariance that cv2 does not give.

Each camera by ``calibrateCamera``, then ``stereoCalibrate`` with ``CALIB_FIX_INTRINSIC``, which its documentation recommends
wherever each camera can be calibrated alone; ``cv2.fisheye`` for fisheye4. The option ``intrinsics="free"`` has the cameras refined
along (``CALIB_USE_INTRINSIC_GUESS``). Every corner counts alike, none is left out; the board is as drawn.
Source: OpenCV documentation, "Camera Calibration and 3D Reconstruction"; Zhang 2000.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy import ndarray

from binocal import acceptance
from binocal.calibrators.base import MIN_VIEWS, CalibrationRequest
from binocal.calibrators.board_and_exposures import solve_real_views
from binocal.calibrators.registry import refuse_unsuited
from binocal.calibrators.staged import (
    DiagnosedViews,
    StagedSolve,
    camera_as_given,
    check_detections,
    diagnosed_views,
    summarize_stages,
)
from binocal.calibrators.summary import summarize
from binocal.cameras import camera_model
from binocal.errors import NotConvergedError, TooFewViewsError
from binocal.evidence import Detections
from binocal.geometry import SE3
from binocal.images.opencv_settings import single_threaded_opencv
from binocal.result import StereoCalibration
from binocal.shapes import Bool, Float
from binocal.solvers.board_views import BundleEstimate, BundleProblem, CameraObservations
from binocal.solvers.minimization import LoopOptions, minimize
from binocal.solvers.staged_covariance import pose_stage_of_pixels

NAME = "opencv"
KINDS = {"brown4": cv2.CALIB_FIX_K3, "brown5": 0, "brown8": cv2.CALIB_RATIONAL_MODEL}
ALL_ALIKE = LoopOptions(kernel="squared")
ARRIVED = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-9)
"""Of ``stereoCalibrate``: its default (30, 1e-6) stops before the minimum of its own cost on some sets of few views."""
LONGEST_STEP_SIGMA = 0.5  # from where cv2 ended to the minimum of its own cost: more, and it had not arrived
NOT_THERE = {
    "solver": "cv2.stereoCalibrate",
    "else_use": "cv2 stops after a fixed number of steps; --calibrator lm goes on to the minimum",
}


def calibrate_opencv(evidence: Detections, request: CalibrationRequest) -> StereoCalibration:
    """cv2's rig from the views that the diagnosis leaves (see :class:`binocal.calibrators.base.Calibrator`).

    Covariance: through both stages, to first order, with each camera's own noise; that of the joint normal equations with
    ``intrinsics="free"``.
    """
    detections = check_detections(NAME, evidence)
    request.check_options("intrinsics")
    choice = request.options.get("intrinsics", "held")
    if choice not in ("held", "free"):
        raise ValueError(f"intrinsics is {choice!r}; it can be held, free")
    refuse_unsuited(NAME, request)
    with single_threaded_opencv():  # sums in another order would make another result each time
        return _calibrate(detections, request, is_free=choice == "free")


def _calibrate(detections: Detections, request: CalibrationRequest, *, is_free: bool) -> StereoCalibration:
    diagnosed = diagnosed_views(detections, request)
    request.check_stop()
    parameters = [_one_camera(diagnosed, side, request.model) for side in range(2)]
    request.check_stop()
    parameters, T_right_left = _both_cameras(diagnosed, parameters, request.model, is_free=is_free)
    request.check_stop()
    provenance = {"opencv": {"version": cv2.__version__, "intrinsics": "free" if is_free else "held"}}
    if is_free:
        joint = _of_joint_minimum(diagnosed, request, parameters, T_right_left)
        return replace(joint, provenance={**joint.provenance, **provenance})
    cameras = tuple(camera_as_given(diagnosed, side, request, parameters[side]) for side in range(2))
    both = _in_both(diagnosed)
    T_left_board = _poses(diagnosed, request, parameters, T_right_left)
    second = pose_stage_of_pixels(
        (cameras[0], cameras[1]),
        diagnosed.views.object_points_m,
        T_left_board,
        T_right_left,
        (diagnosed.views.left_px, diagnosed.views.right_px),
        both,
    )
    information, score = second.information.sum(axis=0), second.scores.sum(axis=0)
    longest = LONGEST_STEP_SIGMA * max(camera.noise_px for camera in cameras)
    is_converged = bool(np.sqrt(score @ np.linalg.solve(information, score)) < longest)
    solve = StagedSolve((cameras[0], cameras[1]), T_right_left, second, T_left_board, 0, is_converged, provenance)
    return summarize_stages(diagnosed, solve, **NOT_THERE)


def _in_both(diagnosed: DiagnosedViews) -> Bool[ndarray, "views n"]:
    return usable_corners(diagnosed.is_seen(0) & diagnosed.is_seen(1))


def usable_corners(is_seen: Bool[ndarray, "views n"], least: int = 6) -> Bool[ndarray, "views n"]:
    """The corners of views with at least so many: fewer hardly determine the board's pose."""
    return is_seen & (is_seen.sum(axis=1, keepdims=True) >= least)


def as_lists(
    points_m: Float[ndarray, "n 3"], is_used: Bool[ndarray, "views n"], *px: Float[ndarray, "views n 2"]
) -> tuple[list[ndarray], list[list[ndarray]]]:
    """Board points, and corners of each camera, as cv2 takes them, of the views with used corners.

    The fisheye module takes rows (1, n, c) alone; 32 bits, which ``calibrateCamera`` insists on, round by less than 1e-4 px.
    """
    views = np.flatnonzero(is_used.any(axis=1))
    points = [points_m[is_used[v]][None].astype(np.float32) for v in views]
    return points, [[side[v][is_used[v]][None].astype(np.float32) for v in views] for side in px]


def camera_by_opencv(
    points: Sequence[ndarray],
    corners: Sequence[ndarray],
    size_wh: tuple[int, int],
    model: str,
    start: tuple[ndarray, ndarray] | None = None,
) -> tuple[Float[ndarray, "3 3"], ndarray]:
    """K and distortion of one camera by ``calibrateCamera``, or by ``fisheye.calibrate``, from ``start`` if given.

    Raises:
        ValueError: OpenCV has no such model.
        cv2.error: OpenCV refuses the corners.
    """
    if model == "fisheye4":
        solve, flags = cv2.fisheye.calibrate, cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW
    else:
        solve, flags = cv2.calibrateCamera, _kind(model)
    if start is not None:
        flags |= cv2.CALIB_USE_INTRINSIC_GUESS
    K, distortion = (None, None) if start is None else start
    _, K, distortion, *_ = solve(points, corners, size_wh, K, distortion, flags=flags)  # pyright: ignore
    return K, np.ravel(distortion)


def rig_by_opencv(
    points: Sequence[ndarray],
    corners: Sequence[Sequence[ndarray]],
    cameras: Sequence[tuple[ndarray, ndarray]],
    size_wh: tuple[int, int],
    model: str,
    *,
    is_free: bool,
    stop: tuple[int, int, float] | None = None,
) -> tuple[list[tuple[ndarray, ndarray]], Float[ndarray, "3 3"], Float[ndarray, "3"]]:
    """Both cameras' K and distortion, R and t by ``stereoCalibrate``, the cameras held or refined along. Raises as the former.

    ``stop`` is cv2's rule of termination, its default if None; of fisheye lenses its default counts.
    """
    if model == "fisheye4":
        solve, flags = cv2.fisheye.stereoCalibrate, cv2.CALIB_FIX_SKEW | cv2.CALIB_RECOMPUTE_EXTRINSIC
    else:
        solve, flags = cv2.stereoCalibrate, _kind(model)
    flags |= cv2.CALIB_USE_INTRINSIC_GUESS if is_free else cv2.CALIB_FIX_INTRINSIC
    (K_l, d_l), (K_r, d_r) = cameras
    left, right = corners
    rule = {} if stop is None or model == "fisheye4" else {"criteria": stop}
    _, K_l, d_l, K_r, d_r, R, t, *_ = solve(points, left, right, K_l, d_l, K_r, d_r, size_wh, flags=flags, **rule)  # pyright: ignore
    return [(K_l, np.ravel(d_l)), (K_r, np.ravel(d_r))], R, np.ravel(t)


def _kind(model: str) -> int:
    if model not in KINDS:
        raise ValueError(f"OpenCV has no camera model {model!r}")
    return KINDS[model]


def _one_camera(diagnosed: DiagnosedViews, side: int, model: str) -> Float[ndarray, "p"]:
    views = diagnosed.views
    size_wh = views.left_size_wh if side == 0 else views.right_size_wh
    points, (corners,) = as_lists(views.object_points_m, diagnosed.is_seen(side), diagnosed.pixels(side))
    if len(points) < MIN_VIEWS:
        raise TooFewViewsError(len(points), MIN_VIEWS)
    try:
        K, distortion = camera_by_opencv(points, corners, size_wh, model)
    except cv2.error as error:
        raise _refused(error, ("left", "right")[side]) from None
    return _parameters(K, distortion, model, ("left", "right")[side])


def _both_cameras(
    diagnosed: DiagnosedViews, parameters: list[Float[ndarray, "p"]], model: str, *, is_free: bool
) -> tuple[list[Float[ndarray, "p"]], SE3]:
    views = diagnosed.views
    points, corners = as_lists(views.object_points_m, _in_both(diagnosed), views.left_px, views.right_px)
    if len(points) < MIN_VIEWS:
        raise TooFewViewsError(len(points), MIN_VIEWS)
    cameras = [_matrices(p) for p in parameters]
    try:
        cameras, R, t = rig_by_opencv(
            points, corners, cameras, views.left_size_wh, model, is_free=is_free, stop=ARRIVED
        )
    except cv2.error as error:
        raise _refused(error, "stereo") from None
    if not (np.isfinite(R).all() and np.isfinite(t).all()):
        raise NotConvergedError("cv2.stereoCalibrate gave no finite pose; see whether --calibrator lm finds one.")
    if is_free:
        parameters = [_parameters(*c, model, side) for c, side in zip(cameras, ("left", "right"), strict=True)]
    return parameters, SE3(R, t)


def _matrices(parameters: Float[ndarray, "p"]) -> tuple[ndarray, ndarray]:
    fx, fy, cx, cy = parameters[:4]
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]), np.array(parameters[5:])


def _parameters(K: ndarray, distortion: ndarray, model: str, side: str) -> Float[ndarray, "p"]:
    n = len(camera_model(model).distortion_names)
    values = np.r_[K[0, 0], K[1, 1], K[0, 2], K[1, 2], 0.0, distortion[:n]]
    if not (np.isfinite(values).all() and values[0] > 0 and values[1] > 0):
        raise NotConvergedError(f"cv2 gave no possible {side} camera; see whether --calibrator lm finds one.")
    return values


def _refused(error: cv2.error, what: str) -> NotConvergedError:
    text = " ".join(str(error.err or error).split())
    return NotConvergedError(f"cv2 refuses the {what} corners ({text}); --calibrator lm has no such limit.")


def _poses(
    diagnosed: DiagnosedViews, request: CalibrationRequest, parameters: list[Float[ndarray, "p"]], T_right_left: SE3
) -> SE3:
    """Poses of least squares over both cameras' corners, all alike: those at which ``stereoCalibrate`` ends."""
    views = diagnosed.views
    all_views = np.ones(views.left_is_seen.shape, dtype=bool)
    problem = _problem(views, request, all_views, is_free=False)
    start = BundleEstimate((parameters[0], parameters[1]), diagnosed.start.T_left_board, T_right_left)
    return minimize(problem, start, ALL_ALIKE).estimate.T_left_board


def _problem(
    views: Detections, request: CalibrationRequest, is_used: Bool[ndarray, "views n"], *, is_free: bool
) -> BundleProblem:
    cameras = tuple(
        CameraObservations.from_corners(
            camera_model(request.model), np.where(is_used[..., None], px, np.nan), intrinsics=is_free
        )
        for px in (views.left_px, views.right_px)
    )
    return BundleProblem(np.ascontiguousarray(views.object_points_m.T), cameras, is_rig_free=is_free)


def _of_joint_minimum(
    diagnosed: DiagnosedViews,
    request: CalibrationRequest,
    parameters: list[Float[ndarray, "p"]],
    T_right_left: SE3,
) -> StereoCalibration:
    """The calibration of a rig that cv2 refined with its cameras, from the normal equations where it ended."""
    is_used = _in_both(diagnosed)
    chosen = np.flatnonzero(is_used.any(axis=1))
    T_left_board = _poses(diagnosed, request, parameters, T_right_left)[chosen]
    problem = _problem(diagnosed.views.select(chosen), request, is_used[chosen], is_free=True)
    estimate = BundleEstimate((parameters[0], parameters[1]), T_left_board, T_right_left)
    ended = minimize(problem, estimate, replace(ALL_ALIKE, max_iterations=0))
    step = problem.solve_step(estimate, ended.equations, np.zeros(()))
    has_arrived = np.sqrt(2 * step.predicted_px2) < LONGEST_STEP_SIGMA * ended.scale_px
    solve = solve_real_views(problem, replace(ended, is_converged=has_arrived), board_shape="flat", exposure="together")
    calibration = summarize(
        diagnosed.views.select(chosen),
        solve,
        request,
        rejected=diagnosed.rejected,
        notes=diagnosed.notes,
        findings=diagnosed.findings,
        n_iterations=0,
    )
    return acceptance.apply_rules(calibration, is_converged=bool(has_arrived), **NOT_THERE)
