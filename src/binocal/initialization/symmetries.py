"""Motions that map a planar board's points onto each other: the ways in which a finder may number the same corners."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.geometry import SE3
from binocal.shapes import Float, Int

_CANDIDATES = (
    ("", ((1, 0), (0, 1))),
    ("reversed (180 deg)", ((-1, 0), (0, -1))),
    ("turned by 90 deg", ((0, -1), (1, 0))),
    ("turned by 270 deg", ((0, 1), (-1, 0))),
    ("mirrored (columns reversed)", ((-1, 0), (0, 1))),
    ("mirrored (rows reversed)", ((1, 0), (0, -1))),
    ("transposed (columns and rows exchanged)", ((0, 1), (1, 0))),
    ("transposed and reversed", ((0, -1), (-1, 0))),
)


@dataclass(frozen=True, slots=True, eq=False)
class BoardSymmetries:
    """Rigid motions of the board onto itself, the identity first.

    ``order[k]`` lists, for each point j, the point that motion k takes it to: ``motions[k].apply(X[j]) ==
    X[order[k][j]]``. A mirror image in the plane is a half turn about an axis in the plane.
    """

    names: tuple[str, ...]
    motions: SE3
    order: Int[ndarray, "k n"]

    def inverse_of(self, k: int) -> int:
        """Index of the inverse motion."""
        identity = np.arange(self.order.shape[1])
        return next(i for i in range(len(self.names)) if np.array_equal(self.order[k][self.order[i]], identity))

    @property
    def mirror_order(self) -> Int[ndarray, "n"] | None:
        """The order in which a mirrored image of the board is numbered; None for boards that tell their mirror image."""
        mirrors = np.flatnonzero(self.motions.R[:, 2, 2] < 0)
        return self.order[mirrors[0]] if len(mirrors) else None


def mirrored_corners(
    px: Float[ndarray, "views n 2"], width_px: int, order: Int[ndarray, "n"]
) -> Float[ndarray, "views n 2"]:
    """The corners of the flipped images, as a finder numbers them there; ``order`` is the board's ``mirror_order``."""
    return (px * [-1.0, 1.0] + [width_px - 1.0, 0.0])[:, order]


def no_symmetry(n_points: int) -> BoardSymmetries:
    """The identity alone."""
    return BoardSymmetries(("",), SE3(np.eye(3)[None], np.zeros((1, 3))), np.arange(n_points)[None])


def board_symmetries(object_points: Float[ndarray, "n d"]) -> BoardSymmetries:
    """Symmetries of planar points (z = 0), found geometrically among the eight of a square."""
    xy = np.asarray(object_points, dtype=float)[:, :2]
    centre = (xy.min(axis=0) + xy.max(axis=0)) / 2
    centred = xy - centre
    size = float(np.ptp(xy, axis=0).max()) or 1.0
    grid = 1e-4 * size
    index = {tuple(key): i for i, key in enumerate(np.round(centred / grid).astype(int).tolist())}
    names, R, t, order = [], [], [], []
    for name, matrix in _CANDIDATES:
        A = np.array(matrix, dtype=float)
        moved = np.round(centred @ A.T / grid).astype(int)
        found = []
        for x, y in moved.tolist():  # neighbours too: rounding may fall on either side
            near = (index.get((x + i, y + j)) for i in (0, -1, 1) for j in (0, -1, 1))
            match = next((k for k in near if k is not None), None)
            if match is None:
                break
            found.append(match)
        if len(found) == len(xy) and len(set(found)) == len(xy):
            rotation = np.eye(3)
            rotation[:2, :2] = A
            rotation[2, 2] = np.linalg.det(A)
            names.append(name)
            R.append(rotation)
            t.append(np.r_[centre - A @ centre, 0.0])
            order.append(found)
    return BoardSymmetries(tuple(names), SE3(np.array(R), np.array(t)), np.array(order))


def transposed_order(object_points: Float[ndarray, "n d"]) -> Int[ndarray, "n"] | None:
    """Which point of a full grid the k-th corner is if corners come column by column; None for other boards."""
    xy = np.asarray(object_points, dtype=float)[:, :2]
    size = float(np.ptp(xy, axis=0).max()) or 1.0
    keys = np.round(xy / (1e-6 * size)).astype(np.int64)
    n_columns, n_rows = len(np.unique(keys[:, 0])), len(np.unique(keys[:, 1]))
    if n_columns * n_rows != len(xy) or len(np.unique(keys, axis=0)) != len(xy):
        return None
    column, row = np.divmod(np.arange(len(xy)), n_rows)
    by_position = np.lexsort((keys[:, 0], keys[:, 1]))
    return by_position[row * n_columns + column]
