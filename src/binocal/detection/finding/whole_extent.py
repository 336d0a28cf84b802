"""A marked board whose marks are covered, seen from its first to its last row and column: its extent and its colours name it."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.detection.finding.marked_squares import MOST_STRAY, TURNS, Placement, SquareReadings
from binocal.shapes import Float

LEAST_BORDER_SHARE = (
    1 / 3
)  # of each outer row's and column's corners: what else is linked to a board is a corner or two


def place_whole(board: Board, grid_px: Float[ndarray, "rows columns 2"], readings: SquareReadings) -> list[Placement]:
    """Ways to lay the board over a lattice of its very size, that no more of the marked squares deny than confirm, and no others.

    A cloth of a square's own grey value hides a disc and leaves no trace. Of two ways, half a turn apart, colours tell one in most
    boards; that is not looked at here.
    """
    is_known = np.isfinite(grid_px[..., 0])
    rows, columns = is_known.shape
    if min(side.mean() for side in (is_known[0], is_known[-1], is_known[:, 0], is_known[:, -1])) < LEAST_BORDER_SHARE:
        return []
    is_disc, is_swapped = readings.is_disc(), readings.is_swapped()
    is_read = np.isfinite(readings.disc) | is_swapped
    marks = [(square, is_disc) for square in board.discs] + [(square, is_swapped) for square in board.swapped]
    n_marked = int(bool(board.discs) * is_disc.sum() + bool(board.swapped) * is_swapped.sum())
    found: list[tuple[int, Placement]] = []
    for turn in TURNS:
        ends = np.array([[0, 0], [columns - 1, rows - 1]]) @ turn.T
        if (np.ptp(ends, axis=0) + 1).tolist() != [board.columns, board.rows]:
            continue
        shift = -ends.min(axis=0)
        places = ((2 * np.array([square for square, _ in marks]) - 1 - 2 * shift) @ turn - 1) // 2
        told = [
            bool(is_like_this[row, column])
            for (column, row), (_, is_like_this) in zip(places, marks, strict=True)
            if is_read[row, column]
        ]
        n_agreeing = sum(told)
        most_stray = MOST_STRAY * is_read.sum() if all(told) else 0  # a mirror image has two discs of three in place
        if 2 * n_agreeing >= len(told) and n_marked - n_agreeing <= most_stray:
            found.append((2 * n_agreeing - len(told), Placement(turn, shift, 0)))
    most = max((score for score, _ in found), default=0)
    return [placement for score, placement in found if score == most]
