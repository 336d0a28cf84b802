"""cv2's own chessboard finder as its users call it, for comparisons: ``findChessboardCorners`` and ``cornerSubPix``.

Nothing that calibrates asks it; it knows no order of corners between the two images but the one that the rows' direction tells.
Source: OpenCV documentation, "Camera Calibration and 3D Reconstruction"; its tutorial "Camera Calibration".
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.datasets.folder import ImagePair
from binocal.errors import DetectionError, FormatError
from binocal.evidence import Detections
from binocal.shapes import Float
from binocal.threads import n_threads

WINDOW = (5, 5)  # of cornerSubPix: half its side


def read_grey(path: Path) -> ndarray:
    """The grey levels of an image, as ``cv2.imread`` decodes it."""
    grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if grey is None:
        raise FormatError(path, "OpenCV cannot read it")
    return grey


def find_corners_with_opencv(grey: ndarray, board: Board) -> Float[ndarray, "n 1 2"] | None:
    """The board's corners, or None where it is not found."""
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    is_found, corners = cv2.findChessboardCorners(grey, (board.columns, board.rows), flags=flags)
    if not is_found:
        return None
    return _refined(grey, corners)


def find_corners_by_sector(grey: ndarray, board: Board) -> Float[ndarray, "n 1 2"] | None:
    """The board's corners by ``findChessboardCornersSB``, which finds more through strong lenses, then ``cornerSubPix``, or None."""
    is_found, corners = cv2.findChessboardCornersSB(grey, (board.columns, board.rows))
    if not is_found:
        return None
    return _refined(grey, corners)


def _refined(grey: ndarray, corners: ndarray) -> Float[ndarray, "n 1 2"]:
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
