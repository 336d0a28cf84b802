"""What the benchmarks compare with: OpenCV's fast pipeline from an image to the rig, given what it does best.

The classic chessboard finder and ``cornerSubPix``; five distortion coefficients; exact board, no outliers. Intrinsics
are refined jointly, or held as most tutorials do.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.cameras import Camera, StereoRig
from binocal.errors import FormatError
from binocal.evidence import Detections
from binocal.geometry import SE3
from binocal.shapes import Float

WINDOW = (5, 5)  # of cornerSubPix: half its side
Views = Sequence[ndarray]
LEAST_CORNERS = 6  # of a view: fewer hardly determine the board's pose


def read_grey(path: Path) -> ndarray:
    """The grey levels of an image, as ``cv2.imread`` decodes it."""
    import cv2

    grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if grey is None:
        raise FormatError(path, "OpenCV cannot read it")
    return grey


def find_corners_with_opencv(grey: ndarray, board: Board) -> Float[ndarray, "n 1 2"] | None:
    """The board's corners, or None where it is not found."""
    import cv2

    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    is_found, corners = cv2.findChessboardCorners(grey, (board.columns, board.rows), flags=flags)
    if not is_found:
        return None
    return _refined(grey, corners)


def find_corners_by_sector(grey: ndarray, board: Board) -> Float[ndarray, "n 1 2"] | None:
    """The board's corners by ``findChessboardCornersSB``, which finds more through strong lenses, then ``cornerSubPix``, or None."""
    import cv2

    is_found, corners = cv2.findChessboardCornersSB(grey, (board.columns, board.rows))
    if not is_found:
        return None
    return _refined(grey, corners)


def _refined(grey: ndarray, corners: ndarray) -> Float[ndarray, "n 1 2"]:
    import cv2

    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 1e-3)
    return cv2.cornerSubPix(grey, np.ascontiguousarray(corners).reshape(-1, 1, 2), WINDOW, (-1, -1), stop)


def pair_corners(corners: Sequence[ndarray | None]) -> tuple[list[ndarray], list[ndarray]]:
    """Left and right corners of the pairs (left, right, left, right, ...) in which both were found, in one order."""
    both = [(a, b) for a, b in zip(corners[0::2], corners[1::2], strict=True) if a is not None and b is not None]
    return [a for a, _ in both], [_same_way(a, b) for a, b in both]


def _same_way(left: ndarray, right: ndarray) -> ndarray:
    """The right corners in the left ones' order, where the finder numbered the two images from opposite ends."""
    row_left, row_right = left[-1, 0] - left[0, 0], right[-1, 0] - right[0, 0]
    return right if float(row_left @ row_right) > 0 else right[::-1].copy()


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
    import cv2

    sizes = (detections.left_size_wh, detections.right_size_wh)
    seen = (detections.left_is_seen, detections.right_is_seen)
    if model == "fisheye4":
        solve_mono, solve_stereo = cv2.fisheye.calibrate, cv2.fisheye.stereoCalibrate
        mono, stereo = cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW, cv2.CALIB_FIX_SKEW
        stereo |= cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_USE_INTRINSIC_GUESS
    else:
        kinds = {"brown4": cv2.CALIB_FIX_K3, "brown5": 0, "brown8": cv2.CALIB_RATIONAL_MODEL}
        if model not in kinds:
            raise ValueError(f"OpenCV has no camera model {model!r}")
        solve_mono, solve_stereo = cv2.calibrateCamera, cv2.stereoCalibrate
        mono, stereo = kinds[model], kinds[model] | cv2.CALIB_USE_INTRINSIC_GUESS
    cameras: list[ndarray] = []
    starts: list[tuple[ndarray | None, ndarray | None]] = [(None, None)] * 2
    if start is not None:
        mono |= cv2.CALIB_USE_INTRINSIC_GUESS
        starts = [(camera.K.copy(), camera.distortion.copy()) for camera in (start.left, start.right)]
    for px, is_seen, size_wh, guess in zip((detections.left_px, detections.right_px), seen, sizes, starts, strict=True):
        points, (corners,) = _seen_corners(detections.object_points_m, is_seen, px)
        _, K, coefficients, *_ = solve_mono(points, corners, size_wh, *guess, flags=mono)  # pyright: ignore
        cameras += [K, coefficients]
    both = seen[0] & seen[1]
    points, (left, right) = _seen_corners(detections.object_points_m, both, detections.left_px, detections.right_px)
    _, K_l, d_l, K_r, d_r, R, t, *_ = solve_stereo(points, left, right, *cameras, sizes[0], flags=stereo)  # pyright: ignore
    n = {"brown4": 4, "brown5": 5, "brown8": 8, "fisheye4": 4}[model]
    left_camera, right_camera = (
        Camera(model, size, np.r_[K[0, 0], K[1, 1], K[0, 2], K[1, 2], 0.0, np.ravel(d)[:n]])
        for size, K, d in zip(sizes, (K_l, K_r), (d_l, d_r), strict=True)
    )
    return StereoRig(left_camera, right_camera, SE3(R, np.ravel(t)), detections.is_metric)


def _seen_corners(
    points_m: Float[ndarray, "n 3"], is_seen: ndarray, *px: Float[ndarray, "views n 2"]
) -> tuple[list[ndarray], list[list[ndarray]]]:
    """Board points, and corners of each camera, of the views with enough of them."""
    views = np.nonzero(is_seen.sum(axis=1) >= LEAST_CORNERS)[0]
    # The fisheye module takes rows (1, n, c) alone; 32 bits, which calibrateCamera insists on, round by less than 1e-4 px.
    points = [points_m[is_seen[v]][None].astype(np.float32) for v in views]
    return points, [[side[v][is_seen[v]][None].astype(np.float32) for v in views] for side in px]
