"""A marked board whose marks are covered, named by its extent."""

from __future__ import annotations

import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.detection.finding.marked_squares import SquareReadings
from binocal.detection.finding.whole_extent import place_whole

BOARD = parse_board("chessboard:14x9:20mm:marked")  # discs in the squares (7, 4), (7, 5), (8, 5)


def seen(discs, *, unread=()):
    """A whole lattice, and readings of its squares: (0, 0) is the board's square (1, 1)."""
    grid = np.stack(np.meshgrid(40.0 * np.arange(14), 40.0 * np.arange(9)), axis=-1)
    disc = np.zeros((8, 13))
    for column, row in discs:
        disc[row - 1, column - 1] = 1.0
    for column, row in unread:
        disc[row - 1, column - 1] = np.nan
    return grid, SquareReadings(disc, np.zeros((8, 13)), np.zeros((8, 13), bool))


def test_covered_marks_leave_the_two_ways_of_the_extent_and_a_disc_one():
    ways = place_whole(BOARD, *seen([], unread=[(x, y) for x in (6, 7, 8) for y in (4, 5)]))
    assert sorted(way.shift.tolist() for way in ways) == [[0, 0], [13, 8]]
    (way,) = place_whole(BOARD, *seen([(7, 4), (8, 5)], unread=[(6, 4), (6, 5)]))  # one is hidden without a trace
    assert way.shift.tolist() == [0, 0]


@pytest.mark.parametrize("discs", [[], [(3, 3), (9, 7), (11, 2), (12, 6)], [(7, 4), (7, 5), (6, 5)]])
def test_squares_that_say_otherwise_are_believed(discs):
    assert not place_whole(BOARD, *seen(discs))


def test_a_row_of_two_corners_is_none_of_the_boards():
    grid, readings = seen([], unread=[(x, y) for x in (6, 7, 8) for y in (4, 5)])
    grid[0, 2:] = np.nan
    assert not place_whole(BOARD, grid, readings)
    assert not place_whole(
        BOARD, grid[1:], SquareReadings(*(a[1:] for a in (readings.disc, readings.swapped, readings.may_be_swapped)))
    )
