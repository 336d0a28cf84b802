"""What the benchmarks compare with: OpenCV's fast pipeline from an image to the rig, given what it does best.

Corners by :mod:`binocal.detection.opencv_finder`; five distortion coefficients; exact board, no outliers. Intrinsics are refined
jointly, or held as most tutorials do.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from numpy import ndarray

from binocal.calibrators.opencv import as_lists, camera_by_opencv, rig_by_opencv, usable_corners
from binocal.cameras import Camera, StereoRig
from binocal.evidence import Detections
from binocal.geometry import SE3
from binocal.shapes import Float

Views = Sequence[ndarray]


def calibrate_views(
    board_points_m: Float[ndarray, "n 3"], left: Views, right: Views, size_wh: tuple[int, int], *, is_joint: bool = True
) -> tuple[Float[ndarray, "3 3"], Float[ndarray, "3"]]:
    """R and t of calibrations of each camera and the stereo solve, in which intrinsics are free (``is_joint``) or held."""
    import cv2

    points = [np.ascontiguousarray(board_points_m, dtype=np.float32)] * len(left)
    _, K_l, d_l, _, _ = cv2.calibrateCamera(points, left, size_wh, None, None)
    _, K_r, d_r, _, _ = cv2.calibrateCamera(points, right, size_wh, None, None)
    flags = cv2.CALIB_USE_INTRINSIC_GUESS if is_joint else cv2.CALIB_FIX_INTRINSIC
    result = cv2.stereoCalibrate(points, left, right, K_l, d_l, K_r, d_r, size_wh, flags=flags)
    return result[5], result[6].ravel()


def run_opencv(detections: Detections) -> tuple[float, ndarray, ndarray]:
    """Seconds, R and t of the joint solve from corners that are all seen."""
    left, right = (
        [np.ascontiguousarray(p, dtype=np.float32)[:, None] for p in px]
        for px in (detections.left_px, detections.right_px)
    )
    start = time.perf_counter()
    R, t = calibrate_views(detections.object_points_m, left, right, detections.left_size_wh)
    return time.perf_counter() - start, R, t


def calibrate_rig(detections: Detections, model: str, *, start: StereoRig | None = None) -> StereoRig:
    """The rig of a calibration of each camera from all that it saw, then the joint solve with intrinsics free.

    ``model`` is ``brown4``, ``brown5``, ``brown8`` or ``fisheye4``, for which OpenCV has a module of its own. Views with fewer than
    six corners are left out. With ``start``, the lenses of that model are calibrated from those of that rig.

    Raises:
        ValueError: OpenCV has no such model.
        cv2.error: OpenCV refuses the corners.
    """
    sizes = (detections.left_size_wh, detections.right_size_wh)
    left_seen, right_seen = (usable_corners(seen) for seen in (detections.left_is_seen, detections.right_is_seen))
    starts = [None, None] if start is None else [(c.K.copy(), c.distortion.copy()) for c in (start.left, start.right)]
    cameras = []
    for px, is_seen, size_wh, guess in zip(
        (detections.left_px, detections.right_px), (left_seen, right_seen), sizes, starts, strict=True
    ):
        points, (corners,) = as_lists(detections.object_points_m, is_seen, px)
        cameras.append(camera_by_opencv(points, corners, size_wh, model, guess))
    both = usable_corners(left_seen & right_seen)
    points, corners = as_lists(detections.object_points_m, both, detections.left_px, detections.right_px)
    cameras, R, t = rig_by_opencv(points, corners, cameras, sizes[0], model, is_free=True)
    n = {"brown4": 4, "brown5": 5, "brown8": 8, "fisheye4": 4}[model]
    left_camera, right_camera = (
        Camera(model, size, np.r_[K[0, 0], K[1, 1], K[0, 2], K[1, 2], 0.0, d[:n]])
        for size, (K, d) in zip(sizes, cameras, strict=True)
    )
    return StereoRig(left_camera, right_camera, SE3(R, t), detections.is_metric)
