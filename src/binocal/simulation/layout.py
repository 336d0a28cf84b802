"""What is printed on each kind of board, as cells and discs in the board frame, in pitches.

One square of white paper surrounds the outer squares of a chessboard; the other kinds have margins that a detector
needs. Conventions, each held against OpenCV or Kalibr by a test:

- chessboard: the outer square at the board's top left is black; marks are OpenCV's discs, or squares of the other colour.
- ChArUco: OpenCV's ``CharucoBoard``; its top-left square is black, in the legacy layout with an even number of rows
  white.
- AprilGrid: Kalibr's sheet: tags with ``border_bits`` (Kalibr: 2) cells of black around 6 x 6 data cells, all
  within ``pitch_m``; black squares as wide as the gap at the tags' corners; ids grow to the right and upward from
  the bottom-left tag; tags upright as in the AprilTag project's own images. OpenCV's ``DICT_APRILTAG_36h11``
  holds them turned by 180° in 4.x and 5.0.
- puzzleboard: its authors' generator: the outer squares are cut in half, and a dot lies on every edge between two corners.
- circles, acircles: discs of ``circle_diameter_ratio`` times the distance of neighbours; three of them 1.4 times as large
  or rings, or all of them rings, whose holes have half their diameter.
- squares: black squares, the gaps between them white, as BoofCV prints them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.boards.board import HOLE, LARGE
from binocal.boards.marks import DISC_RADIUS
from binocal.boards.puzzle_code import DOT_RADIUS, bits_below, bits_beside
from binocal.shapes import Float, Int

_TAG36H11_ID0 = (
    0xD5D628584  # the family's first code word; read row by row, lowest bit first, it is the tag turned by 180°
)


@dataclass(frozen=True, slots=True, eq=False)
class CellPrint:
    """A rectilinear grid of cells: ``ink`` is 1 where black is printed. Edges are in pitches, ascending."""

    x_edges: Float[ndarray, "columns_and_one"]
    y_edges: Float[ndarray, "rows_and_one"]
    ink: Int[ndarray, "rows columns"]
    discs: Float[ndarray, "k 4"] = field(default_factory=lambda: np.zeros((0, 4)))
    """Laid over the cells: centre x, y and radius in pitches, and 1 where black is printed."""


@dataclass(frozen=True, slots=True, eq=False)
class DiscPrint:
    """Black discs at (``step_x`` column + ``stagger`` (row mod 2), row), in pitches.

    ``outer`` and ``hole`` are each disc's own radius and that of the white disc inside it, 0 where it is whole.
    """

    columns: int
    rows: int
    step_x: float
    stagger: float
    radius: float
    outer: Float[ndarray, "rows columns"]
    hole: Float[ndarray, "rows columns"]


def printed_extent_m(board: Board) -> tuple[float, float, float, float]:
    """x0, y0, x1, y1 of the rectangle around all print, in the board frame, metres (pitches if not metric)."""
    if board.kind == "chessboard":
        box = (-1.0, -1.0, board.columns, board.rows)
    elif board.kind == "puzzleboard":
        box = (-0.5, -0.5, board.columns - 0.5, board.rows - 0.5)
    elif board.kind == "charuco":
        box = (0.0, 0.0, board.columns, board.rows)
    elif board.kind == "aprilgrid":
        gap = board.tag_gap_ratio
        box = (-gap, -gap, board.columns * (1 + gap), board.rows * (1 + gap))
    elif board.kind == "squares":
        box = (0.0, 0.0, *(board.object_points_m[-1, :2] / board.pitch_m))
    else:
        discs = disc_print(board)
        right = (board.columns - 1) * discs.step_x + (discs.stagger if board.rows > 1 else 0)
        largest = discs.outer
        box = (
            -largest[:, 0].max(),
            -largest[0].max(),
            right + largest[:, -1].max(),
            board.rows - 1 + largest[-1].max(),
        )
    return tuple(float(b) * board.pitch_m for b in box)  # type: ignore[return-value]


def sheet_margin(board: Board) -> float:
    """Width of the white rim around the printed extent, in pitches."""
    return 0.5 if board.kind == "aprilgrid" else 1.0


def disc_print(board: Board) -> DiscPrint:
    """Discs of a circle grid.

    Raises:
        ValueError: Neighbouring discs would touch.
    """
    is_staggered = board.kind == "acircles"
    spacing = np.sqrt(2) if is_staggered else 1.0
    radius = 0.5 * board.circle_diameter_ratio * spacing
    if not 0 < radius < 0.5:  # acircles: half a pitch is also what the nearest-row look-up needs
        raise ValueError(f"circle_diameter_ratio {board.circle_diameter_ratio} must be in (0, {1 / spacing:.2f})")
    outer = np.full((board.rows, board.columns), radius)
    hole = np.full(outer.shape, HOLE * radius if board.circle_style == "rings" else 0.0)
    marked = np.unravel_index(np.array(board.marked_points, int), outer.shape)
    if board.circle_style == "large":
        outer[marked] *= LARGE
    elif board.circle_style == "hollow":
        hole[marked] = HOLE * radius
    if outer.max() >= 0.5:
        raise ValueError(
            f"circle_diameter_ratio {board.circle_diameter_ratio} leaves no room for circles {LARGE} times as large"
        )
    step, stagger = (2.0, 1.0) if is_staggered else (1.0, 0.0)
    return DiscPrint(board.columns, board.rows, step, stagger, radius, outer, hole)


def cell_print(board: Board, *, is_legacy_charuco: bool = False, april_border_bits: int = 2) -> CellPrint:
    """Cells of a chessboard, a ChArUco board, an AprilGrid, a square grid or a PuzzleBoard.

    Raises:
        ValueError: The dictionary is unknown or has too few markers.
    """
    if board.kind == "chessboard":
        return _chessboard_print(board)
    if board.kind == "charuco":
        return _charuco_print(board, is_legacy_charuco)
    if board.kind == "aprilgrid":
        return _aprilgrid_print(board, april_border_bits)
    if board.kind == "squares":
        return _squares_print(board)
    if board.kind == "puzzleboard":
        return _puzzle_print(board)
    raise ValueError(f"{board.kind} is not made of cells")


def _chessboard_print(board: Board) -> CellPrint:
    row, column = np.mgrid[: board.rows + 1, : board.columns + 1]
    ink = 1 - (row + column) % 2
    for column_swapped, row_swapped in board.swapped:
        ink[row_swapped, column_swapped] ^= 1
    discs = [(x - 0.5, y - 0.5, DISC_RADIUS, 1.0 - ink[y, x]) for x, y in board.discs]
    edges = np.arange(-1.0, board.columns + 1), np.arange(-1.0, board.rows + 1)
    return CellPrint(*edges, ink, np.array(discs).reshape(-1, 4))


def _squares_print(board: Board) -> CellPrint:
    row, column = np.mgrid[: 2 * board.rows - 1, : 2 * board.columns - 1]
    x, y = board.object_points_m.reshape(2 * board.rows, 2 * board.columns, 3)[..., :2].T / board.pitch_m
    return CellPrint(x[:, 0], y[0], ((row % 2 == 0) & (column % 2 == 0)).astype(int))


def _puzzle_print(board: Board) -> CellPrint:
    (column, row), columns, rows = board.start, board.columns, board.rows
    y, x = np.mgrid[: rows + 1, : columns + 1]
    ink = 1 - (x + y + column + row) % 2
    x_edges, y_edges = (np.r_[-0.5, np.arange(n), n - 0.5] for n in (columns, rows))
    beside, below = (grid.reshape(2, -1) for grid in (np.mgrid[: columns - 1, :rows], np.mgrid[:columns, : rows - 1]))
    bits = np.r_[bits_beside(*(beside.T + board.start).T), bits_below(*(below.T + board.start).T)]
    centres = np.concatenate([beside.T + [0.5, 0.0], below.T + [0.0, 0.5]])
    discs = np.column_stack([centres, np.full(len(bits), DOT_RADIUS), 1.0 - bits])
    return CellPrint(x_edges, y_edges, ink, discs)


def _charuco_print(board: Board, is_legacy: bool) -> CellPrint:
    dictionary = _aruco_dictionary(board.dictionary)
    n_cells = dictionary.markerSize + 2
    side = board.marker_m / board.pitch_m
    inside = np.r_[0.0, (1 - side) / 2 + side * np.arange(n_cells + 1) / n_cells]
    n_block = n_cells + 2
    first_is_white = is_legacy and board.rows % 2 == 0
    ink = np.zeros((board.rows, n_block, board.columns, n_block), dtype=int)
    marker_id = board.first_tag_id
    for row in range(board.rows):
        for column in range(board.columns):
            if (row + column) % 2 == int(first_is_white):
                ink[row, :, column, :] = 1
            else:
                ink[row, 1:-1, column, 1:-1] = _marker_ink(dictionary, marker_id, board.dictionary)
                marker_id += 1
    edges = [np.r_[(np.arange(n)[:, None] + inside).ravel(), n] for n in (board.columns, board.rows)]
    return CellPrint(edges[0], edges[1], ink.reshape(board.rows * n_block, board.columns * n_block))


def _aprilgrid_print(board: Board, border_bits: int) -> CellPrint:
    dictionary = _aruco_dictionary("DICT_APRILTAG_36h11")
    code = np.array([[(_TAG36H11_ID0 >> (6 * i + j)) & 1 for j in range(6)] for i in range(6)])
    first = 1 - _marker_ink(dictionary, 0, "DICT_APRILTAG_36h11")[1:-1, 1:-1]
    family = board.marker_dictionary
    # OpenCV holds the family upside down, but later versions may turn it
    turns = 2 if np.array_equal(first, code) else 0
    assert turns or np.array_equal(first, np.rot90(code, 2)), "OpenCV's tag36h11 is neither upright nor upside down"
    dictionary = _aruco_dictionary(family)
    n_cells, gap = dictionary.markerSize + 2 * border_bits, board.tag_gap_ratio
    block = n_cells + 1  # a gap, then the tag's cells
    ink = np.zeros((board.rows * block + 1, board.columns * block + 1), dtype=int)
    ink[::block, ::block] = 1
    for index, tag_id in enumerate(board.tag_ids):
        row, column = divmod(index, board.columns)
        tag = np.ones((n_cells, n_cells), dtype=int)
        data = _marker_ink(dictionary, int(tag_id), family)[1:-1, 1:-1]
        tag[border_bits:-border_bits, border_bits:-border_bits] = np.rot90(data, turns)
        ink[row * block + 1 : (row + 1) * block, column * block + 1 : (column + 1) * block] = tag
    inside = np.r_[-gap, np.arange(n_cells) / n_cells]
    edges = [
        np.r_[(np.arange(n)[:, None] * (1 + gap) + inside).ravel(), n * (1 + gap) - gap, n * (1 + gap)]
        for n in (board.columns, board.rows)
    ]
    return CellPrint(edges[0], edges[1], ink)


def _aruco_dictionary(name: str):
    import cv2

    if not hasattr(cv2.aruco, name):
        raise ValueError(f"{name!r} is not an ArUco dictionary of this OpenCV")
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def _marker_ink(dictionary, marker_id: int, name: str) -> Int[ndarray, "cells cells"]:
    """Cells of a marker with a black border of one cell; 1 is black."""
    import cv2

    if marker_id >= len(dictionary.bytesList):
        raise ValueError(f"{name} has {len(dictionary.bytesList)} markers; the board needs at least {marker_id + 1}")
    n_cells = dictionary.markerSize + 2
    return (cv2.aruco.generateImageMarker(dictionary, marker_id, n_cells, borderBits=1) == 0).astype(int)
