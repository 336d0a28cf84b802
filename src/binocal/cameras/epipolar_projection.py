"""How rays of a rectified frame become pixels, so that matching points of two cameras share a row (a column, if vertical).

A point lies on one plane through the baseline, at an angle from the viewing direction; every projection here gives a row to each such
plane. ``along`` is the coordinate along the baseline (x; y if vertical), ``across`` the other one, rho = sqrt(across² + z²):

=================  ==================  ===================  ==============================================
projection         along the baseline  across               disparity of a point
=================  ==================  ===================  ==============================================
pinhole            along / z           across / z           proportional to 1 / z
cylindrical        along / rho         atan2(across, z)     proportional to 1 / rho
equirectangular    atan(along / rho)   atan2(across, z)     an angle: the one at the point between the rays
=================  ==================  ===================  ==============================================

Source of the two curved ones: Pollefeys, Koch & Van Gool 1999, "A simple and efficient rectification method for general motion"
(rows are planes through the baseline), on a cylinder about the baseline and on a sphere whose poles lie on it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy import ndarray

from binocal.shapes import Float
from binocal.values import ArrayValue, frozen_array

ProjectionKind: TypeAlias = Literal["pinhole", "cylindrical", "equirectangular"]
PROJECTIONS: tuple[ProjectionKind, ...] = get_args(ProjectionKind)


@dataclass(frozen=True, slots=True, eq=False)
class EpipolarProjection(ArrayValue):
    """A projection with its numbers: pixel = ``focal_px`` * coordinate + ``centre_px``, each (x, y).

    ``focal_px`` are pixels per unit of the coordinate, which is a radian where the table of :mod:`binocal.cameras.epipolar_projection`
    has an angle.
    """

    kind: ProjectionKind
    focal_px: Float[ndarray, "2"]
    centre_px: Float[ndarray, "2"]
    is_vertical: bool = False

    def __post_init__(self) -> None:
        if self.kind not in PROJECTIONS:
            raise ValueError(f"unknown projection {self.kind!r}; known: {', '.join(PROJECTIONS)}")
        for name in ("focal_px", "centre_px"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))

    @staticmethod
    def of_matrix(P: Float[ndarray, "3 4"]) -> EpipolarProjection:
        """The pinhole of OpenCV's P1 or P2."""
        return EpipolarProjection("pinhole", np.array([P[0, 0], P[1, 1]]), P[:2, 2])

    @property
    def along(self) -> int:
        """The axis along the baseline: 0 for x, 1 for y."""
        return int(self.is_vertical)

    def project(self, rays: Float[ndarray, "*batch 3"]) -> Float[ndarray, "*batch 2"]:
        """Pixels of rays (directions, of any length) in the rectified frame; NaN where the projection has none."""
        return coordinates(self.kind, self.along, rays) * self.focal_px + self.centre_px

    def unproject(self, pixels: Float[ndarray, "*batch 2"]) -> Float[ndarray, "*batch 3"]:
        """Rays of pixels in the rectified frame, as long as makes z (pinhole) or rho (the others) 1; NaN where there is none."""
        return rays_at(self.kind, self.along, (pixels - self.centre_px) / self.focal_px)

    def pixel_rays(self, size_wh: tuple[int, int]) -> tuple[Float[ndarray, "h 3"], Float[ndarray, "w 3"]]:
        """Two parts whose sum, of row i and column j, is the ray of that pixel: all pixels' rays without computing each."""
        parts = []
        for axis, n in ((1, size_wh[1]), (0, size_wh[0])):
            pixels = np.tile(self.centre_px, (n, 1))
            pixels[:, axis] = np.arange(n)
            part = self.unproject(pixels)
            if axis == self.along:
                part[:, [1 - axis, 2]] = 0.0
            parts.append(part)
        return parts[0], parts[1]


def coordinates(kind: ProjectionKind, along: int, rays: Float[ndarray, "*batch 3"]) -> Float[ndarray, "*batch 2"]:
    """The coordinates of rays, in the order (x, y), before focal length and centre."""
    rays = np.asarray(rays, dtype=float)
    a, b, z = rays[..., along], rays[..., 1 - along], rays[..., 2]
    out = np.empty((*rays.shape[:-1], 2))
    with np.errstate(all="ignore"):
        if kind == "pinhole":
            depth = np.where(z > 1e-9, z, np.nan)
            out[..., along], out[..., 1 - along] = a / depth, b / depth
            return out
        rho = np.hypot(b, z)
        out[..., along] = np.arctan2(a, rho) if kind == "equirectangular" else a / np.where(rho > 0, rho, np.nan)
        out[..., 1 - along] = np.arctan2(b, z)
    return out


def rays_at(kind: ProjectionKind, along: int, places: Float[ndarray, "*batch 2"]) -> Float[ndarray, "*batch 3"]:
    """The inverse of :func:`coordinates`, as long as makes z (pinhole) or rho (the others) 1."""
    a, b = places[..., along], places[..., 1 - along]
    rays = np.ones((*places.shape[:-1], 3))
    if kind == "pinhole":
        rays[..., along], rays[..., 1 - along] = a, b
        return rays
    rays[..., along] = np.where(np.abs(a) < np.pi / 2, np.tan(a), np.nan) if kind == "equirectangular" else a
    rays[..., 1 - along], rays[..., 2] = np.sin(b), np.cos(b)
    return rays
