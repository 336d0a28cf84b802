"""Which part of a board a lattice of X-corners is, by where the board's corners must lie."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.detection.finding.marked_squares import TURNS, Placement
from binocal.shapes import Float

MOST_OFF = 0.25  # of the distance to the next corner, for nine of ten: a part named wrongly is off by a whole one
LEAST_CORNERS = 6


def place_near(
    board: Board, grid_px: Float[ndarray, "rows columns 2"], expected_px: Float[ndarray, "n 2"]
) -> list[Placement]:
    """Ways to lay the board over a lattice so that its corners lie where they are expected, NaN: anywhere; one at most, but by mirrors."""
    seen = np.argwhere(np.isfinite(grid_px[..., 0]))[:, ::-1]
    px = grid_px[seen[:, 1], seen[:, 0]]
    near = np.flatnonzero(np.isfinite(expected_px[:, 0]))
    if len(near) < LEAST_CORNERS or len(seen) < LEAST_CORNERS:
        return []
    nearest = near[np.argmin(np.linalg.norm(px[:, None] - expected_px[near], axis=-1), axis=1)]
    place = np.stack([nearest % board.columns, nearest // board.columns], axis=-1)
    grid = expected_px.reshape(board.rows, board.columns, 2)
    found = []
    for turn in TURNS:
        shifts, counts = np.unique(place - seen @ turn.T, axis=0, return_counts=True)
        shift = shifts[np.argmax(counts)]
        corners = seen @ turn.T + shift
        inside = ((corners >= 0) & (corners < [board.columns, board.rows])).all(axis=1)
        at = grid[corners[inside, 1], corners[inside, 0]]
        off, step = np.linalg.norm(at - px[inside], axis=-1), _steps(grid)[corners[inside, 1], corners[inside, 0]]
        share = off[np.isfinite(off)] / step[np.isfinite(off)]
        if len(share) >= LEAST_CORNERS and np.quantile(share, 0.9) < MOST_OFF:
            found.append(Placement(turn, shift, int((~inside).sum())))
    return found


def _steps(grid_px: Float[ndarray, "rows columns 2"]) -> Float[ndarray, "rows columns"]:
    """From each place to the nearest beside it; NaN where none is known."""
    steps = np.full((4, *grid_px.shape[:2]), np.inf)
    across = np.linalg.norm(np.diff(grid_px, axis=1), axis=-1)
    along = np.linalg.norm(np.diff(grid_px, axis=0), axis=-1)
    steps[0, :, :-1], steps[1, :, 1:], steps[2, :-1], steps[3, 1:] = across, across, along, along
    least = np.fmin.reduce(steps, axis=0)
    return np.where(np.isfinite(least), least, np.nan)
