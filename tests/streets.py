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


def render(camera, T_camera_world, seed=0):
    """A grey image of a floor, a wall and three boxes' fronts with blotchy texture, by rays; uint8."""
    width, height = camera.size_wh
    x, y = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    rays = camera.unproject(np.stack([x, y], axis=-1)) @ T_camera_world.R
    origin = -T_camera_world.R.T @ T_camera_world.t
    planes = [  # a point, the normal, two axes, and how far the plane reaches along them
        ((0.0, 1.2, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (40.0, 40.0)),
        ((0.0, 0.0, 14.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (40.0, 40.0)),
        ((-1.5, 0.2, 4.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.7, 0.9)),
        ((1.6, 0.0, 6.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.9, 1.1)),
        ((0.2, -0.9, 9.0), (0.3, 0.0, 1.0), (1.0, 0.0, -0.3), (0.0, 1.0, 0.0), (1.8, 0.8)),
    ]
    grey, nearest = np.zeros((height, width)), np.full((height, width), np.inf)
    for index, (point, normal, u_axis, v_axis, reach) in enumerate(planes):
        away = np.array(point) - origin
        with np.errstate(all="ignore"):
            depth = (away @ normal) / (rays @ np.array(normal))
            depth = np.where(np.isfinite(depth), depth, -1.0)
        place = origin + depth[..., None] * rays - point
        u, v = place @ np.array(u_axis), place @ np.array(v_axis)
        hit = (depth > 0.1) & (depth < nearest) & (np.abs(u) < reach[0]) & (np.abs(v) < reach[1])
        grey[hit] = _blotches(u[hit], v[hit], np.random.default_rng([seed, index]))
        nearest[hit] = depth[hit]
    noise = np.random.default_rng([seed, 9, width + int(1e3 * abs(origin[0]))]).normal(0, 1.5, grey.shape)
    return np.clip(grey + noise, 0, 255).astype(np.uint8)


def _blotches(u, v, rng):
    """Smooth noise of five sizes between 0.05 and 1.5 m."""
    value = np.zeros(len(u))
    for size in (0.05, 0.1, 0.2, 0.5, 1.5):
        grid = rng.normal(size=(64, 64))
        a, b = u / size, v / size
        i, j = np.floor(a).astype(int), np.floor(b).astype(int)
        fa, fb = a - i, b - j
        fa, fb = fa * fa * (3 - 2 * fa), fb * fb * (3 - 2 * fb)
        corners = [grid[(i + di) % 64, (j + dj) % 64] for di, dj in ((0, 0), (1, 0), (0, 1), (1, 1))]
        value += (
            corners[0] * (1 - fa) * (1 - fb)
            + corners[1] * fa * (1 - fb)
            + corners[2] * (1 - fa) * fb
            + corners[3] * fa * fb
        )
    return 128 + 30 * value
