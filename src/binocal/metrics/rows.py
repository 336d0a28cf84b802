"""By how much matching points miss each other's row once a rig has rectified them, and where in the image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.cameras import StereoRig
from binocal.evidence.point_matches import PointMatches
from binocal.rectification import rectify_points, row_rectification
from binocal.shapes import Float

COLUMNS, ROWS = 4, 3
MIN_IN_REGION = 5


@dataclass(frozen=True, slots=True, eq=False)
class RowFigures:
    """Row errors of matches, pixels of the rectified images: median and 95 % of the sizes, and the signed median by region.

    ``by_region`` are the left image's 3 x 4 regions, NaN where there are few matches; left less right.
    """

    median_px: float
    p95_px: float
    by_region_px: Float[ndarray, "3 4"]
    n_matches: int


def row_figures(rig: StereoRig, matches: PointMatches) -> RowFigures:
    """Rows by this rig; wrong matches should have been left out.

    Raises:
        DegenerateGeometryError: The rig cannot be rectified.
    """
    rectification = row_rectification(rig)
    left = rectify_points(rig.left, rectification.R_rect_left, rectification.P_left, matches.left_px)
    right = rectify_points(rig.right, rectification.R_rect_right, rectification.P_right, matches.right_px)
    difference = (left - right)[:, 0 if rectification.is_vertical else 1]
    known = np.isfinite(difference)
    size = np.abs(difference[known])
    place = np.clip(
        np.floor(matches.left_px / np.array(rig.left.size_wh) * (COLUMNS, ROWS)), 0, (COLUMNS - 1, ROWS - 1)
    ).astype(int)
    regions = np.full((ROWS, COLUMNS), np.nan)
    for row in range(ROWS):
        for column in range(COLUMNS):
            own = known & (place[:, 0] == column) & (place[:, 1] == row)
            if own.sum() >= MIN_IN_REGION:
                regions[row, column] = np.median(difference[own])
    if not size.size:
        return RowFigures(np.nan, np.nan, regions, 0)
    return RowFigures(float(np.median(size)), float(np.quantile(size, 0.95)), regions, int(size.size))
