"""Which circle of a board each point of a lattice is: the lattice's cells laid on the board in every way that fits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.detection.finding.point_lattice import LatticePoints, is_seen_from_behind
from binocal.shapes import Float, Int

MAX_SHARE_MISSING = 0.1  # of a grid whose outline is complete
WHOLE_SHARE = 0.95  # of a grid, for another one beside it to be taken for a second board
MAX_SHARE_BEYOND = 0.35  # of a line outside the board: strays that happen to lie there; more is a line of a larger grid


def match_circles(
    lattice: LatticePoints, points_px: Float[ndarray, "spots 2"], board: Board
) -> Int[ndarray, "n"] | None:
    """Index of each board point's spot, -1 where none; None where the whole board does not fit on the lattice.

    Of several ways that fit, the one whose rows run most to the lower right.
    """
    points, n = points_px[lattice.members], len(lattice.members)
    best: tuple[int, float, ndarray] | None = None
    for turn, xy in enumerate(lattice_layouts(lattice, points, board.kind, turns=4)):
        if turn % 4 == 0 and best is not None and best[0] == n:
            break  # no other basis holds more
        first = _Occupancy(xy, board.kind).window(board)
        if first is None:
            continue
        index = assign_points(lattice, xy - first, board)
        # the most points first: a narrow grid sheared by a place has one or two outside
        rank = int((index >= 0).sum()), _way(xy, points)
        if best is None or rank > best[:2]:
            best = *rank, index
    return None if best is None else best[2]


def shows_another(lattices: Sequence[LatticePoints], points_px: Float[ndarray, "spots 2"], board: Board) -> bool:
    """Whether one of these lattices, beside the one that was taken for the board, is as good as whole a board of that size."""
    for lattice in lattices:
        if len(lattice.members) < WHOLE_SHARE * board.n_points:
            continue
        index = match_circles(lattice, points_px, board)
        if index is not None and (index >= 0).sum() >= WHOLE_SHARE * board.n_points:
            return True
    return False


def measure_lattice(
    lattice: LatticePoints, points_px: Float[ndarray, "spots 2"], kind: str
) -> tuple[tuple[int, int], int]:
    """Columns and rows of the grid of that kind that a lattice fills best, and how many of its circles are seen."""
    points = points_px[lattice.members]
    extents = [
        _Occupancy(xy, kind).extent()
        for xy in lattice_layouts(lattice, points, kind, turns=2 if kind == "acircles" else 1)
    ]
    _, n_seen, size = max(extents, key=lambda extent: extent[0])
    return size, n_seen


def lattice_layouts(lattice: LatticePoints, points: ndarray, kind: str, *, turns: int) -> Iterator[Int[ndarray, "m 2"]]:
    """Integer coordinates of a lattice's points on a board of its kind, in pitches, in each basis and turned by 90 degrees."""
    behind = is_seen_from_behind(points, lattice.cells)
    for basis in _BASES:
        cells = lattice.cells @ basis.T
        if behind != (np.linalg.det(basis) < 0):
            cells = cells[:, ::-1]
        if kind == "acircles":  # its steps are diagonal: (+1, +1) and (-1, +1) pitches
            cells = np.stack([cells[:, 0] - cells[:, 1], cells[:, 0] + cells[:, 1]], axis=-1)
        for _ in range(turns):
            yield cells
            cells = np.stack([-cells[:, 1], cells[:, 0]], axis=-1)


def _bases() -> list[Int[ndarray, "2 2"]]:
    """Changes of basis that can turn a lattice's own steps into the board's, up to the board's turns: numbers -1 to 1, area kept.

    The identity first. Two that differ by a signed exchange of the axes are the same board turned or mirrored.
    """
    values = (0, 1, -1)
    found: dict[tuple, ndarray] = {}
    for a, b, c, d in ((a, b, c, d) for a in (1, 0, -1) for b in values for c in values for d in (1, 0, -1)):
        if abs(a * d - b * c) == 1:
            rows = tuple(sorted(max((x, y), (-x, -y)) for x, y in ((a, b), (c, d))))
            found.setdefault(rows, np.array([[a, b], [c, d]]))
    return list(found.values())


_BASES = _bases()


class _Occupancy:
    """Which places of a board's plane a lattice takes."""

    def __init__(self, xy: Int[ndarray, "m 2"], kind: str) -> None:
        self._low = xy.min(axis=0)
        self._kind = kind
        width, height = np.ptp(xy, axis=0) + 1
        self._taken = np.zeros((height, width), int)
        self._taken[tuple((xy - self._low).T[::-1])] = 1

    def extent(self) -> tuple[float, int, tuple[int, int]]:
        """How full the grid is without lines that hold few points, with how many, and its columns and rows."""
        taken = self._taken
        while taken.size:
            share = [taken[line].mean() for line in _BORDERS]
            typical = 0.5 if self._kind == "acircles" else 1.0
            thinnest = int(np.argmin(share))
            if share[thinnest] >= MAX_SHARE_BEYOND * typical or min(taken.shape) <= 2:
                break
            taken = taken[_WITHOUT[thinnest]]
        height, width = taken.shape
        if self._kind == "acircles":
            columns = (width + 1) // 2
            width = columns
        return float(taken.sum() / max(1, width * height)), int(taken.sum()), (width, height)

    def window(self, board: Board) -> Int[ndarray, "2"] | None:
        """Where the board's first circle lies so that the lattice fills the board and hardly more; None if nowhere."""
        is_staggered = board.kind == "acircles"
        width, height = (2 * board.columns if is_staggered else board.columns), board.rows
        spare = 1 if is_staggered else 0  # a last column that only some rows reach may be empty
        rows, columns = self._taken.shape
        if rows < height or columns < width - spare:
            return None
        wide = np.pad(self._taken, ((0, 0), (spare, spare)))
        total = np.pad(wide.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
        inside = total[height:, width:] - total[:-height, width:] - total[height:, :-width] + total[:-height, :-width]
        inside = inside.astype(float)
        if is_staggered:
            y, x = np.indices(inside.shape)
            # the places taken are those where x + y has one parity; the first circle is one of them
            parity = int(np.add(*np.argwhere(wide)[0])) % 2
            inside[(x + y) % 2 != parity] = -1
        y, x = np.unravel_index(int(inside.argmax()), inside.shape)
        if inside[y, x] < (1 - MAX_SHARE_MISSING) * board.n_points:
            return None
        beyond = (wide[y : y + height, max(x - 1, 0) : x], wide[y : y + height, x + width : x + width + 1])
        beyond += (wide[max(y - 1, 0) : y, x : x + width], wide[y + height : y + height + 1, x : x + width])
        if any(line.sum() > max(1, MAX_SHARE_BEYOND * line.size / (1 + spare)) for line in beyond):
            return None
        return np.array([x - spare, y]) + self._low


_BORDERS = (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1])
_WITHOUT = (np.s_[1:], np.s_[:-1], np.s_[:, 1:], np.s_[:, :-1])


def assign_points(lattice: LatticePoints, xy: Int[ndarray, "m 2"], board: Board) -> Int[ndarray, "n"]:
    """Index of each board point's spot, -1 where none; ``xy`` in pitches from the board's first circle."""
    x, y = xy.T
    column = x // 2 if board.kind == "acircles" else x
    is_inside = (x >= 0) & (column < board.columns) & (y >= 0) & (y < board.rows)
    spots = np.full(board.n_points, -1)
    spots[(y * board.columns + column)[is_inside]] = lattice.members[is_inside]
    return spots


def _way(xy: Int[ndarray, "m 2"], points: Float[ndarray, "m 2"]) -> float:
    """How far the rows run to the lower right, -1.4 to 1.4: decides between turns that nothing else distinguishes."""
    step = np.linalg.lstsq(np.column_stack([xy, np.ones(len(xy))]), points, rcond=None)[0][0]
    return float(step.sum() / np.linalg.norm(step))
