"""Do found points lie where one smooth lens could have put a plane's points?"""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.detection.finding.planes import TOLERANCE_PX, grid_residuals
from binocal.shapes import Bool, Float

MAX_OFF_PER_SPACING = 0.1  # the worst true corner of a 110-degree lens is 0.04 spacings off; a neighbour's corner 1
MIN_LIMIT_PX = 1.0  # where squares are small, corners of the coarse search are off by as much
# Points from which on leverages stay below 0.5: a wild point keeps half of its error in a plain fit.
N_FOR_PLAIN_FIT = 40


def keep_regular(
    board_xy: Float[ndarray, "n 2"], points_px: Float[ndarray, "n 2"], spacing_px: Float[ndarray, "n"]
) -> Float[ndarray, "n 2"]:
    """The points, NaN where :func:`find_irregular` finds them so; what is NaN already has no say."""
    seen = np.isfinite(points_px[:, 0])
    kept = points_px.copy()
    kept[np.nonzero(seen)[0][find_irregular(board_xy[seen], points_px[seen], spacing_px[seen])]] = np.nan
    return kept


def find_irregular(
    board_xy: Float[ndarray, "n 2"], points_px: Float[ndarray, "n 2"], spacing_px: Float[ndarray, "n"]
) -> Bool[ndarray, "n"]:
    """Points that are far from the smooth image of the plane, at most a tenth of the local spacing or 1 px being near.

    Spacing is per point, pixels.
    """
    limit = np.maximum(MAX_OFF_PER_SPACING * spacing_px, MIN_LIMIT_PX)
    # One plain fit clears most grids.
    if len(points_px) >= N_FOR_PLAIN_FIT and (grid_residuals(board_xy, points_px, n_rounds=1) < 0.5 * limit).all():
        return np.zeros(len(points_px), bool)
    tolerance_px = max(TOLERANCE_PX, 0.5 * float(np.median(limit)))
    return ~(grid_residuals(board_xy, points_px, tolerance_px=tolerance_px) < limit)
