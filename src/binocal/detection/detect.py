"""One picture and a board in, the board's points out."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.datasets.pictures import to_grey
from binocal.detection.aprilgrid import TagLayout, detect_aprilgrid
from binocal.detection.charuco import Layout, detect_charuco
from binocal.detection.chessboard import detect_chessboard
from binocal.detection.circles import detect_circles
from binocal.detection.found import FoundBoard, not_found

if TYPE_CHECKING:
    from jaxtyping import Float32

MIN_SIDE_PX = 32
BLANK_DN = 6.0  # of 255 after stretching at most fourfold
GREATEST_STRETCH = 4.0  # an 8-bit picture has no more to give: beyond it rounding looks like corners


def detect(image: ndarray, board: Board) -> FoundBoard:
    """The board's points in a picture (h, w) or (h, w, 3), uint8 or uint16, colours in blue-green-red order.

    A board that cannot be found is not an error: ``reason`` says why. See :class:`binocal.detection.found.FoundBoard`.

    Raises:
        ValueError: The array is not a picture.
    """
    return detect_in_layout(image, board, None)[0]


def detect_in_layout(
    image: ndarray, board: Board, layout: Layout | TagLayout | None
) -> tuple[FoundBoard, Layout | TagLayout | None]:
    """As :func:`detect`, with a marker board's layout given (None: from the picture), and the one the picture proves.

    Raises:
        ValueError: The array is not a picture.
    """
    grey = to_grey(image)
    if min(grey.shape) < MIN_SIDE_PX:
        return not_found(board.n_points, f"the picture is only {grey.shape[1]}x{grey.shape[0]} pixels"), None
    stretched, problem = stretch(grey)
    if problem:
        return not_found(board.n_points, problem), None
    if board.kind == "chessboard":
        return detect_chessboard(grey, stretched, board), None
    if board.kind == "charuco":
        return detect_charuco(grey, stretched, board, layout if isinstance(layout, str) else "")
    if board.kind == "aprilgrid":
        return detect_aprilgrid(grey, stretched, board, layout if isinstance(layout, TagLayout) else None)
    return detect_circles(grey, stretched, board), None


def stretch(grey: ndarray) -> tuple[Float32[ndarray, "h w"], str]:
    """The picture as float32 in 0..255, stretched (8-bit: at most fourfold), and what makes it useless, if anything."""
    step = max(1, min(grey.shape) // 120)
    low, high = (float(value) for value in np.percentile(grey[::step, ::step], (0.5, 99.5)))
    span = high - low
    top = 255.0 if grey.dtype == np.uint8 else float(grey.max())
    share = float(np.mean(grey[::step, ::step] >= top - (1 if grey.dtype == np.uint8 else 0)))
    if share > 0.6 and top > 0:
        return grey.astype(np.float32), f"the picture is overexposed ({100 * share:.0f} % of it is saturated)"
    least = BLANK_DN if grey.dtype == np.uint8 else 16.0
    if span < least:
        return grey.astype(np.float32), f"the picture is blank (its grey values span {span:.0f} levels)"
    gain = 255.0 / span
    if grey.dtype == np.uint8:
        gain = min(gain, GREATEST_STRETCH) if gain > 1.5 else 1.0
        low = low if gain > 1 else 0.0
    return np.clip((grey.astype(np.float32) - low) * gain, -64, 320), ""
