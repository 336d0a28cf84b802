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
from binocal.errors import FormatError
from binocal.evidence import Detections
from binocal.shapes import Float

WINDOW = (5, 5)  # of cornerSubPix: half its side
Views = Sequence[ndarray]


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
