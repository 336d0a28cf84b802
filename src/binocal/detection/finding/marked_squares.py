"""Chessboards whose squares are told apart by marks: which part of the board a lattice of X-corners is.

Squares of the lattice are read in their middle and around it, and compared with those beside them: plain, with a disc of the other
colour, or of the other colour themselves. The board is laid over the lattice, turned in four ways, so that all its marked squares
lie on squares that read so.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.kernels.marker_grids import FieldLens, Lines, predict_places, read_cells
from binocal.shapes import Bool, Float, Int, UInt8

# Shares of the contrast between squares and those beside them. A disc that blur has taken three quarters of is still read: a Gaussian
# of 0.22 squares, at which corners are lost.
LEAST_DISC = 0.25
LEAST_SWAPPED, MOST_UNEVEN, MOST_OFF_COLOUR = 0.7, 0.35, 0.35
LEAST_CONTRAST = 0.3  # of the median square's
MOST_STRAY = 0.02  # of the squares, that read as marked and are none: glare, an insect
MOST_OUTSIDE = 0.02  # of the corners, beyond the board: clutter that was linked
LEAST_AGREEING = (
    2  # marks in view, of several: of three in a corner two leave two ways, and the rest of the board refutes one
)
LEAST_OUTSIDE, LEAST_OUTSIDE_SHARE = 3, 0.06  # for a way to lay the board to be refuted
_TURNS = [np.array(turn) for turn in ([[1, 0], [0, 1]], [[0, -1], [1, 0]], [[-1, 0], [0, -1]], [[0, 1], [-1, 0]])]

N_MIDDLE, N_AROUND = 4, 8


def _sample_places() -> Float[ndarray, "cells 2 2"]:
    """In a square's unit square: four pairs of places about its middle, then eight pairs around, clear of disc and edges."""
    cells = []
    for n, radius in ((N_MIDDLE, 0.08), (N_AROUND, 0.32)):
        angle = 2 * np.pi * (np.arange(2 * n) + 0.5) / (2 * n)
        cells.append((0.5 + radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)).reshape(n, 2, 2))
    return np.concatenate(cells)


_PLACES = _sample_places()


@dataclass(frozen=True, slots=True, eq=False)
class SquareReadings:
    """What the squares between a lattice's corners show; NaN where they are not seen."""

    disc: Float[ndarray, "rows columns"]
    """How far the middle has the other colour: 0 to 1."""
    swapped: Float[ndarray, "rows columns"]
    """How far all of the square has the other colour: 0 to 1."""
    is_even: Bool[ndarray, "rows columns"]
    """Whether the square is of one colour all over."""

    def is_disc(self) -> Bool[ndarray, "rows columns"]:
        """Squares with a disc."""
        return self.disc > LEAST_DISC

    def is_swapped(self) -> Bool[ndarray, "rows columns"]:
        """Squares of the other colour."""
        return (self.swapped > LEAST_SWAPPED) & self.is_even


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """A lattice as a part of the board: its corner (column, row) is the board's corner ``turn @ (column, row) + shift``."""

    turn: Int[ndarray, "2 2"]
    shift: Int[ndarray, "2"]
    n_outside: int
    """Corners seen beyond the board's."""

    def corners(self, cells: Int[ndarray, "*n 2"]) -> Int[ndarray, "*n 2"]:
        """The board's corners (column, row) at the lattice's."""
        return cells @ self.turn.T + self.shift


def read_squares(image: UInt8[ndarray, "h w"], grid_px: Float[ndarray, "rows columns 2"]) -> SquareReadings:
    """The squares between corners; corners that are not seen are taken from where those around them put them."""
    rows, columns = grid_px.shape[:2]
    lines = Lines(np.arange(columns, dtype=float), np.arange(rows, dtype=float), 1.0)
    whole = grid_px.copy()
    row, column = np.nonzero(~np.isfinite(grid_px[..., 0]) & _is_surrounded(np.isfinite(grid_px[..., 0])))
    places = np.stack([column, row], axis=-1).astype(float)
    whole[row, column] = predict_places(lines, grid_px, FieldLens(), places)
    quads = np.stack([whole[:-1, :-1], whole[:-1, 1:], whole[1:, 1:], whole[1:, :-1]], axis=2)
    size_wh = np.array(image.shape[::-1])
    with np.errstate(invalid="ignore"):
        is_seen = ((quads > -0.5) & (quads < size_wh - 0.5)).all(axis=(2, 3))
    values = np.full((*is_seen.shape, N_MIDDLE + N_AROUND), np.nan)
    values[is_seen] = read_cells(image, quads[is_seen], _PLACES, FieldLens())
    middle, around = values[..., :N_MIDDLE].mean(axis=-1), values[..., N_MIDDLE:].mean(axis=-1)
    own, other = _levels(around)
    contrast = other - own
    known = np.abs(contrast[np.isfinite(contrast)])
    least = LEAST_CONTRAST * float(np.median(known)) if len(known) else np.inf
    contrast = np.where(np.abs(contrast) > least, contrast, np.nan)
    with np.errstate(invalid="ignore"):
        is_even = np.ptp(values, axis=-1) < MOST_UNEVEN * np.abs(contrast)
        swapped, disc = (around - own) / contrast, (middle - around) / contrast
        # Where the square about its middle is of neither colour, or of both, a hand or a shadow's border hides the middle too.
        is_hidden = np.ptp(values[..., N_MIDDLE:], axis=-1) > MOST_UNEVEN * np.abs(contrast)
        is_hidden |= np.abs(swapped) > MOST_OFF_COLOUR
    return SquareReadings(np.where(is_hidden, np.nan, disc), swapped, is_even)


def _is_surrounded(is_known: Bool[ndarray, "rows columns"]) -> Bool[ndarray, "rows columns"]:
    """Where five places or more within two lines are known: as at the outermost corner of a lattice whose first square has none."""
    padded = np.pad(is_known.astype(int), 2)
    return np.lib.stride_tricks.sliding_window_view(padded, (5, 5)).sum(axis=(2, 3)) >= 5


def _levels(
    around: Float[ndarray, "rows columns"],
) -> tuple[Float[ndarray, "rows columns"], Float[ndarray, "rows columns"]]:
    """Grey values of the squares' own colour, by those across their corners, and of the other, by those beside their edges."""
    padded = np.pad(around, 1, constant_values=np.nan)
    rows, columns = around.shape

    def mean(steps: list[tuple[int, int]]) -> ndarray:
        near = np.stack([padded[1 + r : 1 + r + rows, 1 + c : 1 + c + columns] for r, c in steps])
        near.sort(axis=0)  # NaN last
        count = np.isfinite(near).sum(axis=0)
        low, high = np.maximum(count - 1, 0) // 2, count // 2
        low, high = (np.take_along_axis(near, np.minimum(i, 3)[None], axis=0)[0] for i in (low, high))
        return np.where(count > 0, 0.5 * (low + high), np.nan)

    return mean([(-1, -1), (-1, 1), (1, -1), (1, 1)]), mean([(0, -1), (0, 1), (-1, 0), (1, 0)])


def place_board(board: Board, grid_px: Float[ndarray, "rows columns 2"], readings: SquareReadings) -> list[Placement]:
    """Ways to lay a marked board over a lattice so that its marked squares, and no others, read as marked.

    More than one where what is seen leaves them open. Where all are refuted by corners beyond the board, the least so.
    """
    is_disc, is_swapped = readings.is_disc(), readings.is_swapped()
    marks = [(square, is_disc) for square in board.discs] + [(square, is_swapped) for square in board.swapped]
    is_read = np.isfinite(readings.disc) | is_swapped
    squares = np.array([square for square, _ in marks])
    n_marked = bool(board.discs) * is_disc.sum() + bool(board.swapped) * is_swapped.sum()
    most_stray = MOST_STRAY * is_read.sum()
    seen = np.argwhere(np.isfinite(grid_px[..., 0]))[:, ::-1]
    found: dict[tuple[int, ...], tuple[int, Placement]] = {}
    for square, is_marked in marks:
        for row, column in np.argwhere(is_marked):
            for turn in _TURNS:
                # Twice the middles of squares, in corners: that of the square (0, 0) is at (-1, -1).
                shift = ((2 * np.array(square) - 1) - turn @ (2 * np.array([column, row]) + 1)) // 2
                places = ((2 * squares - 1 - 2 * shift) @ turn - 1) // 2  # the turn's inverse is its transpose
                n_agreeing = _count_agreeing(places, [each for _, each in marks], is_read)
                if n_agreeing < min(LEAST_AGREEING, len(marks)) or n_marked - n_agreeing > most_stray:
                    continue
                corners = seen @ turn.T + shift
                inside = (corners >= 0) & (corners < [board.columns, board.rows])
                placement = Placement(turn, shift, int((~inside.all(axis=1)).sum()))
                found[(*turn.ravel().tolist(), *shift.tolist())] = n_agreeing, placement
    most = max((n for n, _ in found.values()), default=0)
    return _not_refuted([placement for n, placement in found.values() if n == most], len(seen))


def _count_agreeing(
    places: Int[ndarray, "m 2"], is_marked: list[Bool[ndarray, "rows columns"]], is_read: Bool[ndarray, "rows columns"]
) -> int:
    """How many of the board's marks are where they should be in the lattice; none if one is not, and its square is seen."""
    n = 0
    for (column, row), is_like_this in zip(places, is_marked, strict=True):
        if not (0 <= row < is_read.shape[0] and 0 <= column < is_read.shape[1] and is_read[row, column]):
            continue
        if not is_like_this[row, column]:
            return 0
        n += 1
    return n


def _not_refuted(found: list[Placement], n_seen: int) -> list[Placement]:
    refuted = max(LEAST_OUTSIDE, LEAST_OUTSIDE_SHARE * n_seen)
    left = [placement for placement in found if placement.n_outside < refuted]
    return left or sorted(found, key=lambda placement: placement.n_outside)[:1]


def fits_board(placement: Placement, n_seen: int) -> bool:
    """Whether nearly all corners seen are the board's."""
    return placement.n_outside <= max(1, MOST_OUTSIDE * n_seen)
