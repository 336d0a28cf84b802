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
LEAST_SWAPPED, MOST_SWAPPED = 0.75, 1.25
MOST_UNEVEN, MOST_OFF_COLOUR = 0.35, 0.35
LEAST_AROUND = 5  # corners about a square of the other colour: so many are at a corner of the lattice
LEAST_CONTRAST = 0.3  # of the median square's
MOST_STRAY = 0.02  # of the squares, that read as marked and are none: glare, an insect
MOST_OUTSIDE = 0.02  # of the corners, beyond the board: clutter that was linked
LEAST_AGREEING = (
    2  # marks in view, of several: of three in a corner two leave two ways, and the rest of the board refutes one
)
LEAST_OUTSIDE, LEAST_OUTSIDE_SHARE = 3, 0.06  # for a way to lay the board to be refuted
TURNS = [np.array(turn) for turn in ([[1, 0], [0, 1]], [[0, -1], [1, 0]], [[-1, 0], [0, -1]], [[0, 1], [-1, 0]])]

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
    may_be_swapped: Bool[ndarray, "rows columns"]
    """Whether the square is of one colour all over and those about it are as they should be, and no corner is known at its
    own four corners, but all around them are."""

    def is_disc(self) -> Bool[ndarray, "rows columns"]:
        """Squares with a disc."""
        return self.disc > LEAST_DISC

    def is_swapped(self) -> Bool[ndarray, "rows columns"]:
        """Squares of the other colour."""
        return (self.swapped > LEAST_SWAPPED) & (self.swapped < MOST_SWAPPED) & self.may_be_swapped


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
    contrast = _clear(other - own)
    # With the square itself: of those across its corners one may be of the other colour.
    typical = _levels(around, has_own=True)[0]
    of_typical = _clear(other - typical)
    with np.errstate(invalid="ignore"):
        # Where the square about its middle is of neither colour, or of both, a hand or a shadow's border hides the middle too.
        is_hidden = np.ptp(values[..., N_MIDDLE:], axis=-1) > MOST_UNEVEN * np.abs(of_typical)
        is_hidden |= np.abs(around - typical) > MOST_OFF_COLOUR * np.abs(of_typical)
        is_even = np.ptp(values, axis=-1) < MOST_UNEVEN * np.abs(contrast)
        disc = np.where(is_hidden, np.nan, (middle - around) / of_typical)
        swapped = (around - own) / contrast
    is_hole = _are_holes(np.isfinite(grid_px[..., 0])) & is_even & ~_are_beside(is_hidden)
    return SquareReadings(disc, swapped, is_hole)


def _clear(contrast: Float[ndarray, "rows columns"]) -> Float[ndarray, "rows columns"]:
    """Contrasts, NaN where there is hardly any beside most squares'."""
    known = np.abs(contrast[np.isfinite(contrast)])
    least = LEAST_CONTRAST * float(np.median(known)) if len(known) else np.inf
    return np.where(np.abs(contrast) > least, contrast, np.nan)


def _is_surrounded(is_known: Bool[ndarray, "rows columns"]) -> Bool[ndarray, "rows columns"]:
    """Where five places or more within two lines are known: as at the outermost corner of a lattice whose first square has none."""
    padded = np.pad(is_known.astype(int), 2)
    return np.lib.stride_tricks.sliding_window_view(padded, (5, 5)).sum(axis=(2, 3)) >= 5


def _are_holes(is_known: Bool[ndarray, "rows columns"]) -> Bool[ndarray, "rows_less columns_less"]:
    """Squares at whose four corners none is known, but all but one that the lattice has around them: a hand hides more.

    A corner of the lattice that the hole cuts off from the others is linked to none.
    """
    known, here = (np.pad(layer.astype(int), 1) for layer in (is_known, np.ones_like(is_known)))
    n_known, n_here = (
        np.lib.stride_tricks.sliding_window_view(layer, (4, 4)).sum(axis=(2, 3)) for layer in (known, here)
    )
    inner = np.lib.stride_tricks.sliding_window_view(is_known, (2, 2)).any(axis=(2, 3))
    return ~inner & (n_known >= n_here - 5) & (n_known >= LEAST_AROUND)


def _are_beside(is_hidden: Bool[ndarray, "rows columns"]) -> Bool[ndarray, "rows columns"]:
    """Squares with a hidden one at an edge of theirs."""
    around = np.pad(is_hidden, 1)
    return around[:-2, 1:-1] | around[2:, 1:-1] | around[1:-1, :-2] | around[1:-1, 2:]


def _levels(
    around: Float[ndarray, "rows columns"], *, has_own: bool = False
) -> tuple[Float[ndarray, "rows columns"], Float[ndarray, "rows columns"]]:
    """Grey values of the squares' own colour, by those across their corners, and of the other, by those beside their edges: medians.

    ``has_own`` counts a square's own value, too.
    """
    padded = np.pad(around, 1, constant_values=np.nan)
    near = np.lib.stride_tricks.sliding_window_view(padded, (3, 3)).reshape(*around.shape, 9)
    across, beside = near[..., [0, 2, 6, 8] + [4] * has_own], near[..., [1, 3, 5, 7]]
    return _median(across), _median(beside)


def _median(values: Float[ndarray, "rows columns k"]) -> Float[ndarray, "rows columns"]:
    """Of the values that are not NaN, NaN where all are."""
    ordered = np.sort(values, axis=-1)  # NaN last
    count = np.isfinite(values).sum(axis=-1)
    middle = np.stack([np.maximum(count - 1, 0) // 2, count // 2], axis=-1)
    return np.take_along_axis(ordered, middle, axis=-1).mean(axis=-1)


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
            for turn in TURNS:
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
