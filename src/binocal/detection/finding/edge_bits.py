"""PuzzleBoards: the dots on the edges of a lattice of X-corners say which part of the pattern it is.

Each edge between two corners of the lattice is read in its middle and compared with the two squares beside it: white, black, or
anything between. A part of the board is laid over the lattice, turned in four ways, where the readings agree with the code.
Readings a period of the code apart tell of the same bit, and vote.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.boards.puzzle_code import BELOW, BESIDE, PERIOD, REPEATS, SIDE, bits_below, bits_beside
from binocal.kernels import images
from binocal.kernels.marker_grids import FieldLens, Lines, predict_places
from binocal.shapes import Float, Int, UInt8

AROUND_MIDDLE = 0.06  # squares: a dot has a radius of a sixth
ASIDE = (
    0.32  # squares from the edge, where its two squares are read: far from it, and from the dots on their other edges
)
LEAST_CONTRAST = 0.3  # of the median edge's, for what is beside it not to be hidden
LEAST_DEPTH = (
    0.2  # of a dot, in half the contrast of squares, by the median edge: a blur of a quarter of a square leaves so much
)
LEAST_AGREEMENT = 0.6  # a fifth of the bits wrong
MOST_CHANCE = 1e-6  # that bits of chance agree as well with any place on the board: markers read as dots are such bits
LEAST_EVEN, EVEN = 0.75, (0.5, 1.5)  # share of the dots whose depth is so near the median's; of markers half are
LEAST_AHEAD = 3.0  # bits, of the best place before the second one
LEAST_ELSEWHERE = 2.0  # bits, by which a place of the pattern that the board has not must be better, for it to be meant
MOST_BEYOND = 2  # lines of the lattice beyond the board: clutter that was linked
TURNS = tuple(np.array(turn) for turn in ([[1, 0], [0, 1]], [[0, -1], [1, 0]], [[-1, 0], [0, -1]], [[0, 1], [-1, 0]]))
MIRRORED = np.array([[-1, 0], [0, 1]])


@dataclass(frozen=True, slots=True, eq=False)
class EdgeReadings:
    """Edges of a lattice between corners (column, row) and the next ones, and how white the dot on each is: about -1 to 1."""

    ends: Int[ndarray, "n 2 2"]
    """Of each edge: its two corners."""
    white: Float[ndarray, "n"]


@dataclass(frozen=True, slots=True, eq=False)
class CodePlace:
    """A lattice as a part of the pattern: its corner (column, row) is the pattern's corner ``turn @ (column, row) + shift``."""

    turn: Int[ndarray, "2 2"]
    shift: Int[ndarray, "2"]
    agreement: float
    """Of the readings with the code: 1 where all agree, 0 of chance."""
    is_inverted: bool

    def corners(self, cells: Int[ndarray, "*n 2"]) -> Int[ndarray, "*n 2"]:
        """The pattern's corners (column, row) at the lattice's."""
        return cells @ self.turn.T + self.shift


@dataclass(frozen=True, slots=True, eq=False)
class Decoding:
    """Where on the board a lattice is; None, and why, where that is not sure."""

    place: CodePlace | None
    reason: str = ""
    rank: int = 0
    """Of the reason: the larger says more."""


def read_edges(
    image: UInt8[ndarray, "h w"], grid_px: Float[ndarray, "rows columns 2"], lens: FieldLens, *, is_bright_first: bool
) -> EdgeReadings:
    """The dots on the edges between known corners; ``is_bright_first``: the square beyond corner (0, 0) is bright.

    Edges whose squares do not look like a chessboard's are left out.
    """
    ends, middle, side_a, side_b = _places(grid_px)
    rows, columns = grid_px.shape[:2]
    lines = Lines(np.arange(columns, dtype=float), np.arange(rows, dtype=float), 1.0)
    points = predict_places(lines, grid_px, lens, np.concatenate([middle, side_a, side_b], axis=1))
    inside = ((points >= 0) & (points <= np.array(image.shape[::-1]) - 1.0)).all(axis=(1, 2))
    values = np.full(points.shape[:2], np.nan)
    values[inside] = images.sample(image, points[inside])
    n = middle.shape[1]
    at_middle, a, b = values[:, :n].mean(axis=1), values[:, n : n + 2].mean(axis=1), values[:, n + 2 :].mean(axis=1)
    # Side a lies in the square beyond the edge's first corner: like the first one's where column + row is even.
    sign = np.where((ends[:, 0].sum(axis=1) % 2 == 0) == is_bright_first, 1.0, -1.0)
    contrast = sign * (a - b)
    known = contrast[np.isfinite(contrast)]
    least = LEAST_CONTRAST * float(np.median(known)) if len(known) else np.inf
    with np.errstate(invalid="ignore"):
        is_clear = contrast > max(least, 1.0)
        white = (2 * at_middle - a - b) / contrast
    return EdgeReadings(ends[is_clear], np.clip(white[is_clear], -1.5, 1.5))


def _places(
    grid_px: Float[ndarray, "rows columns 2"],
) -> tuple[Int[ndarray, "n 2 2"], Float[ndarray, "n 5 2"], Float[ndarray, "n 2 2"], Float[ndarray, "n 2 2"]]:
    """Edges between two known corners, and where each is read: about its middle, and in the squares at both sides."""
    is_known = np.isfinite(grid_px[..., 0])
    parts = []
    for step, aside in ((np.array([1, 0]), np.array([0, 1])), (np.array([0, 1]), np.array([1, 0]))):
        both = is_known[: len(is_known) - step[1], : is_known.shape[1] - step[0]] & is_known[step[1] :, step[0] :]
        first = np.argwhere(both)[:, ::-1]
        middle = first + 0.5 * step
        around = AROUND_MIDDLE * np.array([0 * step, step, -step, aside, -aside])
        beside = ASIDE * aside + 0.08 * np.array([step, -step])
        # To both sides of an edge along x the square beyond its corner is below it; of one along y, to its right.
        parts.append(
            (
                np.stack([first, first + step], axis=1),
                middle[:, None] + around,
                middle[:, None] + beside,
                middle[:, None] - beside,
            )
        )
    ends, middle, side_a, side_b = (np.concatenate(part) for part in zip(*parts, strict=True))
    return ends, middle, side_a, side_b


def locate(
    board: Board,
    cells: Int[ndarray, "m 2"],
    readings: EdgeReadings,
    *,
    is_bright_first: bool,
) -> Decoding:
    """The part of the board that a lattice with corners at some cells is, by its readings.

    Refused where no place agrees well, where another one agrees nearly as well, where the board is mirrored, and where a part of
    the pattern that the board has not agrees better.
    """
    weight = float(np.abs(readings.white).sum())
    depth = np.abs(readings.white)
    median = float(np.median(depth)) if len(depth) else 0.0
    if median < LEAST_DEPTH or np.mean((depth > EVEN[0] * median) & (depth < EVEN[1] * median)) < LEAST_EVEN:
        return Decoding(None, "shows no dots on its edges; is it another kind of board?", 1)
    ways = [_Way.of(turn, cells, readings, is_bright_first) for turn in TURNS]
    n_bits = ways[0].n_bits
    low, high = np.array(board.start), np.array(board.start) + (board.columns, board.rows)
    for beyond in (0, MOST_BEYOND):
        here = _Best(weight)
        for way in ways:
            here.add(way, way.shifts(low - beyond, high + beyond))
        errors, ahead = 0.5 * n_bits * (1 - here.agreement), 0.5 * n_bits * (here.agreement - here.second)
        is_good = (
            here.agreement >= LEAST_AGREEMENT
            and here.n_tried * chance_of(n_bits, errors) < MOST_CHANCE
            and ahead >= LEAST_AHEAD
        )
        if is_good:
            break
    if here.place is None:
        return Decoding(None, f"reaches beyond the SPEC's {board.columns}x{board.rows}", 2)
    if is_good and errors < LEAST_ELSEWHERE:
        return Decoding(here.place)
    everywhere = _Best(weight)
    for way in ways:
        everywhere.add(way, way.shifts(np.zeros(2, int), np.full(2, SIDE)))
    if _is_sure(everywhere, n_bits) and 0.5 * n_bits * (everywhere.agreement - here.agreement) >= LEAST_ELSEWHERE:
        return Decoding(None, _elsewhere(everywhere.place, cells), 4)
    if is_good:
        return Decoding(here.place)
    mirrored = _Best(weight)
    for turn in TURNS:
        way = _Way.of(turn @ MIRRORED, cells, readings, is_bright_first)
        mirrored.add(way, way.shifts(low - MOST_BEYOND, high + MOST_BEYOND))
    if mirrored.n_tried and mirrored.n_tried * chance_of(n_bits, 0.5 * n_bits * (1 - mirrored.agreement)) < MOST_CHANCE:
        return Decoding(None, "is the board mirrored; give the images as the cameras took them", 5)
    return Decoding(None, "does not bear the board's code, or too little of it is seen", 3)


def agreement_at(
    cells_px: Float[ndarray, "rows columns 2"], board: Board, readings: EdgeReadings, reach: int
) -> Float[ndarray, "rows columns"]:
    """How well the readings about each corner of the board agree with its code; NaN where there are none.

    ``readings`` are those of the board's own corners; those within ``reach`` corners count.
    """
    first, last = readings.ends[:, 0] + board.start, readings.ends[:, 1] + board.start
    is_beside = first[:, 1] == last[:, 1]
    bits = np.where(is_beside, bits_beside(first[:, 0], first[:, 1]), bits_below(first[:, 0], first[:, 1]))
    shape = cells_px.shape[:2]
    agreeing, weight = np.zeros(shape), np.zeros(shape)
    for end in (0, 1):
        column, row = readings.ends[:, end].T
        np.add.at(agreeing, (row, column), (2 * bits - 1) * readings.white)
        np.add.at(weight, (row, column), np.abs(readings.white))
    side = 2 * reach + 1
    agreeing, weight = (
        np.lib.stride_tricks.sliding_window_view(np.pad(layer, reach), (side, side)).sum(axis=(2, 3))
        for layer in (agreeing, weight)
    )
    return np.divide(agreeing, weight, out=np.full(shape, np.nan), where=weight > 0)


def chance_of(n_bits: int, errors: float) -> float:
    """That so many bits of chance have at most so many errors."""
    most = math.floor(errors + 0.5)
    if most >= n_bits:
        return 1.0
    return sum(math.comb(n_bits, k) for k in range(most + 1)) * 0.5**n_bits


@dataclass(frozen=True, slots=True, eq=False)
class _Way:
    """A lattice turned: its extent, and how well each shift agrees, apart for both tables of the code."""

    turn: Int[ndarray, "2 2"]
    low: Int[ndarray, "2"]
    high: Int[ndarray, "2"]
    beside: Float[ndarray, "3 167"]
    below: Float[ndarray, "3 167"]
    parity: int
    """Of the shift's sum, where the print is not inverted."""
    n_bits: int
    """Different bits that are read."""

    @staticmethod
    def of(
        turn: Int[ndarray, "2 2"], cells: Int[ndarray, "m 2"], readings: EdgeReadings, is_bright_first: bool
    ) -> _Way:
        turned = cells @ turn.T
        ends = readings.ends @ turn.T
        first = ends.min(axis=1)
        is_beside = ends[:, 0, 1] == ends[:, 1, 1]
        across, along = first[is_beside], first[~is_beside][:, ::-1]
        beside, n_beside = _correlate(BESIDE, across, readings.white[is_beside])
        below, n_below = _correlate(BELOW, along, readings.white[~is_beside])
        # The square beyond the lattice's corner (0, 0) is that whose lower right corner is at `beyond`, moved by the shift.
        beyond = np.rint(turn @ np.array([0.5, 0.5]) + 0.5).astype(int)
        parity = (int(beyond.sum()) + int(is_bright_first)) % 2
        return _Way(turn, turned.min(axis=0), turned.max(axis=0), beside, below, parity, n_beside + n_below)

    def shifts(self, low: Int[ndarray, "2"], high: Int[ndarray, "2"]) -> tuple[Int[ndarray, "p"], Int[ndarray, "q"]]:
        """Shifts in x and in y that put the lattice between two corners of the pattern."""
        x, y = (np.arange(low[k] - self.low[k], high[k] - self.high[k]) for k in (0, 1))
        return x, y

    def scores(self, x: Int[ndarray, "p"], y: Int[ndarray, "q"]) -> Float[ndarray, "p q"]:
        """Sum of the readings, each by its bit's sign, at each shift; negative print has all of them reversed, as its squares show."""
        sums = self.beside[(x % REPEATS)[:, None], y % PERIOD] + self.below[y % REPEATS, (x % PERIOD)[:, None]]
        return np.where(np.add.outer(x, y) % 2 == self.parity, sums, -sums)


def _correlate(
    table: Int[ndarray, "3 167"], places: Int[ndarray, "n 2"], white: Float[ndarray, "n"]
) -> tuple[Float[ndarray, "3 167"], int]:
    """The sum of readings, each by its bit's sign, at each shift of places in a table; and how many bits are read."""
    if len(places) == 0:
        return np.zeros(table.shape), 0
    least = places[:, 1].min()
    read = np.zeros((REPEATS, int(np.ptp(places[:, 1])) + 1))
    np.add.at(read, (places[:, 0] % REPEATS, places[:, 1] - least), white)
    signs = 2.0 * table - 1
    out = np.zeros(table.shape)
    for shift in range(REPEATS):
        for row in range(REPEATS):
            line = signs[(row + shift) % REPEATS]
            windows = np.take(line, np.add.outer(np.arange(PERIOD) + least, np.arange(read.shape[1])) % PERIOD)
            out[shift] += windows @ read[row]
    folded = {(int(i) % REPEATS, int(j) % PERIOD) for i, j in places}
    return out, len(folded)


class _Best:
    """The best and the second best of the places tried."""

    def __init__(self, weight: float) -> None:
        self._weight = weight
        self.place: CodePlace | None = None
        self.agreement = self.second = -1.0
        self.n_tried = 0

    def add(self, way: _Way, shifts: tuple[Int[ndarray, "p"], Int[ndarray, "q"]]) -> None:
        x, y = shifts
        if len(x) == 0 or len(y) == 0:
            return
        scores = way.scores(x, y).ravel() / self._weight
        self.n_tried += len(scores)
        order = np.argpartition(scores, -2)[-2:] if len(scores) > 1 else np.array([0])
        for index in order[np.argsort(-scores[order])]:
            if scores[index] > self.agreement:
                i, j = np.unravel_index(index, (len(x), len(y)))
                self.second, self.agreement = self.agreement, float(scores[index])
                is_inverted = bool((int(x[i]) + int(y[j])) % 2 != way.parity)
                self.place = CodePlace(way.turn, np.array([x[i], y[j]]), self.agreement, is_inverted)
            else:
                self.second = max(self.second, float(scores[index]))


def _is_sure(best: _Best, n_bits: int) -> bool:
    errors, ahead = 0.5 * n_bits * (1 - best.agreement), 0.5 * n_bits * (best.agreement - best.second)
    return best.n_tried * chance_of(n_bits, errors) < 1e-3 and ahead >= LEAST_AHEAD


def _elsewhere(place: CodePlace | None, cells: Int[ndarray, "m 2"]) -> str:
    assert place is not None
    corners = place.corners(cells)
    low, high = corners.min(axis=0), corners.max(axis=0)
    return (
        f"is of another part of the pattern, columns {low[0]} to {high[0]} and rows {low[1]} to {high[1]}; "
        "give the SPEC's start=COLUMN,ROW as it was printed"
    )
