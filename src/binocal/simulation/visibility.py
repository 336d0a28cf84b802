"""Which points a camera sees: in front of the lens, inside its field, inside the image."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.cameras import Camera
from binocal.shapes import Float


def field_angle_rad(camera: Camera) -> float:
    """Largest angle from the optical axis that lands in the image, radians.

    Beyond it a distortion polynomial may fold back and put a point that no lens sees into the image.
    """
    width, height = camera.size_wh
    u, v = np.meshgrid(np.linspace(-0.5, width - 0.5, 13), np.linspace(-0.5, height - 0.5, 13))
    rays = camera.unproject(np.stack([u, v], axis=-1))
    angles = np.arctan2(np.hypot(rays[..., 0], rays[..., 1]), rays[..., 2])
    return float(np.nanmax(angles, initial=0.0)) + 1e-9


def visible_px(
    camera: Camera, points: Float[ndarray, "*batch n 3"], *, margin_px: float = 0.0, field_rad: float | None = None
) -> Float[ndarray, "*batch n 2"]:
    """Pixels of points in the camera frame; NaN where the camera does not see them.

    A point is seen when it lies within ``field_rad`` of the axis (:func:`field_angle_rad` unless given) and lands
    in the image, at least ``margin_px`` from its edge. Occlusion is NOT checked.
    """
    points = np.asarray(points, dtype=float)
    field = field_angle_rad(camera) if field_rad is None else field_rad
    with np.errstate(invalid="ignore"):
        pixels = camera.project(points)
        u, v = pixels[..., 0], pixels[..., 1]
        low, (width, height) = margin_px - 0.5, camera.size_wh
        is_seen = (u >= low) & (u <= width - 1 - low) & (v >= low) & (v <= height - 1 - low)
        is_seen &= np.hypot(points[..., 0], points[..., 1]) * np.cos(field) <= points[..., 2] * np.sin(field)
    return np.where(is_seen[..., None], pixels, np.nan)
