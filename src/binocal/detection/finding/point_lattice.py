"""Lattices of plain points (circle centres), followed step by step as a lens bends them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.detection.finding.planes import N_FOR_WHOLE_LENS, determine_plane
from binocal.kernels.image_lens import LensFitOptions, fit_image_lens
from binocal.kernels.point_lattices import GrowthLimits, find_nearest, grow_lattice
from binocal.shapes import Bool, Float, Int

MAX_STEP_ERROR = 0.28  # of the step, between where a neighbour should be and where it is
SURE_STEP_ERROR = 0.12  # taken before any that are farther off, which are looked at again with more neighbours known
MAX_RADIUS_RATIO = 1.9  # between a spot and those about it: some boards mark spots by 1.4 times the diameter
N_FOR_LENS = 12  # points, from which on they tell the image's lens
_N_NEAR = 8
_LIMITS = GrowthLimits(MAX_STEP_ERROR, SURE_STEP_ERROR, MAX_RADIUS_RATIO)
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
    near, _, unlike = find_nearest(points, min(_N_NEAR, n - 1))
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
        for seed, basis in ((s, b) for s in seeds for b in _seed_bases(points, radii, s, near[s], unlike[s])):
            lattice = LatticePoints(*grow_lattice(points, radii, free, seed, basis, _LIMITS))
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


def _seed_bases(
    points: Float[ndarray, "n 2"],
    radii: Float[ndarray, "n"],
    seed: int,
    near: Int[ndarray, "k"],
    unlike: Float[ndarray, "k"],
) -> list[Float[ndarray, "2 2"]]:
    """Pairs of steps to try: to near neighbours of like size that do not lie on one line, first those with an opposite."""
    ways = points[near] - points[seed]
    alike = np.flatnonzero(np.abs(np.log(radii[near] / radii[seed])) < np.log(MAX_RADIUS_RATIO))
    chosen = ways[alike[np.argsort(unlike[alike] > _MAX_UNLIKE, kind="stable")]][:5]
    bases = []
    for i, a in enumerate(chosen):
        for b in chosen[i + 1 :]:
            area, lengths = abs(a[0] * b[1] - a[1] * b[0]), np.hypot(*a) * np.hypot(*b)
            if area > _MIN_SINE * lengths:
                bases.append((float(area / lengths), float(area), a, b))
    smallest = min((area for _, area, _, _ in bases), default=0.0)
    fitting = [basis for basis in bases if basis[1] < _MAX_AREA * smallest]
    return [np.stack([a, b]) for _, _, a, b in sorted(fitting, key=lambda basis: -basis[0])[:_MOST_BASES]]


def complete_by_lens(
    lattice: LatticePoints, points: Float[ndarray, "n 2"], free: Bool[ndarray, "n"], size_wh: tuple[int, int]
) -> LatticePoints:
    """The lattice with points beside it, and in its gaps, that lie where the image's own lens sees the plane's next cells.

    Where a board is so near that steps grow by a third from one to the next, local steps mislead and the lens does not.
    """
    members, cells = lattice.members, lattice.cells
    while determine_plane(cells.astype(float)):
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
        step = np.maximum(step, 1e-9)
        off = np.linalg.norm(points[index] - expected[:, None], axis=2) / step[:, None]
        off = np.where(np.isfinite(off), off, np.inf)
        best = off.argmin(axis=1)
        is_best_of_point = off.argmin(axis=0)[best] == np.arange(len(around))
        taken = is_best_of_point & (off.min(axis=1) < SURE_STEP_ERROR)
        if not taken.any():
            break
        members, cells = np.r_[members, index[best[taken]]], np.concatenate([cells, around[taken]])
    return LatticePoints(members, cells)
