"""A lattice that lost its way, grown line by line to the board that it is a part of.

Links follow edges at every corner and fail first where squares are seen so obliquely that their corners hardly look like
one. The whole lattice knows better where the next line must lie: it is looked for there, and nowhere else.
"""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.detection.finding.grid import grid_reach, grid_spacing
from binocal.detection.finding.regularity import expected_points
from binocal.detection.measuring.corner_fit import fit_corners
from binocal.kernels import images
from binocal.shapes import Bool, Float, Float32

MIN_LINES, MIN_CORNERS = 3, 12
MIN_CONTRAST = (
    0.6  # of the lattice's own; on the line of the board's outer border, where every second square is margin, .5
)
MIN_SHARE_IN_COLOUR = 0.8  # of a line's corners
MIN_SHARE_FITTED = 0.5
MAX_MISFIT = 3.0
MAX_OFF = 0.25  # spacings from where the lattice puts it


def grow(
    grey: ndarray, smooth: Float32[ndarray, "h w"], points_px: Float[ndarray, "rows columns 2"], size: tuple[int, int]
) -> tuple[Float[ndarray, "rows columns 2"], int] | None:
    """The grid grown to ``size`` (the larger number first), and how many lines came before its first corner.

    ``grey`` is the image and ``smooth`` the same, smoothed; points in its pixels. None where the image does not bear it out.
    """
    grid, n_before = points_px, 0
    while (max(grid.shape[:2]), min(grid.shape[:2])) != size:
        rows, columns = grid.shape[:2]
        if min(rows, columns) < MIN_LINES or np.isfinite(grid[..., 0]).sum() < MIN_CORNERS:
            return None
        wider = [
            _with_line(grey, smooth, grid, axis, is_before)
            for axis in (0, 1)
            for is_before in (True, False)
            if _fits(rows + (axis == 0), columns + (axis == 1), size)
        ]
        grown = [candidate for candidate in wider if candidate is not None]
        if not grown:
            return None
        _, grid, is_before = max(grown, key=lambda candidate: candidate[0])
        n_before += is_before
    return grid, n_before


def _fits(rows: int, columns: int, size: tuple[int, int]) -> bool:
    return max(rows, columns) <= size[0] and min(rows, columns) <= size[1]


def _with_line(
    grey: ndarray, smooth: Float32[ndarray, "h w"], grid: Float[ndarray, "rows columns 2"], axis: int, is_before: bool
) -> tuple[float, ndarray, bool] | None:
    """The grid with one more line on one side, its contrast first; None if no such line is seen."""
    pad = [(0, 0), (0, 0), (0, 0)]
    pad[axis] = (1, 0) if is_before else (0, 1)
    wide = np.pad(grid, pad, constant_values=np.nan)
    rows, columns = wide.shape[:2]
    around = np.stack(
        np.meshgrid(np.arange(-1, columns + 1), np.arange(-1, rows + 1)), axis=-1
    )  # a margin for the squares
    places = around.reshape(-1, 2).astype(float)
    known = np.pad(wide, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)
    step = np.linalg.norm(np.diff(grid, axis=0), axis=-1)
    image = expected_points(places, known.reshape(-1, 2), float(np.nanmedian(step))).reshape(known.shape)
    if not np.isfinite(image).all():
        return None
    colour = _contrast(smooth, image)  # (rows, columns)
    parity = 1 - 2 * (np.add.outer(np.arange(rows), np.arange(columns)) % 2)
    own = np.isfinite(wide[..., 0])
    typical = float(np.median((colour * parity)[own]))
    line = np.zeros((rows, columns), bool)
    line[(0 if is_before else -1,) if axis == 0 else (slice(None), 0 if is_before else -1)] = True
    relative = (colour * parity)[line] / typical if typical else np.zeros(int(line.sum()))
    if not np.mean(relative > MIN_CONTRAST) >= MIN_SHARE_IN_COLOUR:
        return None
    expected = image[1:-1, 1:-1][line]
    reach = grid_reach(image)[1:-1, 1:-1][line]
    fitted = fit_corners(grey, expected, reach)
    is_near = np.linalg.norm(fitted.points_px - expected, axis=1) < MAX_OFF * grid_spacing(image)[1:-1, 1:-1][line]
    is_good: Bool[ndarray, "n"] = is_near & (fitted.misfit < MAX_MISFIT)
    if is_good.mean() < MIN_SHARE_FITTED:
        return None
    wide[line] = np.where(is_good[:, None], fitted.points_px, expected)
    return float(np.median(relative)), wide, is_before


def _contrast(smooth: Float32[ndarray, "h w"], image: Float[ndarray, "r c 2"]) -> Float[ndarray, "rows columns"]:
    """Signed contrast of the four squares about every inner point; 0 outside the image."""
    centres = 0.25 * (image[:-1, :-1] + image[1:, :-1] + image[:-1, 1:] + image[1:, 1:])
    height, width = smooth.shape
    inside = ((centres >= 0) & (centres <= [width - 1, height - 1])).all(axis=-1)
    light = np.where(inside, images.sample(smooth, np.where(inside[..., None], centres, 0.0)), np.nan)
    return np.nan_to_num(0.5 * (light[:-1, :-1] + light[1:, 1:] - light[:-1, 1:] - light[1:, :-1]))
