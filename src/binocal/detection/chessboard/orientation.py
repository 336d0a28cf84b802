"""Which way round a lattice is the board."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.detection.finding.lattice import Lattice
from binocal.shapes import Float


def orient(lattice: Lattice, board: Board) -> Float[ndarray, "rows columns 2"]:
    """The lattice's corners as the board's rows and columns, without mirroring."""
    choices = []
    grid, is_dark_first = lattice.points_px, lattice.is_dark_first
    for _ in range(4):
        if grid.shape[:2] == (board.rows, board.columns):
            ways = grid[:, -1] - grid[:, 0]
            if not np.isfinite(ways).any():  # no row shows both of its ends
                ways = np.diff(grid, axis=1).reshape(-1, 2)
            way = ways[np.isfinite(ways[:, 0])].mean(axis=0)
            choices.append((is_dark_first, float(way.sum() / np.linalg.norm(way)), grid))
        # The next first corner is the present row's last; its outward square is of the other colour unless the row is
        # even.
        is_dark_first ^= bool(grid.shape[1] % 2)
        grid = np.rot90(grid)
    return max(choices, key=lambda choice: choice[:2])[2]
