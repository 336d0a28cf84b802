"""The code of PuzzleBoards, bit by bit as its authors publish it, and boards of it as text."""

import numpy as np
import pytest
from jaxtyping import TypeCheckError

from binocal.boards import BoardSet, format_board, load_board, parse_board
from binocal.boards.puzzle_code import BELOW, BESIDE, SIDE, bits_below, bits_beside
from binocal.boards.target_file import format_kalibr_target
from binocal.printing.board_shapes import board_shapes
from binocal.printing.drawing import Group, Page
from binocal.printing.raster import raster_bands

# As the fields of the authors' board generator hold them ("vertical" first); their decoder has the same numbers.
CODE = (
    "000010111000011101010101001000110101101100001110111000101001000100011111100000101011"
    "11110100110010010101110101110000111111011011010110011011111011100111101001111010001",
    "011000011111101111111101000100100000111100010011000001000100011000011000000111000110"
    "10100011101110101101110110010010000110100110001110101000111000100110001111010100100",
    "010000010100001110100001111010111110100000100100100001011101001101100111010110101100"
    "10110010010010110011001011110111001110000000101011011111010110110011000011110100011",
)
CODE2 = (
    "111110101001111110000101001101111001000001001100100111111000110100011101101001000010"
    "00111001111010000000100111000000010111110010110101111101110100101101011001001110010",
    "101100110001001101011001110110000110101000100101010110000010110000001110000010110110"
    "00011111010101101101100011001111001001001010111011011001110011001011100011100011001",
    "001100000101010001111010100101100001100100100000001100001111010001111011001010101001"
    "00101001011111101000000010110101101011111110001000111101011101100101000011011111111",
)


def test_the_tables_are_the_published_ones_and_no_two_windows_are_alike():
    for table, text in ((BELOW, CODE), (BESIDE, CODE2)):
        assert np.array_equal(table, [[int(bit) for bit in row] for row in text])
        around = np.pad(table, ((0, 2), (0, 2)), mode="wrap")
        windows = np.lib.stride_tricks.sliding_window_view(around, (3, 3)).reshape(-1, 9)
        assert len(np.unique(windows, axis=0)) == len(windows) == SIDE


def test_the_print_is_the_generators():
    """Squares and dots at the places, and of the colours, that the authors' generator gives them, for one of their example boards."""
    columns, rows, start_x, start_y, side = 23, 16, 50, 100, 12
    board = parse_board(f"puzzleboard:{columns}x{rows}:1mm:start={start_x},{start_y}")
    page = Page(float(columns), float(rows), (Group("board", board_shapes(board)),))
    image = np.concatenate(list(raster_bands(page, float(side))))
    assert image.shape == (rows * side, columns * side)

    def grey(x, y):  # of the place so many squares from the top left, the mean of the four pixels that meet there
        column, row = round(x * side), round(y * side)
        return image[row - 1 : row + 1, column - 1 : column + 1].mean()

    for y in range(rows):
        for x in range(columns):
            is_black = (x + y + start_x + start_y) % 2 == 0
            assert grey(x + 0.25, y + 0.25) == (0 if is_black else 255)  # within the square at the corner's upper left
            if x < columns - 1:
                assert grey(x + 1.0, y + 0.5) == 255 * int(CODE2[(start_x + x) % 3][(start_y + y) % 167])
            if y < rows - 1:
                assert grey(x + 0.5, y + 1.0) == 255 * int(CODE[(start_y + y) % 3][(start_x + x) % 167])
    x, y = np.arange(40), np.arange(60, 100)
    assert np.array_equal(bits_beside(x + SIDE, y), bits_beside(x, y))
    assert np.array_equal(bits_below(x, y + SIDE), bits_below(x, y))


def test_a_board_is_a_part_of_the_pattern_and_says_which():
    board = parse_board("puzzleboard:23x16:30mm:start=50,100")
    assert (board.start, board.n_points, board.allows_partial) == ((50, 100), 368, True)
    assert np.allclose(board.object_points_m[[1, 23]], [[0.03, 0, 0], [0, 0.03, 0]])
    for spec in ("puzzleboard:23x16:30mm:start=50,100", "puzzleboard:11x8:25mm", "puzzleboard:11x8:start=3,0"):
        assert format_board(parse_board(spec)) == spec and load_board(spec) == parse_board(spec)
    with pytest.raises(ValueError, match="knows no PuzzleBoards"):
        format_kalibr_target(board)


@pytest.mark.parametrize(
    ("spec", "told"),
    [
        ("puzzleboard:11x8:30mm:start=495,0", "reaches beyond the pattern's 501x501"),
        ("puzzleboard:3x8:30mm", "too small for a PuzzleBoard"),
        ("puzzleboard:11x8:30mm:50,100", "too many fields"),
        ("puzzleboard:11x8:30mm:start=50", "no corner of the pattern, such as start=50,100"),
        ("chessboard:11x8:30mm:start=5,1", "neither a length"),
    ],
)
def test_what_is_no_part_of_the_pattern_is_refused(spec, told):
    with pytest.raises((ValueError, TypeCheckError), match=told):
        parse_board(spec)


def test_parts_without_common_corners_are_told_apart():
    BoardSet.from_specs(["puzzleboard:11x8:30mm", "puzzleboard:11x8:20mm:start=11,0", "chessboard:11x8:30mm"])
    with pytest.raises(ValueError, match="print one with another start"):
        BoardSet.from_specs(["puzzleboard:11x8:30mm", "puzzleboard:5x5:30mm:start=10,7"])
