"""Marked squares read between corners, and the board laid over them."""

import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.detection.finding.marked_squares import fits_board, place_board, read_squares
from binocal.printing.board_shapes import board_shapes
from binocal.printing.drawing import Group, Page
from binocal.printing.raster import raster_bands

SIDE = 20  # pixels of a square


def draw(spec):
    """A board from above with a margin of a square, and its grid of corners."""
    board = parse_board(spec)
    page = Page(board.columns + 3.0, board.rows + 3.0, (Group("board", board_shapes(board), (1.0, 1.0)),))
    image = np.concatenate(list(raster_bands(page, float(SIDE))))
    grid = np.stack(np.meshgrid(np.arange(board.columns), np.arange(board.rows)), axis=-1) * SIDE + 2.0 * SIDE - 0.5
    return board, image, np.where(board.is_printed.reshape(grid.shape[:2])[..., None], grid, np.nan)


def test_discs_and_squares_of_the_other_colour_are_read():
    _, image, grid = draw("chessboard:9x6:1mm:discs=4,2,5,2:swapped=1,1,7,4")
    readings = read_squares(image, grid)
    assert np.argwhere(readings.is_disc()).tolist() == [[1, 3], [1, 4]]
    assert np.argwhere(readings.is_swapped()).tolist() == [[0, 0], [3, 6]]
    assert np.nanmin(readings.disc[1, 3:5]) > 0.95 and np.nanmax(np.abs(readings.disc[4])) < 0.05


@pytest.mark.parametrize("n_turns", range(4))
def test_a_part_is_named_however_it_is_turned(n_turns):
    board, image, grid = draw("chessboard:9x6:1mm:marked")
    part = np.rot90(grid[1:5, 3:8], n_turns)
    (placement,) = place_board(board, part, read_squares(image, part))
    assert fits_board(placement, 20)
    row, column = np.mgrid[: part.shape[0], : part.shape[1]]
    names = placement.corners(np.stack([column, row], axis=-1))
    assert np.array_equal(grid[names[..., 1], names[..., 0]], part)


def test_two_discs_of_three_leave_two_ways_that_the_rest_of_the_board_decides():
    board, image, grid = draw("chessboard:9x6:1mm:marked")  # in squares 5,2, 5,3 and 6,3
    part = grid[1:5, 3:6].copy()  # the third is out of view
    assert len(place_board(board, part, read_squares(image, part))) == 2
    part = grid[:, :6].copy()  # turned, six rows would be too many from there on
    (placement,) = place_board(board, part, read_squares(image, part))
    assert placement.corners(np.array([[0, 0]])).tolist() == [[0, 0]]


def test_one_square_names_a_part_once_enough_is_seen_about_it():
    board, image, grid = draw("chessboard:9x6:1mm:swapped=1,1")
    near = grid[:3, :3].copy()
    near[2, 2] = grid[2, 2]
    wide = grid[:5, :5].copy()
    assert len(place_board(board, wide, read_squares(image, wide))) == 1
    middle, image, grid = draw("chessboard:9x7:1mm:swapped=4,3")
    part = grid[1:6, 1:7].copy()
    assert len(place_board(middle, part, read_squares(image, part))) == 4


def test_a_larger_board_does_not_fit():
    _, image, grid = draw("chessboard:9x6:1mm:discs=4,2,5,2,5,3")
    small = parse_board("chessboard:6x6:1mm:discs=4,2,5,2,5,3")
    (placement,) = place_board(small, grid, read_squares(image, grid))
    assert placement.n_outside == 18 and not fits_board(placement, 54)
    assert place_board(parse_board("chessboard:9x6:1mm:discs=4,2,5,2,6,2"), grid, read_squares(image, grid)) == []


def test_nothing_is_read_where_no_square_is_whole():
    board, image, grid = draw("chessboard:9x6:1mm:marked")
    line = np.where(np.arange(9)[None, :, None] == 4, grid, np.nan)
    assert place_board(board, line, read_squares(image, line)) == []
