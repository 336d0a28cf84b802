"""What the benchmarks compare with: OpenCV's fast pipeline from an image to the rig, given what it does best.

The classic chessboard finder and ``cornerSubPix``; five distortion coefficients; exact board, no outliers. Intrinsics
are refined jointly, or held as most tutorials do.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.calibrators.opencv import as_lists, camera_by_opencv, rig_by_opencv, usable_corners
from binocal.cameras import Camera, StereoRig
from binocal.datasets.folder import ImagePair
from binocal.errors import DetectionError, FormatError
from binocal.evidence import Detections
from binocal.geometry import SE3
from binocal.shapes import Float
from binocal.threads import n_threads

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


def detect_with_opencv(pairs: Sequence[ImagePair], board: Board) -> Detections:
    """The corners of the pairs in which both finders saw the board, an image a thread.

    Raises:
        FormatError: OpenCV cannot read an image.
        DetectionError: The board was found in no pair.
    """
    paths = [path for pair in pairs for path in (pair.left_path, pair.right_path)]
    with ThreadPoolExecutor(n_threads()) as pool:
        found = list(pool.map(lambda path: _size_and_corners(path, board), paths))
    seen = [bool(a[1] is not None and b[1] is not None) for a, b in zip(found[0::2], found[1::2], strict=True)]
    if not any(seen):
        raise DetectionError("OpenCV finds the board in no pair.")
    left, right = (np.stack(side)[:, :, 0].astype(float) for side in pair_corners([corners for _, corners in found]))
    names = tuple(pair.name for pair, is_seen in zip(pairs, seen, strict=True) if is_seen)
    return Detections.from_arrays(board.object_points_m, left, right, found[0][0], names=names)


def _size_and_corners(path: Path, board: Board) -> tuple[tuple[int, int], Float[ndarray, "n 1 2"] | None]:
    grey = read_grey(path)
    return (grey.shape[1], grey.shape[0]), find_corners_with_opencv(grey, board)


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
