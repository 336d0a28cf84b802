"""Dots read on the edges of a lattice, and the place on the board that they tell."""

import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.boards.puzzle_code import bits_below, bits_beside
from binocal.detection.finding.edge_bits import EdgeReadings, agreement_at, chance_of, locate, read_edges
from binocal.kernels.marker_grids import FieldLens
from binocal.printing.board_shapes import board_shapes
from binocal.printing.drawing import Group, Page
from binocal.printing.raster import raster_bands

BOARD = parse_board("puzzleboard:14x9:1mm:start=50,101")
SIDE = 20  # pixels of a square


def readings_of(columns, rows, first, *, wrong=0.0, rng=None):
    """What a part of the pattern from a corner on shows, some of it wrong; its cells from (0, 0)."""
    x, y = (grid.ravel() for grid in np.meshgrid(np.arange(columns), np.arange(rows)))
    ends, bits = [], []
    for step, read, inside in (((1, 0), bits_beside, x < columns - 1), ((0, 1), bits_below, y < rows - 1)):
        corner = np.stack([x[inside], y[inside]], axis=-1)
        ends.append(np.stack([corner, corner + step], axis=1))
        bits.append(read(*(corner + first).T))
    white = 2.0 * np.concatenate(bits) - 1
    if wrong:
        white[rng.choice(len(white), round(wrong * len(white)), replace=False)] *= -1
    return np.stack([x, y], axis=-1), EdgeReadings(np.concatenate(ends), white), bool(sum(first) % 2)


def test_any_part_of_five_corners_a_side_has_one_place():
    for column in range(50, 60):
        for row in range(101, 106):
            cells, readings, is_bright_first = readings_of(5, 5, (column, row))
            place = locate(BOARD, cells, readings, is_bright_first=is_bright_first).place
            assert place is not None and not place.is_inverted and place.shift.tolist() == [column, row]


@pytest.mark.parametrize("seed", range(3))
def test_wrong_bits_are_outvoted_and_never_name_a_wrong_place(seed):
    rng = np.random.default_rng(seed)
    first = np.array([rng.integers(50, 57), rng.integers(101, 103)])
    cells, readings, is_bright_first = readings_of(8, 8, first, wrong=0.08, rng=rng)
    place = locate(BOARD, cells, readings, is_bright_first=is_bright_first).place
    assert (
        place is not None
        and place.shift.tolist() == first.tolist()
        and place.agreement == pytest.approx(0.84, abs=0.02)
    )
    for _ in range(3):  # nor do bits of chance
        white = rng.choice([-1.0, 1.0], len(readings.white))
        chance = locate(BOARD, cells, EdgeReadings(readings.ends, white), is_bright_first=is_bright_first)
        assert chance.place is None and chance.reason


def test_too_small_a_part_and_one_of_another_board_have_no_place():
    cells, readings, is_bright_first = readings_of(3, 3, (52, 103))
    assert "too little of it" in locate(BOARD, cells, readings, is_bright_first=is_bright_first).reason
    cells, readings, is_bright_first = readings_of(7, 7, (300, 222))
    told = locate(BOARD, cells, readings, is_bright_first=is_bright_first).reason
    assert "columns 300 to 306 and rows 222 to 228" in told
    cells, readings, is_bright_first = readings_of(30, 7, (300, 222))
    assert "reaches beyond the SPEC's 14x9" in locate(BOARD, cells, readings, is_bright_first=is_bright_first).reason


def test_dots_are_read_whichever_way_the_lattice_is_turned():
    page = Page(14.0, 9.0, (Group("board", board_shapes(BOARD)),))
    image = np.concatenate(list(raster_bands(page, float(SIDE))))
    grid = np.stack(np.meshgrid(np.arange(14), np.arange(9)), axis=-1) * SIDE + 0.5 * SIDE - 0.5
    for n_turns in range(4):
        part = np.rot90(grid[1:7, 3:9], n_turns)
        cells = np.stack(np.meshgrid(np.arange(6), np.arange(6)), axis=-1)
        # Turned about the middle of an even number of squares and more the first square beyond the corner has one colour.
        corner = np.mean([part[0, 0], part[1, 1]], axis=0)
        is_bright_first = bool(image[round(corner[1]), round(corner[0])] > 128)
        readings = read_edges(image, part, FieldLens(), is_bright_first=is_bright_first)
        assert len(readings.white) == 60 and np.abs(readings.white).min() > 0.9
        place = locate(BOARD, cells.reshape(-1, 2), readings, is_bright_first=is_bright_first).place
        assert place is not None and place.agreement > 0.99
        named = place.corners(cells) - BOARD.start
        assert np.array_equal(grid[named[..., 1], named[..., 0]], part)


def test_where_readings_contradict_the_code_the_corners_there_are_told():
    _, readings, _ = readings_of(14, 9, BOARD.start)
    white = readings.white.copy()
    white[readings.ends[:, 0, 0] >= 9] *= -1.0
    grid = np.zeros((9, 14, 2))
    agreement = agreement_at(grid, BOARD, EdgeReadings(readings.ends, white), 1)
    assert (agreement[:, :7] == 1).all() and (agreement[:, 11:] == -1).all()


def test_chance_is_the_binomial_distribution():
    assert chance_of(10, 0.2) == pytest.approx(2**-10) and chance_of(10, 1.0) == pytest.approx(11 * 2**-10)
    assert chance_of(4, 9.0) == 1.0
