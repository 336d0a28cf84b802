"""A lattice of corners named by where the board's corners must lie."""

from __future__ import annotations

import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.detection.finding.expected_places import place_near

BOARD = parse_board("chessboard:9x6:30mm:marked")


def seen_from(turn_rad, *, columns=slice(4, 9), rows=slice(1, 6)):
    """Where all corners are, and a part of them as a lattice whose first corner is none of the board's first."""
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    px = 40 * BOARD.object_points_m[:, :2] / 0.03 @ np.array([[c, s], [-s, c]]) + 300
    part = px.reshape(6, 9, 2)[rows, columns]
    return px, part[::-1, ::-1].copy()  # as a lattice that begins at the far corner


@pytest.mark.parametrize("turn_rad", [0.0, 1.3, 3.0])
def test_a_part_is_named_by_the_only_way_in_which_it_lies_there(turn_rad):
    px, grid = seen_from(turn_rad)
    grid[2, 3] = np.nan
    (placement,) = place_near(BOARD, grid, px + [7.0, -5.0])  # a fifth of a square off
    named = placement.corners(np.array([[0, 0], [4, 4]]))
    assert named.tolist() == [[8, 5], [4, 1]] and placement.n_outside == 0


def test_what_lies_between_two_places_has_no_names():
    px, grid = seen_from(0.4)
    assert not place_near(BOARD, grid, px + [14.0, 3.0])
    assert not place_near(BOARD, grid, np.full_like(px, np.nan))
    assert not place_near(BOARD, grid[:1], px)  # one row of five
