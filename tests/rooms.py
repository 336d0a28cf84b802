"""Segments of rooms and streets with known truth: three orthogonal families, clutter, ends measured with known covariance."""

from __future__ import annotations

import numpy as np

from binocal.evidence.line_segments import LineSegments
from binocal.geometry import so3

SIZE = (1280, 960)


def frame(yaw_deg, pitch_deg=0.0, roll_deg=0.0):
    """R_camera_scene of a camera turned so far from looking along the third axis."""
    return (
        so3.exp(np.radians([pitch_deg, 0, 0]))
        @ so3.exp(np.radians([0, yaw_deg, 0]))
        @ so3.exp(np.radians([0, 0, roll_deg]))
    )


def room(
    rng,
    K,
    rotations,
    *,
    per_family=40,
    clutter=0.0,
    noise_px=0.3,
    floor_px=0.0,
    families=(0, 1, 2),
    size=SIZE,
    skew_deg=0.0,
):
    """Segments of each image: ``noise_px`` is stated in their covariance, ``floor_px`` is not; ``clutter`` is the share of wrong ones."""
    parts = []
    for k, R in enumerate(rotations):
        R = R @ (np.eye(3) + np.triu(np.radians(skew_deg) * rng.normal(size=(3, 3)), 1))
        points = (K @ R).T
        ends, covariance = [], []
        for family in families:
            for _ in range(per_family):
                middle, half = rng.uniform(0.05, 0.95, 2) * size, rng.uniform(15, 90)
                towards = points[family, :2] - middle * points[family, 2]
                towards /= np.linalg.norm(towards)
                ends.append([middle - half * towards, middle + half * towards])
        n_wrong = round(len(ends) * clutter / (1 - clutter)) if clutter else 0
        for _ in range(n_wrong):
            middle, half, angle = rng.uniform(0.05, 0.95, 2) * size, rng.uniform(15, 90), rng.uniform(0, np.pi)
            towards = np.array([np.cos(angle), np.sin(angle)])
            ends.append([middle - half * towards, middle + half * towards])
        ends = np.array(ends)
        sigma = noise_px * rng.uniform(0.5, 1.5, len(ends))
        covariance = (sigma**2)[:, None, None] * np.array([[1.0, -0.4], [-0.4, 1.0]])
        along = ends[:, 1] - ends[:, 0]
        normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]
        moved = np.einsum("nij,nj->ni", np.linalg.cholesky(covariance), rng.normal(size=(len(ends), 2)))
        moved += floor_px * rng.normal(size=moved.shape)
        parts.append(
            LineSegments(
                ends + moved[..., None] * normal[:, None],
                covariance,
                np.tile([0.0, np.inf], (len(ends), 1)),
                np.zeros(len(ends), dtype=int),
                (f"{k}",),
                size,
            )
        )
    return LineSegments.joined(parts)


def pinhole(focal_px=1000.0, centre_px=(650.0, 470.0)):
    return np.array([[focal_px, 0, centre_px[0]], [0, focal_px, centre_px[1]], [0, 0, 1.0]])


def render_room(camera, R_camera_scene, *, seed=0, tile_m=0.45, finer=2):
    """A grey image of the inside of a tiled box, by rays, several to a pixel; uint8."""
    width, height = camera.size_wh
    step = (np.arange(finer) + 0.5) / finer - 0.5
    x = (np.arange(width)[:, None] + step).ravel()
    y = (np.arange(height)[:, None] + step).ravel()
    rays = camera.unproject(np.stack(np.meshgrid(x, y), axis=-1)) @ R_camera_scene
    half = np.array([2.3, 1.6, 2.9])
    with np.errstate(divide="ignore"):
        reach = half / np.abs(rays)
    wall = reach.argmin(axis=-1)
    place = rays * reach.min(axis=-1)[..., None]
    side = (np.take_along_axis(rays, wall[..., None], axis=-1)[..., 0] > 0).astype(int)
    tiles = np.floor((place + 50.0) / tile_m).astype(int)
    others = np.array([[1, 2], [0, 2], [0, 1]])[wall]
    u, v = (np.take_along_axis(tiles, others[..., k : k + 1], axis=-1)[..., 0] for k in range(2))
    grey = np.random.default_rng(seed).integers(30, 226, (3, 2, 400, 400))[wall, side, u, v].astype(float)
    grey = grey.reshape(height, finer, width, finer).mean(axis=(1, 3))
    noise = np.random.default_rng([seed, 1]).normal(0, 1.5, grey.shape)
    return np.clip(grey + noise, 0, 255).astype(np.uint8)
