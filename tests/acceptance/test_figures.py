"""Figures that the checks look at."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from binocal.acceptance import corner_spacing_px
from binocal.boards import Board
from binocal.evidence import Detections


def seen(board: Board, spacing_px: float) -> Detections:
    """Two views of a board that faces both cameras."""
    px = np.broadcast_to(board.object_points_m[:, :2] / board.pitch_m * spacing_px, (2, board.n_points, 2))
    return Detections.from_arrays(board.object_points_m, px, px, (4000, 4000))


@pytest.mark.parametrize("size", ["11x8", "60x50"])
def test_the_spacing_is_that_of_neighbours(size):
    assert corner_spacing_px(seen(Board.from_spec(f"chessboard:{size}:20mm"), 17.0)) == pytest.approx(17.0)


def test_the_spacing_of_a_large_board_needs_little_memory():
    detections = seen(Board.from_spec("chessboard:200x150:2mm"), 15.0)
    tracemalloc.start()
    spacing_px = corner_spacing_px(detections)
    _, most_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert spacing_px == pytest.approx(15.0) and most_bytes < 100e6  # 41e6; 7.2e9 where all distances are held
