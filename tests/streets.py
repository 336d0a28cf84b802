"""Matches of a street with known truth, for the tests of everything that works from natural images."""

from __future__ import annotations

import numpy as np

from binocal.cameras import StereoRig
from binocal.simulation import simulate_matches
from rigs import street_rig

RIG = street_rig()
SIZE, T_RIGHT_LEFT = RIG.left.size_wh, RIG.T_right_left


def cameras(model="brown4"):
    rig = street_rig(model)
    return rig.left, rig.right


def street(rng, pair, n, noise_px, wrong=0.0):
    """Matches of a street; the wrong ones lie anywhere in the right image or some periods off along the row."""
    rig = StereoRig(*pair, T_RIGHT_LEFT)
    kinds = ("uniform", "row")
    return simulate_matches(rig, n, rng, noise_px=noise_px, wrong_share=wrong, wrong_kinds=kinds).matches


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
