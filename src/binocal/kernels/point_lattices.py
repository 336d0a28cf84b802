"""Neighbours among plain points, and the growth of a lattice of them from a seed, compiled.

Points are (x, y), finite. tests/kernels states each function plainly in NumPy and compares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.kernels import _kernel
from binocal.kernels.arrays import as_floats
from binocal.shapes import Bool, Float, Int


@dataclass(frozen=True, slots=True)
class GrowthLimits:
    """How far off, as a share of the step, a point may be: at most, and to be taken before all others; and how unlike in size."""

    most_error: float
    sure_error: float
    most_size_ratio: float


def find_nearest(
    points: Float[ndarray, "n 2"], k: int
) -> tuple[Int[ndarray, "n k"], Float[ndarray, "n k"], Float[ndarray, "n k"]]:
    """The ``k`` nearest other points of each, the nearest first; their distances; and how unlike the steps to them are.

    That is the length of the sum of a step and the most opposite of the others, over its own: 0 where a point has a
    neighbour as far off on the other side.
    """
    n = len(points)
    near, distance, unlike = np.empty((n, k), np.int64), np.empty((n, k)), np.empty((n, k))
    _kernel.find_nearest(as_floats(points), near, distance, unlike)
    return near, distance, unlike


def grow_lattice(
    points: Float[ndarray, "n 2"],
    sizes: Float[ndarray, "n"],
    is_free: Bool[ndarray, "n"],
    seed: int,
    basis: Float[ndarray, "2 2"],
    limits: GrowthLimits,
) -> tuple[Int[ndarray, "m"], Int[ndarray, "m 2"]]:
    """The points of one lattice and their cells from the seed's, first along the basis's first step, in order of the cells.

    A ring of cells a round: where a point should be follows from its neighbour on each side and the step that leads there:
    the one before, changed as the steps change along the line, else as beside it. The basis's steps (rows) hold about the
    seed alone. ``sizes`` are the spots' radii; a point that is not free belongs to another lattice.
    """
    n = len(points)
    members, cells = np.empty(n, np.int64), np.empty((n, 2), np.int64)
    n_found = _kernel.grow_point_lattice(
        as_floats(points), np.log(as_floats(sizes)), np.ascontiguousarray(is_free), seed, as_floats(basis), limits.most_error,
        limits.sure_error, float(np.log(limits.most_size_ratio)), members, cells,
    )  # fmt: skip
    return members[:n_found].copy(), cells[:n_found].copy()
