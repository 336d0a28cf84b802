"""Which of an image's lattices are boards, and not pieces of the clutter or of one another."""

from __future__ import annotations

import cv2
import numpy as np
from numpy import ndarray

from binocal.detection.finding.grid import grid_spacing
from binocal.detection.finding.lattice import Lattice
from binocal.detection.finding.regularity import find_irregular
from binocal.shapes import Float

MIN_LINES = 3  # of a board, and of a part that can be grown to one: two lines fit any pair of edges
MIN_SHARE_OF_OTHER = 0.85  # of a board of another size, which is only a board if it is nearly whole
# A second board counts from this share of the first one's corners, and of its spacing, on: an image on a screen does not.
RIVAL_CORNERS = 0.4
RIVAL_SPACING = 0.4


def boards_among(lattices: list[Lattice], main: Lattice | None = None, *, size_wh: tuple[int, int]) -> list[Lattice]:
    """The lattices of an image of this size that are boards: regular, nearly complete, not much smaller than the main one.

    That is the largest if none is given.
    """
    boards = [] if main is None else [main]
    for lattice in lattices:
        if lattice is main or not _is_nearly_whole(lattice) or (boards and _is_minor(lattice, boards)):
            continue
        if _is_regular(lattice, size_wh):
            boards.append(lattice)
    return boards


def is_board(lattice: Lattice, *, size_wh: tuple[int, int]) -> bool:
    """Whether a lattice of an image of this size is a board by itself: regular and nearly complete."""
    return _is_nearly_whole(lattice) and _is_regular(lattice, size_wh)


def _is_nearly_whole(lattice: Lattice) -> bool:
    rows, columns = lattice.points_px.shape[:2]
    return min(rows, columns) >= MIN_LINES and lattice.n_seen >= MIN_SHARE_OF_OTHER * rows * columns


def _is_minor(lattice: Lattice, boards: list[Lattice]) -> bool:
    """Whether a lattice is much smaller than the first board, or lies within one of them."""
    if lattice.n_seen < RIVAL_CORNERS * boards[0].n_seen:
        return True
    spacing, of_first = (np.nanmedian(grid_spacing(each.points_px)) for each in (lattice, boards[0]))
    return bool(spacing < RIVAL_SPACING * of_first) or any(_lies_within(lattice, board) for board in boards)


def _is_regular(lattice: Lattice, size_wh: tuple[int, int]) -> bool:
    xy = _cells(lattice.points_px)
    seen = np.isfinite(lattice.points_px[..., 0]).ravel()
    points, spacing = lattice.points_px.reshape(-1, 2)[seen], grid_spacing(lattice.points_px).ravel()[seen]
    return not find_irregular(xy[seen], points, spacing, size_wh).any()


def _lies_within(lattice: Lattice, board: Lattice) -> bool:
    """Whether the middle of a lattice lies inside the outline of a board."""
    corners = board.points_px[[0, 0, -1, -1], [0, -1, -1, 0]]
    if not np.isfinite(corners).all():
        corners = board.points_px[np.isfinite(board.points_px[..., 0])]
    hull = cv2.convexHull(corners.astype(np.float32))
    centre = np.nanmean(lattice.points_px.reshape(-1, 2), axis=0)
    return cv2.pointPolygonTest(hull, (float(centre[0]), float(centre[1])), False) >= 0


def _cells(grid: Float[ndarray, "rows columns 2"]) -> Float[ndarray, "n 2"]:
    rows, columns = grid.shape[:2]
    return np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2).astype(float)
