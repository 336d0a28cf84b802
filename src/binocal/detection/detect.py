"""One image and a board in, the board's points out."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.detection.aprilgrid import TagLayout
from binocal.detection.charuco import Layout
from binocal.detection.chessboard import detect_chessboard
from binocal.detection.found import FoundBoard, not_found
from binocal.images.reading import to_grey
from binocal.shapes import Float, Float32, Int, UInt8

MIN_SIDE_PX = 32
BLANK_DN = 6.0  # of 255 after stretching at most fourfold
MUCH_SATURATED = 0.6  # share of the image, from which it is named where no board is found
# Of a drawing that no camera took: pixels of exactly the least or the greatest value, together and each, and the blur that a lens would
# add. Steps within a pixel are none that edges in photographs have: a third of the corners beside markers was lost, the others were off
# by up to 0.11 px; blurred, all are found within 0.026 px.
DRAWN_SHARE, LEAST_DRAWN_SHARE, DRAWING_BLUR_PX = 0.9, 0.05, 0.7
STEP_PX, EDGE_PX = 2, 8  # from black to white: a drawn edge does it in two pixels, none that is blurred by 0.5 px does
LEAST_STEPS = 0.05  # of the pairs across edges: 2/8 of them where edges lie between pixels, 1/7 where they cut pixels
GREATEST_STRETCH = 4.0  # an 8-bit image has no more to give: beyond it rounding looks like corners


def detect(image: ndarray, board: Board) -> FoundBoard:
    """The board's points in an image (h, w) or (h, w, 3), uint8 or uint16, colours in blue-green-red order.

    A board that cannot be found is not an error: ``reason`` says why. See :class:`binocal.detection.found.FoundBoard`.

    Raises:
        ValueError: The array is not an image.
    """
    return detect_in_layout(image, board, None)[0]


def detect_in_layout(
    image: ndarray,
    board: Board,
    layout: Layout | TagLayout | None,
    expected_px: Float[ndarray, "n 2"] | None = None,
) -> tuple[FoundBoard, Layout | TagLayout | None]:
    """As :func:`detect`, with a marker board's layout given (None: from the image), and the one the image proves.

    ``expected_px`` is where a marked chessboard's corners must be, where that is known: a part without its marks is named by it.

    Raises:
        ValueError: The array is not an image.
    """
    grey = soften_drawing(to_grey(image))
    if min(grey.shape) < MIN_SIDE_PX:
        return not_found(board.n_points, f"the image is only {grey.shape[1]}x{grey.shape[0]} pixels"), None
    found, proved = _detect_kind(grey, board, layout, expected_px)
    if not found.is_found and (share := saturated_share(grey)) > MUCH_SATURATED:
        text = f"{found.reason} ({100 * share:.0f} % of the image is saturated: overexposed?)"
        found = replace(found, reason=text)
    return found, proved


def _detect_kind(
    grey: ndarray,
    board: Board,
    layout: Layout | TagLayout | None,
    expected_px: Float[ndarray, "n 2"] | None,
) -> tuple[FoundBoard, Layout | TagLayout | None]:
    stretched, problem = stretch_8_bit(grey)
    if problem:
        return not_found(board.n_points, problem), None
    # Each kind of board is loaded when it is first asked for.
    if board.kind in ("circles", "acircles"):
        from binocal.detection.circles import detect_circles

        return detect_circles(grey, stretched, board), None
    if board.kind == "squares":
        from binocal.detection.squares import detect_squares

        return detect_squares(grey, stretched, board), None
    if board.kind == "charuco":
        from binocal.detection.charuco import detect_charuco

        return detect_charuco(grey, stretched, board, layout if isinstance(layout, str) else "")
    if board.kind == "aprilgrid":
        from binocal.detection.aprilgrid import TagLayout, detect_aprilgrid

        return detect_aprilgrid(grey, stretched, board, layout if isinstance(layout, TagLayout) else None)
    if board.kind == "puzzleboard":
        from binocal.detection.chessboard.puzzle import detect_puzzleboard

        return detect_puzzleboard(grey, stretched, board), None
    if board.is_marked:
        from binocal.detection.chessboard.marked import detect_marked_chessboard

        return detect_marked_chessboard(grey, stretched, board, expected_px), None
    return detect_chessboard(grey, stretched, board), None


def soften_drawing(grey: ndarray) -> ndarray:
    """A drawing in black and white, such as a printed board's own file, as a sharp lens would show it; other images as they are."""
    levels = _levels(grey)
    used = np.flatnonzero(levels)
    ends = levels[used[[0, -1]]] / levels.sum()
    if len(used) < 2 or ends.min() < LEAST_DRAWN_SHARE or ends.sum() < DRAWN_SHARE:
        return grey
    if _count_steps(grey, STEP_PX) < LEAST_STEPS * _count_steps(grey, EDGE_PX):
        return grey
    return cv2.GaussianBlur(grey, (0, 0), DRAWING_BLUR_PX)


def _count_steps(grey: ndarray, reach: int) -> int:
    """Pairs of pixels that far apart in a row, one of the image's least value and one of its greatest."""
    left, right = grey[:, :-reach], grey[:, reach:]
    least, greatest = grey.min(), grey.max()
    return sum(int(np.count_nonzero((a == least) & (b == greatest))) for a, b in ((left, right), (right, left)))


def stretch(grey: ndarray) -> tuple[Float32[ndarray, "h w"], str]:
    """The image as float32 in 0..255, stretched (8-bit: at most fourfold), and what makes it useless, if anything."""
    low, gain, problem = _measure_range(grey)
    if problem:
        return grey.astype(np.float32), problem
    return np.clip((grey.astype(np.float32) - low) * gain, -64, 320), ""


def stretch_8_bit(grey: ndarray) -> tuple[UInt8[ndarray, "h w"], str]:
    """As :func:`stretch`, in uint8 and with a margin beyond the percentiles: a small board may be brighter than all else.

    An image that needs no stretching is returned as it is.
    """
    low, gain, problem = _measure_range(grey)
    if problem or (grey.dtype == np.uint8 and gain == 1):
        return grey.astype(np.uint8, copy=False), problem
    span = 255 / gain
    least, most, _, _ = cv2.minMaxLoc(grey)
    low, high = max(least, low - 0.5 * span), min(most, low + 1.5 * span)
    gain = min(gain, 255 / (high - low))
    if grey.dtype == np.uint8:
        table = np.clip(np.rint((np.arange(256) - low) * gain), 0, 255).astype(np.uint8)
        return cv2.LUT(grey, table), ""
    # convertScaleAbs would fold what lies below the range,
    # and OpenCV's type stubs do not know that it takes a number for a scalar.
    scaled = cv2.multiply(grey, gain, dtype=cv2.CV_32F)  # pyright: ignore[reportCallIssue, reportArgumentType]
    return cv2.add(scaled, -low * gain, dtype=cv2.CV_8U), ""  # pyright: ignore[reportCallIssue, reportArgumentType]


def saturated_share(grey: ndarray) -> float:
    """Share of the pixels at the top of the range: 254 and 255 of 8 bits, the greatest value of 16 bits.

    Much of it is no fault by itself: white paper and lamps saturate in images whose corners are whole.
    """
    levels = _levels(grey)
    top = 255 if grey.dtype == np.uint8 else len(levels) - 1
    return float(levels[top - (1 if grey.dtype == np.uint8 else 0) :].sum() / levels.sum()) if top > 0 else 0.0


def _levels(grey: ndarray) -> Int[ndarray, "levels"]:
    """How many of a sample of the pixels have each grey value."""
    step = max(1, min(grey.shape) // 120)
    return np.bincount(np.ascontiguousarray(grey[::step, ::step]).ravel())


def _measure_range(grey: ndarray) -> tuple[float, float, str]:
    """The grey level that becomes 0, the gain, and what makes the image useless, if anything."""
    least = BLANK_DN if grey.dtype == np.uint8 else 16.0
    levels = _levels(grey)
    n = int(levels.sum())
    ranks = (int(0.005 * (n - 1)), int(np.ceil(0.995 * (n - 1))))
    low, high = (float(level) for level in np.searchsorted(np.cumsum(levels), ranks, side="right"))
    if high - low < least:
        # A board may be smaller than what the percentiles leave out, on a ground without any texture.
        low, high = (float(level) for level in cv2.minMaxLoc(grey)[:2])
    span = high - low
    if span < least:
        return low, 1.0, f"the image is blank (its grey values span {span:.0f} levels)"
    gain = 255.0 / span
    if grey.dtype == np.uint8:
        gain = min(gain, GREATEST_STRETCH) if gain > 1.5 else 1.0
        low = low if gain > 1 else 0.0
    return low, gain, ""
