"""Lattices of plain points (circle centres): steps are learnt from neighbours, then followed as they bend."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.shapes import Float, Int

MAX_STEP_ERROR = 0.28  # of the step, between where a neighbour should be and where it is
MAX_RADIUS_RATIO = 1.6  # between neighbouring spots
_STEPS = ((1, 0), (-1, 0), (0, 1), (0, -1))
_MOST_SEEDS = 60


@dataclass(frozen=True, slots=True, eq=False)
class LatticePoints:
    """Indices of the points of one lattice and their integer cells, in a basis of the lattice's own."""

    members: Int[ndarray, "m"]
    cells: Int[ndarray, "m 2"]


def grow_point_lattices(
    points: Float[ndarray, "n 2"], radii: Float[ndarray, "n"], *, least: int
) -> list[LatticePoints]:
    """Lattices of at least ``least`` points, the largest first; each point is in one at most."""
    n = len(points)
    if n < least:
        return []
    distance = np.linalg.norm(points[:, None] - points[None], axis=-1)
    np.fill_diagonal(distance, np.inf)
    near = np.argsort(distance, axis=1)[:, : min(8, n - 1)]
    # Seeds first where the surroundings are regular: opposite neighbours at equal distances.
    order = np.argsort(
        [_irregularity(points, index, neighbours) for index, neighbours in enumerate(near)], kind="stable"
    )
    free = np.ones(n, bool)
    lattices = []
    for seed in order[:_MOST_SEEDS]:
        if not free[seed]:
            continue
        for basis in _seed_bases(points, radii, int(seed), near[seed]):
            cells = _grow_from(points, radii, int(seed), basis, free)
            if len(cells) >= least:
                members = np.array(list(cells))
                free[members] = False
                lattices.append(LatticePoints(members, np.array(list(cells.values()))))
                break
        if free.sum() < least:
            break
    return sorted(lattices, key=lambda lattice: -len(lattice.members))


def _irregularity(points: ndarray, index: int, neighbours: ndarray) -> float:
    way = points[neighbours] - points[index]
    length = np.linalg.norm(way, axis=1)
    mirrored = np.linalg.norm(way[:, None] + way[None], axis=-1).min(axis=1) / length
    return float(np.sort(mirrored)[: min(4, len(mirrored))].mean())


def _seed_bases(points: ndarray, radii: ndarray, seed: int, near: ndarray) -> list[tuple[ndarray, ndarray]]:
    """Pairs of steps to try: the nearest neighbours that do not lie on one line, of like size."""
    alike = [i for i in near if 1 / MAX_RADIUS_RATIO < radii[i] / radii[seed] < MAX_RADIUS_RATIO]
    ways = [points[i] - points[seed] for i in alike[:5]]
    bases = []
    for i, a in enumerate(ways):
        for b in ways[i + 1 :]:
            sine = abs(a[0] * b[1] - a[1] * b[0]) / (np.linalg.norm(a) * np.linalg.norm(b))
            if sine > 0.35:
                bases.append((a, b))
    return bases[:3]


def _grow_from(
    points: ndarray, radii: ndarray, seed: int, basis: tuple[ndarray, ndarray], free: ndarray
) -> dict[int, tuple[int, int]]:
    """Cells of the points reached from the seed; each keeps the local steps, learnt on the way."""
    cells = {seed: (0, 0)}
    taken = {(0, 0): seed}
    steps = {seed: (basis[0], basis[1])}
    queue = deque([seed])
    while queue:
        point = queue.popleft()
        x, y = cells[point]
        for dx, dy in _STEPS:
            cell = (x + dx, y + dy)
            if cell in taken:
                continue
            axis = 0 if dx else 1
            step = steps[point][axis] * (dx or dy)
            off = points - (points[point] + step)
            distance = np.hypot(off[:, 0], off[:, 1])
            distance[~free] = np.inf
            best = int(distance.argmin())
            ratio = radii[best] / radii[point]
            if (
                distance[best] > MAX_STEP_ERROR * np.hypot(*step)
                or best in cells
                or not 1 / MAX_RADIUS_RATIO < ratio < MAX_RADIUS_RATIO
            ):
                continue
            cells[best], taken[cell] = cell, best
            learnt = (points[best] - points[point]) * (dx or dy)
            both = list(steps[point])
            both[axis] = 0.3 * both[axis] + 0.7 * learnt
            steps[best] = (both[0], both[1])
            queue.append(best)
    return cells
