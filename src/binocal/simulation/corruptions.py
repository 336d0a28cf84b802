"""The mistakes people and detectors make, injected on purpose: each function returns new detections with one of them.

They exist to prove that none of these passes in silence. A view is given by its index; ``side`` is "left" or "right".
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.evidence import Detections
from binocal.shapes import Float

Side = Literal["left", "right"]


def shift_view_by_row(
    detections: Detections,
    board: Board,
    view: int,
    *,
    side: Side = "left",
    vacated: Literal["extrapolate", "wrap", "missing"] = "extrapolate",
) -> Detections:
    """Numbers a view's corners one grid row too low, as a detector does that took the board's rim for its first row.

    Corner (row, column) gets the pixel of (row + 1, column). The last row, which has no successor, is extrapolated
    in line (hardest to notice), wraps round to the first row, or is missing.
    """
    columns, rows = _grid(board)
    px = _px(detections, side)[view].reshape(rows, columns, 2)
    last = {"extrapolate": 2 * px[-1] - px[-2], "wrap": px[0], "missing": np.full_like(px[0], np.nan)}[vacated]
    return _with_view(detections, side, view, np.concatenate([px[1:], last[None]]).reshape(-1, 2))


def flip_view(detections: Detections, view: int, *, side: Side = "left") -> Detections:
    """Reverses the order of a view's corners: the board taken for turned by 180°."""
    return _with_view(detections, side, view, _px(detections, side)[view, ::-1])


def flip_all(detections: Detections, *, side: Side = "left") -> Detections:
    """Reverses the order of the corners in every view of one camera."""
    return _with_px(detections, side, _px(detections, side)[:, ::-1])


def flip_all_left(detections: Detections) -> Detections:
    """Reverses the order of the corners in every left view."""
    return flip_all(detections, side="left")


def mismatch_pair(detections: Detections, view: int, other: int, *, side: Side = "right") -> Detections:
    """Pairs a view with the image that one camera took at another view.

    Raises:
        ValueError: Both are the same view.
    """
    if view == other:
        raise ValueError(f"view {view} cannot be mismatched with itself")
    return _with_view(detections, side, view, _px(detections, side)[other])


def shift_all_pairs(detections: Detections, by: int = 1) -> Detections:
    """Pairs every left image with the right image ``by`` views later (the last ones with the first)."""
    return replace(detections, right_px=np.roll(detections.right_px, -by, axis=0))


def swap_cameras(detections: Detections) -> Detections:
    """Calls the left camera right, and the right one left."""
    return replace(
        detections,
        left_px=detections.right_px,
        right_px=detections.left_px,
        left_size_wh=detections.right_size_wh,
        right_size_wh=detections.left_size_wh,
    )


def exchange_columns_and_rows(detections: Detections, board: Board) -> Detections:
    """States the board as rows x columns: the corners keep their order, the object points are the other board's."""
    wrong = replace(board, columns=board.rows, rows=board.columns)
    return replace(detections, object_points_m=wrong.object_points_m)


def halve_right_resolution(detections: Detections) -> Detections:
    """Right corners measured in images reduced to half, while the stated size stays the full one."""
    return replace(detections, right_px=(detections.right_px + 0.5) / 2 - 0.5)


def zero_view(detections: Detections, view: int, *, side: Side = "left") -> Detections:
    """Sets all corners of a view to (0, 0): a failed detection stored as numbers."""
    return _with_view(detections, side, view, np.zeros_like(_px(detections, side)[view]))


def drop_view(detections: Detections, view: int, *, side: Side = "left") -> Detections:
    """Makes all corners of a view NaN: the board was not found."""
    return _with_view(detections, side, view, np.full_like(_px(detections, side)[view], np.nan))


def swap_image_size(detections: Detections) -> Detections:
    """States (height, width) where (width, height) is due."""
    width, height = detections.left_size_wh
    return state_image_size(detections, (height, width))


def state_image_size(detections: Detections, size_wh: tuple[int, int]) -> Detections:
    """States another image size, for both cameras, than that in which the corners were measured."""
    return replace(detections, left_size_wh=tuple(size_wh), right_size_wh=tuple(size_wh))


def repeat_view(detections: Detections, view: int, n_views: int) -> Detections:
    """One view, noise included, ``n_views`` times under different names."""
    repeated = detections.select(np.full(n_views, view))
    return replace(repeated, names=tuple(f"{i:0{len(str(max(n_views - 1, 0)))}d}" for i in range(n_views)))


def _grid(board: Board) -> tuple[int, int]:
    """Columns and rows of the points of a board whose points form one grid."""
    if board.kind == "aprilgrid":
        raise ValueError("the points of an aprilgrid carry their identity and do not form rows; choose another board")
    if board.kind == "squares":
        return 2 * board.columns, 2 * board.rows
    inner = 1 if board.kind == "charuco" else 0
    return board.columns - inner, board.rows - inner


def _px(detections: Detections, side: Side) -> Float[ndarray, "views n 2"]:
    if side not in ("left", "right"):
        raise ValueError(f"side must be 'left' or 'right'; got {side!r}")
    return detections.left_px if side == "left" else detections.right_px


def _with_px(detections: Detections, side: Side, px: Float[ndarray, "views n 2"]) -> Detections:
    return replace(detections, left_px=px) if side == "left" else replace(detections, right_px=px)


def _with_view(detections: Detections, side: Side, view: int, px: Float[ndarray, "n 2"]) -> Detections:
    changed = _px(detections, side).copy()
    changed[view] = px
    return _with_px(detections, side, changed)
