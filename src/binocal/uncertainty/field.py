"""Where in the left image depth can be measured: a grid of pixels, and which of them both cameras see."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.cameras import Camera, StereoRig
from binocal.shapes import Bool, Float
from binocal.uncertainty.depth import is_seen_by_right, points_at
from binocal.values import ArrayValue, frozen_array

GRID_WH = (17, 13)  # places over the image, its border included


@dataclass(frozen=True, slots=True, eq=False)
class CommonField(ArrayValue):
    """A grid of left pixels, their points at one depth (left frame, metres), and which of them the right camera sees too."""

    depth_m: float
    left_px: Float[ndarray, "rows columns 2"]
    points: Float[ndarray, "rows columns 3"]
    is_common: Bool[ndarray, "rows columns"]

    def __post_init__(self) -> None:
        for name in ("left_px", "points"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))
        object.__setattr__(self, "is_common", frozen_array(self.is_common, bool))

    @property
    def share(self) -> float:
        """Share of the grid's places that both cameras see."""
        return float(self.is_common.mean())

    @property
    def middle(self) -> tuple[int, int]:
        """Row and column of the common place that is nearest to the middle of all common places; of the grid, if there is none."""
        px = self.left_px
        target = px[self.is_common].mean(axis=0) if self.is_common.any() else px.reshape(-1, 2).mean(axis=0)
        distance = np.linalg.norm(px - target, axis=-1)
        if self.is_common.any():
            distance = np.where(self.is_common, distance, np.inf)
        row, column = np.unravel_index(int(np.argmin(distance)), distance.shape)
        return int(row), int(column)


def image_grid(camera: Camera, grid_wh: tuple[int, int] = GRID_WH) -> Float[ndarray, "rows columns 2"]:
    """Pixels spread evenly over an image, from its first to its last row and column."""
    width, height = camera.size_wh
    u, v = np.meshgrid(np.linspace(0, width - 1, grid_wh[0]), np.linspace(0, height - 1, grid_wh[1]))
    return np.stack([u, v], axis=-1)


def common_field(rig: StereoRig, depth_m: float, grid_wh: tuple[int, int] = GRID_WH) -> CommonField:
    """The grid at a depth, metres (board pitches without a scale)."""
    px = image_grid(rig.left, grid_wh)
    points = points_at(rig, px, depth_m)
    return CommonField(float(depth_m), px, points, is_seen_by_right(rig, points))
