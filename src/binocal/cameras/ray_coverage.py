"""Where a lens model has no ray: beyond the radius at which its distortion folds back, pixels belong to no direction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from binocal.cameras.camera import Camera
from binocal.cameras.models import camera_model

N_ANGLES = 64  # from the axis, 1.4 or 2.9 degrees apart; lenses bend more slowly than that
MARGIN_PX = 1.0
GRID = 48  # pixels along each side of the image, its border included


@dataclass(frozen=True, slots=True)
class PixelsWithoutRay:
    """The share of an image whose pixels have no ray, and how far from the principal point the first of them lies."""

    share: float
    radius_px: float


def reaches_corners(camera: Camera) -> bool:
    """Whether the image moves outwards all the way to its four corners: then every pixel has a ray.

    Points are projected along the directions of the corners, at rising angles from the axis; a mapping that grows with the angle
    until it is past a corner has rays up to there. Cheap, and on the safe side: False may still mean that there is no gap.
    """
    width, height = camera.size_wh
    fx, fy, cx, cy = camera.parameters[:4]
    corners = np.array([[-0.5, -0.5], [width - 0.5, -0.5], [-0.5, height - 0.5], [width - 0.5, height - 0.5]])
    offset = corners - [cx, cy]
    azimuth = offset / [fx, fy]
    azimuth /= np.linalg.norm(azimuth, axis=1, keepdims=True)
    farthest = np.pi if camera_model(camera.model).sees_behind else 0.5 * np.pi - 0.01
    angle = np.linspace(0.0, farthest, N_ANGLES)
    rays = np.empty((4, N_ANGLES, 3))
    rays[..., :2] = azimuth[:, None] * np.sin(angle)[:, None]
    rays[..., 2] = np.cos(angle)
    with np.errstate(all="ignore"):
        radius = np.linalg.norm(camera.project(rays) - [cx, cy], axis=-1)
        grows = np.logical_and.accumulate(np.diff(radius, axis=1) > 0, axis=1)
        reached = np.where(grows, radius[:, 1:], 0.0).max(axis=1)
    return bool(np.all(reached > np.linalg.norm(offset, axis=1) + MARGIN_PX))


def pixels_without_ray(camera: Camera) -> PixelsWithoutRay | None:
    """What part of the camera's image has no ray; None where all of it has."""
    if reaches_corners(camera):
        return None
    width, height = camera.size_wh
    u, v = np.meshgrid(np.linspace(0, width - 1, GRID), np.linspace(0, height - 1, GRID))
    pixels = np.stack([u, v], axis=-1)
    has_ray = np.isfinite(camera.unproject(pixels)[..., 2])
    if has_ray.all():
        return None
    radius_px = np.linalg.norm(pixels - camera.parameters[2:4], axis=-1)
    strip = np.ones(GRID)
    strip[[0, -1]] = 0.5  # pixels of the border stand for half as much
    share = strip @ ~has_ray @ strip / strip.sum() ** 2
    return PixelsWithoutRay(float(share), float(radius_px[~has_ray].min()))
