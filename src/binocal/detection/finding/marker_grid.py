"""Boards with markers as lattices: lines at whose crossings X-corners lie, and faces between the lines that bear markers.

A ChArUco board is a chessboard whose bright faces bear them. In an AprilGrid the tags are dark faces, and so are the small
squares at their corners: lines at both sides of every tag make one lattice, whose steps are a tag and a gap in turn.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.boards.marks import DISC_RADIUS
from binocal.detection.finding.arrangements import charuco_squares
from binocal.kernels.marker_grids import Lines
from binocal.shapes import Bool, Float, Int

_CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])


@dataclass(frozen=True, slots=True, eq=False)
class MarkerGrid:
    """A board in one of the ways it may have been printed. Lengths are in the board's pitches."""

    lines: Lines
    sign: float
    """1 where the face beyond the first crossing is bright."""
    free: float
    """How far from a crossing, along both axes, nothing else is printed."""
    faces: Int[ndarray, "m 2"]
    """The face (column, row) of each marker: between this line and the next; beyond the outer lines too."""
    is_dark: bool
    """The faces with markers."""
    turns: int
    """Quarter turns of the markers against the board."""
    points: Int[ndarray, "rows columns"]
    """The board's point at each crossing."""
    side: float
    """Of a face with a marker."""
    has_dots: bool = False
    """On the middle of every edge between two crossings."""

    crossings: Int[ndarray, "m 4 2"] = field(init=False)
    """The crossing (column, row) at each corner of each marker's face, in the marker's own order."""
    corners: Float[ndarray, "m 4 2"] = field(init=False)
    """The corners of each marker's face on the board, in the marker's own order."""
    is_inner: Bool[ndarray, "m"] = field(init=False)
    """Which faces have crossings at all four corners."""

    def __post_init__(self) -> None:
        crossings = self.faces[:, None] + np.roll(_CORNERS, -self.turns, axis=0)
        corners = np.stack([_at(self.lines.x, crossings[..., 0]), _at(self.lines.y, crossings[..., 1])], axis=-1)
        size = len(self.lines.x) - 1, len(self.lines.y) - 1
        is_inner = np.all((self.faces >= 0) & (self.faces < size), axis=1)
        for name, value in (("crossings", crossings), ("corners", corners), ("is_inner", is_inner)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)


@lru_cache(maxsize=16)
def charuco_grid(board: Board, is_legacy: bool) -> MarkerGrid:
    """A ChArUco board; the layouts differ where the number of rows is even."""
    first = 0 if is_legacy and board.rows % 2 == 0 else 1
    columns, rows = board.columns - 1, board.rows - 1
    return MarkerGrid(
        Lines(np.arange(1.0, board.columns), np.arange(1.0, board.rows), 1.0),
        sign=1.0 if first == 0 else -1.0,
        free=0.5 * (1 - board.marker_m / board.pitch_m),
        faces=charuco_squares(board.columns, board.rows, first) - 1,
        is_dark=False,
        turns=0,
        points=np.arange(columns * rows).reshape(rows, columns),
        side=1.0,
    )


def marked_grid(board: Board) -> MarkerGrid:
    """A chessboard some of whose squares are marked."""
    columns, rows = board.columns, board.rows
    return MarkerGrid(
        Lines(np.arange(float(columns)), np.arange(float(rows)), 1.0),
        sign=-1.0,
        free=0.5 - DISC_RADIUS if board.discs else 0.5,
        faces=np.array([*board.discs, *board.swapped], dtype=int).reshape(-1, 2) - 1,
        is_dark=False,
        turns=0,
        points=np.arange(columns * rows).reshape(rows, columns),
        side=1.0,
    )


@lru_cache(maxsize=16)
def puzzle_grid(board: Board) -> MarkerGrid:
    """A PuzzleBoard, whose faces are plain."""
    columns, rows = board.columns, board.rows
    return MarkerGrid(
        Lines(np.arange(float(columns)), np.arange(float(rows)), 1.0),
        sign=1.0 if sum(board.start) % 2 else -1.0,
        free=0.3,  # along the diagonals dots are farther away, but seen obliquely they come near
        faces=np.zeros((0, 2), int),
        is_dark=False,
        turns=0,
        points=np.arange(columns * rows).reshape(rows, columns),
        side=1.0,
        has_dots=True,
    )


@lru_cache(maxsize=32)  # eight ways for each of four boards
def april_grid(board: Board, is_bottom_up: bool, turns: int, border_share: float) -> MarkerGrid:
    """An AprilGrid; ``border_share`` is the width of the tags' border in their sides."""
    step = 1 + board.tag_gap_ratio
    x, y = ((np.arange(n)[:, None] * step + np.array([0.0, 1.0])).ravel() for n in (board.columns, board.rows))
    row, column = np.divmod(np.arange(board.columns * board.rows), board.columns)
    points = np.empty((2 * board.rows, 2 * board.columns), int)
    for corner, (dx, dy) in enumerate(_CORNERS):
        points[dy::2, dx::2] = 4 * np.arange(board.columns * board.rows).reshape(board.rows, board.columns) + corner
    return MarkerGrid(
        Lines(x, y, step),
        sign=-1.0,
        free=min(board.tag_gap_ratio, border_share),
        faces=2 * np.stack([column, board.rows - 1 - row if is_bottom_up else row], axis=-1),
        is_dark=True,
        turns=turns,
        points=points,
        side=1.0,
    )


def _at(lines: Float[ndarray, "n"], index: Int[ndarray, "..."]) -> Float[ndarray, "..."]:
    """Where lines lie, those a step beyond the outer ones too."""
    all_lines = (
        np.r_[2 * lines[0] - lines[1], lines, 2 * lines[-1] - lines[-2]]
        if len(lines) > 1
        else np.r_[lines - 1, lines, lines + 1]
    )
    return all_lines[index + 1]
