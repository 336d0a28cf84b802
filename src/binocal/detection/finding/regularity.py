"""Do found points lie where some lens could have put a plane's points?"""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.detection.finding.planes import N_FOR_WHOLE_LENS, TOLERANCE_PX, determine_plane, grid_residuals
from binocal.kernels.image_lens import LensFitOptions, fit_image_lens
from binocal.shapes import Bool, Float

MAX_OFF_PER_SPACING = (
    0.1  # the worst true corner of a lens of 60 to 200 degrees is 0.01 spacings off; a neighbour's corner 1
)
MIN_LIMIT_PX = 1.0  # where squares are small, corners of the coarse search are off by as much
# Points from which on leverages stay below 0.5: a wild point keeps half of its error in a plain fit.
N_FOR_PLAIN_FIT = 40
N_FOR_LENS = 6  # fewer fit any lens: a homography must do


def keep_regular(
    board_xy: Float[ndarray, "n 2"],
    points_px: Float[ndarray, "n 2"],
    spacing_px: Float[ndarray, "n"],
    size_wh: tuple[int, int],
) -> Float[ndarray, "n 2"]:
    """The points, NaN where :func:`find_irregular` finds them so; what is NaN already has no say."""
    seen = np.isfinite(points_px[:, 0])
    kept = points_px.copy()
    is_irregular = find_irregular(board_xy[seen], points_px[seen], spacing_px[seen], size_wh)
    kept[np.nonzero(seen)[0][is_irregular]] = np.nan
    return kept


def find_irregular(
    board_xy: Float[ndarray, "n 2"],
    points_px: Float[ndarray, "n 2"],
    spacing_px: Float[ndarray, "n"],
    size_wh: tuple[int, int],
) -> Bool[ndarray, "n"]:
    """Points that are far from the plane seen through the image's lens, at most a tenth of the local spacing or 1 px being near.

    Spacing is per point, pixels. The lens is the image's own (:mod:`binocal.kernels.image_lens`), any from pincushion to 200
    degrees. Points that determine no plane, as all but one on a line, contradict none.
    """
    limit = np.maximum(MAX_OFF_PER_SPACING * spacing_px, MIN_LIMIT_PX)
    n = len(points_px)
    # One plain fit clears most grids.
    if n >= N_FOR_PLAIN_FIT:
        lens = fit_image_lens(board_xy, points_px, size_wh)
        if lens is not None and (lens.residual_px < 0.5 * limit).all():
            return np.zeros(n, bool)
    if not determine_plane(board_xy):
        return np.zeros(n, bool)
    tolerance_px = max(TOLERANCE_PX, 0.5 * float(np.median(limit)))
    if n < N_FOR_LENS:
        return ~(grid_residuals(board_xy, points_px, tolerance_px=tolerance_px) < limit)
    options = LensFitOptions(tolerance_px, is_robust=True, has_one_unknown=n < N_FOR_WHOLE_LENS)
    lens = fit_image_lens(board_xy, points_px, size_wh, options)
    return np.ones(n, bool) if lens is None else ~(lens.residual_px < limit)
