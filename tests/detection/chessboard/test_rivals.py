"""Which lattices are boards: each limit from both sides."""

from __future__ import annotations

import numpy as np
import pytest

from binocal.detection.chessboard.rivals import boards_among
from binocal.detection.finding.lattice import Lattice


def lattice(columns, rows, *, pitch=20.0, at=(0.0, 0.0), n_missing=0, bent_px=0.0):
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1) * pitch + at
    flat = grid.reshape(-1, 2)
    flat[len(flat) - n_missing :] = np.nan
    flat[0] -= bent_px
    return Lattice(grid, True, 100.0)


SIZE_WH = (640, 480)
MAIN = lattice(10, 6)
FAR = (500.0, 0.0)


@pytest.mark.parametrize(
    ("other", "is_board"),
    [
        (lattice(6, 4, at=FAR), True),  # 24 corners: 0.40 of the main one's
        (lattice(23, 1, at=FAR), False),
        (lattice(12, 2, at=FAR), False),
        (lattice(8, 3, at=FAR), True),
        (lattice(6, 4, at=FAR, n_missing=1), False),  # 23: 0.38
        (lattice(8, 5, at=FAR, n_missing=6), True),  # 0.85 of its outline
        (lattice(8, 5, at=FAR, n_missing=7), False),
        (lattice(8, 5, at=FAR, pitch=8.2), True),  # 0.41 of the main one's spacing
        (lattice(8, 5, at=FAR, pitch=7.8), False),
        (lattice(8, 5, at=(10.0, 5.0)), False),  # within the main one's outline
        (lattice(8, 5, at=FAR, bent_px=8.0), False),  # irregular
    ],
)
def test_a_second_board(other, is_board):
    assert (len(boards_among([MAIN, other], size_wh=SIZE_WH)) == 2) is is_board
    assert (len(boards_among([other], MAIN, size_wh=SIZE_WH)) == 2) is is_board


def test_the_main_lattice_is_a_board_whatever_it_is():
    holed = lattice(10, 6, n_missing=30)
    assert boards_among([holed], holed, size_wh=SIZE_WH) == [holed] and boards_among([holed], size_wh=SIZE_WH) == []


def test_a_board_with_a_missing_corner_still_has_an_outline():
    assert len(boards_among([lattice(10, 6, n_missing=1), lattice(8, 5, at=(10.0, 5.0))], size_wh=SIZE_WH)) == 1
