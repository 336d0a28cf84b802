"""Distances within a grid of points in an image: how far the next corner is, and how far the next edge."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.shapes import Float

_ALL, _BUT_LAST, _BUT_FIRST = slice(None), slice(None, -1), slice(1, None)
_NEIGHBOURS = (  # of a grid: the two ends of the steps along rows, columns and both diagonals
    ((_ALL, _BUT_LAST), (_ALL, _BUT_FIRST)),
    ((_BUT_LAST, _ALL), (_BUT_FIRST, _ALL)),
    ((_BUT_LAST, _BUT_LAST), (_BUT_FIRST, _BUT_FIRST)),
    ((_BUT_LAST, _BUT_FIRST), (_BUT_FIRST, _BUT_LAST)),
)


SIDES = (0, 1, 2, 3)  # of a grid: top, bottom, left, right


def add_line(grid: Float[ndarray, "rows columns k"], side: int) -> Float[ndarray, "rows2 columns2 k"]:
    """The grid with one more line, of NaN, on a side."""
    pad = [(0, 0), (0, 0), (0, 0)]
    pad[side // 2] = (1, 0) if is_before(side) else (0, 1)
    return np.pad(grid, pad, constant_values=np.nan)


def border_line(side: int) -> tuple[int | slice, ...]:
    """The index of a grid's line on a side."""
    end = 0 if is_before(side) else -1
    return (end,) if side < 2 else (_ALL, end)


def is_before(side: int) -> bool:
    """Whether a line added on the side comes before the grid's first corner: then colours and counts shift by one."""
    return side % 2 == 0


def grid_spacing(grid: Float[ndarray, "rows columns 2"]) -> Float[ndarray, "rows columns"]:
    """Distance from each corner to the nearest of its four neighbours, and of the diagonal ones; NaN without any."""
    nearest = np.full(grid.shape[:2], np.inf)
    x, y = grid[..., 0], grid[..., 1]
    for here, there in _NEIGHBOURS:
        distance = np.hypot(x[there] - x[here], y[there] - y[here])
        for end in (here, there):
            np.fmin(nearest[end], distance, out=nearest[end])
    nearest[np.isinf(nearest)] = np.nan
    return nearest


def grid_reach(grid: Float[ndarray, "rows columns 2"]) -> Float[ndarray, "rows columns"]:
    """Distance from each corner to the nearest grid line that does not pass through it; NaN without neighbours."""
    right, down = np.full(grid.shape, np.nan), np.full(grid.shape, np.nan)
    right[:, :-1], down[:-1] = np.diff(grid, axis=1), np.diff(grid, axis=0)
    left, up = np.full(grid.shape, np.nan), np.full(grid.shape, np.nan)
    left[:, 1:], up[1:] = right[:, :-1], down[:-1]
    ways = np.stack([right, left, down, up], axis=-1)  # (rows, columns, 2, 4)
    x, y = ways[..., 0, :], ways[..., 1, :]
    length = np.maximum(np.hypot(x, y), 1e-9)
    cross = np.abs(x[..., :2, None] * y[..., None, 2:] - y[..., :2, None] * x[..., None, 2:])
    lines = np.concatenate([cross / length[..., None, 2:], cross / length[..., :2, None]], axis=-1)
    nearest = np.fmin.reduce(lines.reshape(*grid.shape[:2], -1), axis=-1)
    return np.where(nearest > 0, nearest, np.nan)
