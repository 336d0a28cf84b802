import cv2
import numpy as np
import pytest

from binocal.boards import Board, parse_board
from binocal.simulation.coverage import CellSheet, DottedSheet, Footprint, MarkedSheet
from binocal.simulation.layout import cell_print, disc_print, printed_extent_m


def _centres(edges):
    return (edges[1:] + edges[:-1]) / 2


def test_chessboard_has_one_more_square_than_corners_and_a_black_top_left():
    board = parse_board("chessboard:9x6:30mm")
    cells = cell_print(board)
    assert cells.ink.shape == (7, 10)
    assert cells.ink[0, 0] == 1
    assert (cells.ink[:, 1:] != cells.ink[:, :-1]).all()
    assert (cells.ink[1:] != cells.ink[:-1]).all()
    assert printed_extent_m(board) == pytest.approx((-0.03, -0.03, 0.27, 0.18))
    # the first inner corner is where the first four squares meet
    assert (cells.x_edges[1], cells.y_edges[1]) == (0, 0)


@pytest.mark.parametrize("is_legacy", [False, True])
@pytest.mark.parametrize("size", [(5, 7), (7, 5), (8, 6), (6, 8), (11, 8), (5, 4)])
@pytest.mark.parametrize(("dictionary", "marker"), [("DICT_4X4_250", 0.7), ("DICT_6X6_250", 0.8)])
def test_charuco_is_opencvs_board(size, is_legacy, dictionary, marker):
    scale = 240
    tags = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    theirs = cv2.aruco.CharucoBoard(size, 1.0, marker, tags)
    theirs.setLegacyPattern(is_legacy)
    image = theirs.generateImage((size[0] * scale, size[1] * scale), marginSize=0, borderBits=1)
    cells = cell_print(Board("charuco", *size, 1.0, False, marker, dictionary), is_legacy_charuco=is_legacy)
    rows, columns = (np.floor(_centres(e) * scale).astype(int) for e in (cells.y_edges, cells.x_edges))
    assert np.array_equal(image[np.ix_(rows, columns)] == 0, cells.ink == 1)


def test_charuco_needs_enough_markers_and_a_known_dictionary():
    with pytest.raises(ValueError, match="has 50 markers"):
        cell_print(parse_board("charuco:12x12:30mm:22mm:DICT_5X5_50"))
    with pytest.raises(ValueError, match="DICT_9X9_50"):
        cell_print(parse_board("charuco:5x5:30mm:22mm:DICT_9X9_50"))


@pytest.mark.parametrize("border_bits", [1, 2])
def test_aprilgrid_is_kalibrs_sheet(border_bits):
    board = parse_board("aprilgrid:3x2:88mm:0.25")
    cells = cell_print(board, april_border_bits=border_bits)
    n = 6 + 2 * border_bits
    assert cells.ink.shape == (2 * (n + 1) + 1, 3 * (n + 1) + 1)
    assert printed_extent_m(board) == pytest.approx((-0.022, -0.022, 3 * 0.11, 2 * 0.11))
    assert cells.x_edges[[0, 1, n + 1, -2, -1]] == pytest.approx([-0.25, 0, 1, 3.5, 3.75])
    # code words of ids 0 to 2, bits row by row from the top left, 1 white: the bottom row of tags, left to right
    for column, code in enumerate((0xD5D628584, 0xD97F18B49, 0xDD280910E)):
        top, left = (n + 1) + 1, column * (n + 1) + 1
        tag = cells.ink[top : top + n, left : left + n]
        data = tag[border_bits:-border_bits, border_bits:-border_bits]
        bits = "".join(str(1 - cell) for cell in data.ravel())
        assert int(bits, 2) == code
        assert tag.sum() - data.sum() == n * n - 36  # the border is all black
    squares = cells.ink[:: n + 1, :: n + 1]
    assert squares.shape == (3, 4)
    assert squares.all()
    gaps = cells.ink[0].copy()
    gaps[:: n + 1] = 0
    assert not gaps.any()


def test_discs_lie_on_the_boards_points():
    for spec in ("circles:10x8:20mm", "acircles:4x11:10mm"):
        board = parse_board(spec)
        discs = disc_print(board)
        row, column = np.divmod(np.arange(board.n_points), board.columns)
        centres = np.stack([discs.step_x * column + discs.stagger * (row % 2), row], axis=-1) * board.pitch_m
        assert centres == pytest.approx(board.object_points_m[:, :2])
        nearest = np.linalg.norm(board.object_points_m[1:] - board.object_points_m[0], axis=1).min()
        assert 2 * discs.radius * board.pitch_m == pytest.approx(0.5 * nearest)
        x0, y0, x1, y1 = printed_extent_m(board)
        radius = discs.radius * board.pitch_m
        assert (x0, y0) == pytest.approx((-radius, -radius))
        assert (x1, y1) == pytest.approx(board.object_points_m[:, :2].max(axis=0) + radius)


def test_touching_discs_are_refused():
    with pytest.raises(ValueError, match="circle_diameter_ratio"):
        disc_print(Board("acircles", 4, 11, circle_diameter_ratio=0.8))


def test_marked_circles_are_larger_or_hollow():
    discs = disc_print(parse_board("circles:7x6:30mm:large"))
    assert np.argwhere(discs.outer > 0.3).tolist() == [[1, 2], [1, 4], [4, 2]] and np.allclose(discs.outer.max(), 0.35)
    discs = disc_print(parse_board("circles:7x6:30mm:hollow"))
    assert np.argwhere(discs.hole > 0).tolist() == [[1, 2], [1, 4], [4, 2]] and np.allclose(discs.outer, 0.25)
    assert (disc_print(parse_board("acircles:4x9:30mm:rings")).hole > 0).all()


def test_dots_looked_up_are_drawn_as_discs_one_by_one_are():
    board = parse_board("puzzleboard:5x4:20mm:start=3,8")
    cells, rng = cell_print(board), np.random.default_rng(0)
    assert printed_extent_m(board) == pytest.approx((-0.01, -0.01, 0.09, 0.07)) and len(cells.discs) == 4 * 4 + 5 * 3
    x, y = rng.uniform(-2, 6, (2, 100, 100))
    at = Footprint(x, y, *(np.full(x.shape, v) for v in (0.03, 0.005, -0.004, 0.028)))
    sheet = CellSheet(cells, 1.0)
    looked_up, one_by_one = DottedSheet(sheet, cells.discs), MarkedSheet(sheet, cells.discs)
    for theirs, ours in zip(one_by_one.spread(at, 0.14), looked_up.spread(at, 0.14), strict=True):
        assert np.abs(theirs - ours).max() < 1e-5
    reach = np.full(x.shape, 0.02)
    for theirs, ours in zip(
        one_by_one.classify(at, reach, reach)[:2], looked_up.classify(at, reach, reach)[:2], strict=True
    ):
        assert np.array_equal(theirs, ours)
    is_constant = looked_up.classify(at, reach, reach)[2]
    assert (is_constant >= one_by_one.classify(at, reach, reach)[2]).all()
    assert np.abs(looked_up.spread(at, 0.14)[0] - looked_up.classify(at, reach, reach)[0])[is_constant].max() < 1e-3
