"""Lattices of plain points (circle centres), followed step by step as a lens bends them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.detection.finding.planes import N_FOR_WHOLE_LENS
from binocal.kernels.image_lens import LensFitOptions, fit_image_lens
from binocal.shapes import Bool, Float, Int

MAX_STEP_ERROR = 0.28  # of the step, between where a neighbour should be and where it is
SURE_STEP_ERROR = 0.12  # taken before any that are farther off, which are looked at again with more neighbours known
MAX_RADIUS_RATIO = 1.9  # between a spot and those about it: some boards mark spots by 1.4 times the diameter
N_FOR_LENS = 12  # points, from which on they tell the image's lens
_N_NEAR = 8
_ALONG = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
_AROUND = np.array([[x, y] for x in (-1, 0, 1) for y in (-1, 0, 1) if x or y])
_MOST_SEEDS, _SEEDS_A_LATTICE = 12, 3
_MOST_BASES = 3  # of a seed
_MIN_SINE = 0.3  # between two steps; a staggered grid at 60 degrees of tilt has 0.6
_MAX_AREA = 1.5  # of a basis's cell over the smallest one's: larger is a lattice of every second point
_MAX_UNLIKE = 0.35  # between a step and the opposite one, of its length: through a lens of 180 degrees 0.25


@dataclass(frozen=True, slots=True, eq=False)
class LatticePoints:
    """Indices of the points of one lattice and their integer cells, in a basis of the lattice's own."""

    members: Int[ndarray, "m"]
    cells: Int[ndarray, "m 2"]


def grow_point_lattices(
    points: Float[ndarray, "n 2"],
    radii: Float[ndarray, "n"],
    size_wh: tuple[int, int],
    *,
    least: int,
    enough: int,
    n_for_lens: int = N_FOR_LENS,
) -> list[LatticePoints]:
    """Lattices of at least ``least`` points, the largest first; each point is in one at most.

    From ``n_for_lens`` points on a lattice is completed by the image's lens. The first one of ``enough`` points is taken,
    else the largest of those that a few seeds and their neighbours suggest.
    """
    n = len(points)
    if n < max(least, 4):
        return []
    near, distance = _nearest(points)
    ways = points[near] - points[:, None]
    unlike = np.linalg.norm(ways[:, :, None] + ways[:, None], axis=-1).min(axis=2) / distance
    is_alike = np.abs(np.log(radii[near] / radii[:, None])) < np.log(MAX_RADIUS_RATIO)
    # Seeds first where the surroundings are regular: opposite neighbours at equal distances.
    order = np.argsort(np.sort(unlike, axis=1)[:, :4].mean(axis=1), kind="stable")
    free = np.ones(n, bool)
    lattices: list[LatticePoints] = []
    tried = 0
    while tried < _MOST_SEEDS and free.sum() >= least:
        largest: LatticePoints | None = None
        seeds = [int(seed) for seed in order if free[seed]][:_SEEDS_A_LATTICE]
        order = order[~np.isin(order, seeds)]
        tried += len(seeds)
        if not seeds:
            break
        for seed, basis in ((s, b) for s in seeds for b in _seed_bases(ways[s], unlike[s], is_alike[s])):
            lattice = _grow_from(points, radii, seed, basis, free)
            if max(least, n_for_lens) <= len(lattice.members) < enough:
                lattice = complete_by_lens(lattice, points, free, size_wh)
            if largest is None or len(lattice.members) > len(largest.members):
                largest = lattice
            if len(largest.members) >= enough:
                break
        if largest is not None and len(largest.members) >= least:
            free[largest.members] = False
            lattices.append(largest)
    return sorted(lattices, key=lambda lattice: -len(lattice.members))


def is_seen_from_behind(points: Float[ndarray, "m 2"], cells: Int[ndarray, "m 2"]) -> bool:
    """Whether the step along a lattice's first axis turns into that along its second the wrong way, at most of its cells."""
    low = cells.min(axis=0)
    grid = np.full((*(np.ptp(cells, axis=0) + 1), 2), np.nan)
    grid[tuple((cells - low).T)] = points
    a, b = np.diff(grid, axis=0)[:, :-1], np.diff(grid, axis=1)[:-1]
    return bool(np.nansum(np.sign(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])) <= 0)


def _nearest(points: Float[ndarray, "n 2"]) -> tuple[Int[ndarray, "n k"], Float[ndarray, "n k"]]:
    """The nearest neighbours of each point, the nearest first, and their distances."""
    x, y = points[:, 0], points[:, 1]
    squared = (x[:, None] - x) ** 2 + (y[:, None] - y) ** 2
    np.fill_diagonal(squared, np.inf)
    k = min(_N_NEAR, len(points) - 1)
    near = np.argpartition(squared, k - 1, axis=1)[:, :k]
    distance = np.take_along_axis(squared, near, axis=1)
    order = np.argsort(distance, axis=1)
    return np.take_along_axis(near, order, axis=1), np.sqrt(np.take_along_axis(distance, order, axis=1))


def _seed_bases(
    ways: Float[ndarray, "k 2"], unlike: Float[ndarray, "k"], is_alike: Bool[ndarray, "k"]
) -> list[tuple[ndarray, ndarray]]:
    """Pairs of steps to try: to near neighbours of like size that do not lie on one line, first those with an opposite."""
    alike = np.flatnonzero(is_alike)
    chosen = ways[alike[np.argsort(unlike[alike] > _MAX_UNLIKE, kind="stable")]][:5]
    bases = []
    for i, a in enumerate(chosen):
        for b in chosen[i + 1 :]:
            area, lengths = abs(a[0] * b[1] - a[1] * b[0]), np.hypot(*a) * np.hypot(*b)
            if area > _MIN_SINE * lengths:
                bases.append((float(area / lengths), float(area), a, b))
    smallest = min((area for _, area, _, _ in bases), default=0.0)
    fitting = [basis for basis in bases if basis[1] < _MAX_AREA * smallest]
    return [(a, b) for _, _, a, b in sorted(fitting, key=lambda basis: -basis[0])[:_MOST_BASES]]


def _grow_from(
    points: ndarray, radii: ndarray, seed: int, basis: tuple[ndarray, ndarray], free: ndarray
) -> LatticePoints:
    """The lattice reached from a seed, one ring of cells a round, each from all that is known about it."""
    index = np.flatnonzero(free)
    x, y, sizes = points[index, 0], points[index, 1], np.log(radii[index])
    is_left = index != seed
    canvas = _Canvas(points, np.log(radii), seed)
    while is_left.any():
        # the seed's own steps hold about the seed alone
        cells, expected, step, size = canvas.expect(basis if canvas.n == 1 else None)
        squared = (expected[:, 0, None] - x) ** 2 + (expected[:, 1, None] - y) ** 2
        squared[:, ~is_left] = np.inf
        best = squared.argmin(axis=1)
        off = np.sqrt(np.nan_to_num(squared[np.arange(len(best)), best], nan=np.inf)) / step
        is_good = (off < MAX_STEP_ERROR) & (np.abs(sizes[best] - size) < np.log(MAX_RADIUS_RATIO))
        if not is_good.any():
            break
        if (is_good & (off < SURE_STEP_ERROR)).any():
            is_good &= off < SURE_STEP_ERROR
        good = np.flatnonzero(is_good)
        for k in good[np.argsort(off[good], kind="stable")]:
            if is_left[best[k]]:
                canvas.put(cells[k], int(index[best[k]]))
                is_left[best[k]] = False
    return canvas.lattice()


def complete_by_lens(
    lattice: LatticePoints, points: Float[ndarray, "n 2"], free: Bool[ndarray, "n"], size_wh: tuple[int, int]
) -> LatticePoints:
    """The lattice with points beside it, and in its gaps, that lie where the image's own lens sees the plane's next cells.

    Where a board is so near that steps grow by a third from one to the next, local steps mislead and the lens does not.
    """
    members, cells = lattice.members, lattice.cells
    while True:
        is_left = free.copy()
        is_left[members] = False
        index = np.flatnonzero(is_left)
        around = np.unique((cells[:, None] + _AROUND).reshape(-1, 2), axis=0)
        around = around[~(around[:, None] == cells).all(axis=2).any(axis=1)]
        if not len(index):
            break
        way = [1.0, -1.0] if is_seen_from_behind(points[members], cells) else [1.0, 1.0]
        steps = (around[:, None] + np.array([[0, 0], [1, 0], [0, 1]])).reshape(-1, 2)
        options = LensFitOptions(is_robust=True, has_one_unknown=len(members) < N_FOR_WHOLE_LENS)
        lens = fit_image_lens(cells * way, points[members], size_wh, options, places_xy=steps * way)
        if lens is None:
            break
        expected, right, below = np.moveaxis(lens.images_px.reshape(-1, 3, 2), 1, 0)
        step = np.minimum(np.hypot(*(right - expected).T), np.hypot(*(below - expected).T))
        off = np.linalg.norm(points[index] - expected[:, None], axis=2) / step[:, None]
        off = np.where(np.isfinite(off), off, np.inf)
        best = off.argmin(axis=1)
        is_best_of_point = off.argmin(axis=0)[best] == np.arange(len(around))
        taken = is_best_of_point & (off.min(axis=1) < SURE_STEP_ERROR)
        if not taken.any():
            break
        members, cells = np.r_[members, index[best[taken]]], np.concatenate([cells, around[taken]])
    return LatticePoints(members, cells)


class _Canvas:
    """Cells about a seed with room beyond them: indices of their points, -1 where none, the points, and their sizes' logarithms."""

    _APRON = 4

    def __init__(self, points: ndarray, sizes: ndarray, seed: int) -> None:
        self._all_points, self._all_sizes = points, sizes
        self._place = np.full((64, 64), -1)
        self._points = np.full((64, 64, 2), np.nan)
        self._sizes = np.full((64, 64), np.nan)
        self._origin = np.array([32, 32])
        self._low, self._high = self._origin.copy(), self._origin.copy()
        self.n = 0
        self.put(self._origin, seed)

    def put(self, cell: Int[ndarray, "2"], index: int) -> None:
        """A point into a cell (row and column of the canvas)."""
        at = cell[0], cell[1]
        self._place[at], self._points[at], self._sizes[at] = index, self._all_points[index], self._all_sizes[index]
        self._low, self._high = np.minimum(self._low, cell), np.maximum(self._high, cell)
        self.n += 1

    def lattice(self) -> LatticePoints:
        """What the canvas holds, in cells from the seed."""
        cells = np.argwhere(self._place >= 0)
        return LatticePoints(self._place[tuple(cells.T)], cells - self._origin)

    def expect(
        self, basis: tuple[ndarray, ndarray] | None
    ) -> tuple[Int[ndarray, "k 2"], Float[ndarray, "k 2"], Float[ndarray, "k"], Float[ndarray, "k"]]:
        """Empty cells beside taken ones, where their points should be (infinite: unknown), and the steps and sizes there."""
        if min(self._low) < self._APRON or max(self._high) >= len(self._place) - self._APRON:
            self._widen()
        (top, left), (bottom, right) = self._low - 2, self._high + 3
        is_taken = self._place[top:bottom, left:right] >= 0
        beside = is_taken[2:, 1:-1] | is_taken[:-2, 1:-1] | is_taken[1:-1, 2:] | is_taken[1:-1, :-2]
        cells = np.argwhere(beside & ~is_taken[1:-1, 1:-1]) + self._low - 1
        expected, weight, step, size = _from_each_side(self._points, self._sizes, cells, basis)
        is_known = np.isfinite(expected[..., 0])
        weight = np.where(is_known, weight, 0.0)
        total, n_sides = weight.sum(axis=0), np.maximum(is_known.sum(axis=0), 1)
        expected = (weight[..., None] * np.where(is_known[..., None], expected, 0.0)).sum(axis=0)
        expected = np.where(total[:, None] > 0, expected / np.maximum(total, 1e-12)[:, None], np.inf)
        step, size = (np.where(is_known, values, 0.0).sum(axis=0) / n_sides for values in (step, size))
        return cells, expected, np.maximum(step, 1e-9), size

    def _widen(self) -> None:
        room = len(self._place) // 2
        self._place = np.pad(self._place, room, constant_values=-1)
        self._sizes = np.pad(self._sizes, room, constant_values=np.nan)
        self._points = np.pad(self._points, ((room, room), (room, room), (0, 0)), constant_values=np.nan)
        self._origin, self._low, self._high = self._origin + room, self._low + room, self._high + room


def _from_each_side(
    wide: ndarray, size_map: ndarray, at: ndarray, basis: tuple[ndarray, ndarray] | None
) -> tuple[Float[ndarray, "4 k 2"], Float[ndarray, "4 k"], Float[ndarray, "4 k"], Float[ndarray, "4 k"]]:
    """Where a cell's point should be by its neighbour on each side, with a weight, the step that leads there, and the size.

    NaN where its steps are not known. The step is the one before, changed as the steps change along the line, else as
    beside it, else the basis's.
    """

    def look(i: int, j: int = 0) -> ndarray:
        place = at - i * _ALONG[:, None] + j * np.abs(_ALONG[:, None, ::-1])
        return wide[place[..., 0], place[..., 1]]

    first, second = look(1), look(2)
    behind = first - second
    if basis is None:
        step = np.full(first.shape, np.nan)
    else:
        step = np.tile(np.array([basis[0], -basis[0], basis[1], -basis[1]])[:, None], (1, len(at), 1))
    weight = np.full(first.shape[:2], 1e-3)
    better = [(behind, 1.0), (2 * behind - (second - look(3)), 2.0)]
    for side in (1, -1):  # the same step in the lines beside it
        here = look(1, side)
        beside = look(0, side) - here
        better += [(beside, 1.0), (behind + (beside - (here - look(2, side))), 3.0)]
    for other, worth in better:
        is_known = np.isfinite(other[..., 0]) & (weight < worth)
        step[is_known], weight[is_known] = other[is_known], worth
    before = at - _ALONG[:, None]
    return first + step, weight, np.hypot(step[..., 0], step[..., 1]), size_map[before[..., 0], before[..., 1]]
