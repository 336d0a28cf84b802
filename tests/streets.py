"""Matches of a street with known truth, for the tests of everything that works from natural images."""

from __future__ import annotations

import numpy as np

from binocal.cameras import Camera
from binocal.evidence.point_matches import PointMatches
from binocal.geometry import SE3, so3

SIZE = (1242, 375)
T_RIGHT_LEFT = SE3(so3.exp(np.radians([0.3, -0.8, 0.2])), np.array([-0.54, 0.004, -0.006]))


def cameras(model="brown4"):
    if model == "fisheye4":
        return tuple(Camera(model, SIZE, np.array([400, 401, 615 + i, 180, 0, -0.02, 0.003, 0, 0])) for i in range(2))
    return tuple(
        Camera(model, SIZE, np.array([720, 721, 615 + 3 * i, 180, 0, -0.2, 0.05, 1e-3, -5e-4])) for i in range(2)
    )


def street(rng, pair, n, noise_px, wrong=0.0):
    """Matches of points between 4 and 60 m; the wrong ones lie anywhere in the right image, a third elsewhere on their row."""
    left, right = [], []
    while len(left) < n:
        px = rng.uniform(0, 1, (4 * n, 2)) * SIZE
        depth = 1 / rng.uniform(1 / 60, 1 / 4, 4 * n)
        points = pair[0].unproject(px)
        points = points / points[:, 2:] * depth[:, None]
        seen = pair[1].project(T_RIGHT_LEFT.apply(points))
        inside = ((seen > 0) & (seen < np.array(SIZE) - 1)).all(axis=1)
        left, right = [*left, *px[inside]], [*right, *seen[inside]]
    left, right = np.array(left[:n]), np.array(right[:n])
    left, right = left + rng.normal(0, noise_px, left.shape), right + rng.normal(0, noise_px, right.shape)
    n_wrong = round(wrong * n)
    repeated = n_wrong // 3
    right[:repeated, 0] += rng.uniform(-80, 80, repeated)
    right[repeated:n_wrong] = rng.uniform(0, 1, (n_wrong - repeated, 2)) * SIZE
    return PointMatches(left, right, np.zeros(n, dtype=int), ("0",), SIZE, SIZE)
