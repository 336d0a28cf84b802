"""Uncertainty over the whole image at one range: what a table sums up, and a report draws."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.cameras import StereoRig
from binocal.errors import DegenerateGeometryError
from binocal.shapes import Float
from binocal.uncertainty.covariance import Covariance, MeanBoardPose
from binocal.uncertainty.depth import DepthSigma, depth_sigma
from binocal.uncertainty.field import GRID_WH, CommonField, common_field, image_grid
from binocal.uncertainty.projection import Side, projection_sigma_px
from binocal.uncertainty.rows import row_sigma_px
from binocal.values import ArrayValue, frozen_array


@dataclass(frozen=True, slots=True, eq=False)
class RangeMap(ArrayValue):
    """Standard deviations over the left image at one depth; NaN where not both cameras see.

    ``row_px`` is the row error after rectification, NaN throughout where the rig cannot be rectified.
    """

    field: CommonField
    depth: DepthSigma
    row_px: Float[ndarray, "rows columns"]

    def __post_init__(self) -> None:
        object.__setattr__(self, "row_px", frozen_array(self.row_px))

    @property
    def worst(self) -> tuple[int, int]:
        """Row and column of the grid's place where depth is worst; of the middle, where no place is seen by both."""
        return _largest(self.depth.total_m, self.field.middle)

    @property
    def worst_row(self) -> tuple[int, int]:
        """The same of the row error."""
        return _largest(self.row_px, self.field.middle)


@dataclass(frozen=True, slots=True, eq=False)
class ProjectionMap(ArrayValue):
    """Standard deviation of a camera's projection, pixels in the worst direction, over its image; NaN where a pixel has no ray."""

    side: Side
    px: Float[ndarray, "rows columns 2"]
    sigma_px: Float[ndarray, "rows columns"]

    def __post_init__(self) -> None:
        for name in ("px", "sigma_px"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))


def range_map(
    rig: StereoRig,
    covariance: Covariance,
    depth_m: float,
    *,
    matching_px: float = 0.0,
    board_scale_sigma: float = 0.0,
    grid_wh: tuple[int, int] = GRID_WH,
) -> RangeMap:
    """Depth and row error over the left image at a depth, metres (board pitches without a scale)."""
    field = common_field(rig, depth_m, grid_wh)
    points = np.where(field.is_common[..., None], field.points, np.nan)
    depth = depth_sigma(rig, covariance, points, matching_px=matching_px, board_scale_sigma=board_scale_sigma)
    left_px = np.where(field.is_common[..., None], field.left_px, np.nan)
    try:
        row_px = row_sigma_px(rig, covariance, left_px, np.linalg.norm(field.points, axis=-1))
    except DegenerateGeometryError:
        row_px = np.full(field.is_common.shape, np.nan)
    return RangeMap(field, depth, row_px)


def projection_map(
    rig: StereoRig,
    covariance: Covariance,
    mean_pose: MeanBoardPose,
    side: Side,
    range_m: float = np.inf,
    grid_wh: tuple[int, int] = GRID_WH,
) -> ProjectionMap:
    """A camera's projection uncertainty over its image, of things ``range_m`` away."""
    px = image_grid(getattr(rig, side), grid_wh)
    return ProjectionMap(side, px, projection_sigma_px(rig, covariance, mean_pose, side, px, range_m))


def _largest(values: Float[ndarray, "rows columns"], otherwise: tuple[int, int]) -> tuple[int, int]:
    if not np.isfinite(values).any():
        return otherwise
    row, column = np.unravel_index(int(np.nanargmax(values)), values.shape)
    return int(row), int(column)
