"""A lattice of fewer lines than the board, grown line by line to the board that it is a part of.

Links follow edges at every corner and fail first where squares are seen so obliquely that their corners hardly look like
one. The whole lattice predicts better where the next line must lie: it is looked for there, and nowhere else.
"""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.detection.finding.grid import SIDES, add_line, border_line, grid_reach, grid_spacing, is_before
from binocal.detection.finding.planes import expected_points
from binocal.detection.measuring.corner_fit import fit_corners
from binocal.kernels import images
from binocal.shapes import Bool, Float, Float32

MIN_LINES, MIN_CORNERS = 3, 12
# Of the lattice's own; on the line of the board's outer border, where every second square is margin, 0.5 is seen.
MIN_CONTRAST = 0.6
MIN_SHARE_IN_COLOUR = 0.8  # of a line's corners
MIN_SHARE_FITTED = 0.5
MAX_MISFIT = 3.0
MAX_OFF = 0.25  # spacings from where the lattice puts it


def grow(
    grey: ndarray, smooth: Float32[ndarray, "h w"], points_px: Float[ndarray, "rows columns 2"], size: tuple[int, int]
) -> tuple[Float[ndarray, "rows2 columns2 2"], int] | None:
    """The grid grown to ``size`` (the larger number first), and how many lines came before its first corner.

    ``grey`` is the image and ``smooth`` the same, smoothed; points in its pixels. None where the image does not bear it out.
    """
    grid, n_before = points_px, 0
    while (max(grid.shape[:2]), min(grid.shape[:2])) != size:
        rows, columns = grid.shape[:2]
        if min(rows, columns) < MIN_LINES or np.isfinite(grid[..., 0]).sum() < MIN_CORNERS:
            return None
        wider = [
            (_with_line(grey, smooth, grid, side), side)
            for side in SIDES
            if _fits(rows + (side < 2), columns + (side >= 2), size)
        ]
        grown = [(*line, side) for line, side in wider if line is not None]
        if not grown:
            return None
        _, grid, side = max(grown, key=lambda candidate: candidate[0])
        n_before += is_before(side)
    return grid, n_before


def _fits(rows: int, columns: int, size: tuple[int, int]) -> bool:
    return max(rows, columns) <= size[0] and min(rows, columns) <= size[1]


def _with_line(
    grey: ndarray, smooth: Float32[ndarray, "h w"], grid: Float[ndarray, "rows columns 2"], side: int
) -> tuple[float, Float[ndarray, "rows2 columns2 2"]] | None:
    """The contrast of the next line on a side, and the grid with it; None if no such line is seen."""
    wide = add_line(grid, side)
    predicted = _predict_with_margin(grid, wide, (smooth.shape[1], smooth.shape[0]))
    if not np.isfinite(predicted).all():
        return None
    line = border_line(side)
    relative = _relative_contrast(smooth, predicted, np.isfinite(wide[..., 0]))[line]
    if not np.mean(relative > MIN_CONTRAST) >= MIN_SHARE_IN_COLOUR:
        return None
    expected = predicted[1:-1, 1:-1][line]
    reach, spacing = grid_reach(predicted)[1:-1, 1:-1][line], grid_spacing(predicted)[1:-1, 1:-1][line]
    fitted = fit_corners(grey, expected, reach)
    is_near = np.linalg.norm(fitted.points_px - expected, axis=1) < MAX_OFF * spacing
    is_good: Bool[ndarray, "n"] = is_near & (fitted.misfit < MAX_MISFIT)
    if is_good.mean() < MIN_SHARE_FITTED:
        return None
    wide[line] = np.where(is_good[:, None], fitted.points_px, expected)
    return float(np.median(relative)), wide


def _predict_with_margin(
    grid: Float[ndarray, "rows columns 2"], wide: Float[ndarray, "rows2 columns2 2"], size_wh: tuple[int, int]
) -> Float[ndarray, "rows3 columns3 2"]:
    """Where the corners of the wider grid should be by the smooth map through those seen, and a margin of one cell more."""
    rows, columns = wide.shape[:2]
    around = np.stack(np.meshgrid(np.arange(-1, columns + 1), np.arange(-1, rows + 1)), axis=-1)
    known = np.pad(wide, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)
    step = float(np.nanmedian(np.linalg.norm(np.diff(grid, axis=0), axis=-1)))
    places = around.reshape(-1, 2).astype(float)
    return expected_points(places, known.reshape(-1, 2), step, size_wh).reshape(known.shape)


def _relative_contrast(
    smooth: Float32[ndarray, "h w"], predicted: Float[ndarray, "rows3 columns3 2"], own: Bool[ndarray, "rows2 columns2"]
) -> Float[ndarray, "rows2 columns2"]:
    """Contrast of every corner over that of a typical one of the grid's ``own``, negative where colours are swapped."""
    contrast = _contrast(smooth, predicted)
    rows, columns = contrast.shape
    colour = contrast * (1 - 2 * (np.add.outer(np.arange(rows), np.arange(columns)) % 2))
    typical = float(np.median(colour[own]))
    return colour / typical if typical else np.zeros_like(colour)


def _contrast(
    smooth: Float32[ndarray, "h w"], grid: Float[ndarray, "rows3 columns3 2"]
) -> Float[ndarray, "rows2 columns2"]:
    """Signed contrast of the four squares about every inner point of a grid; 0 outside the image."""
    centres = 0.25 * (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:])
    height, width = smooth.shape
    inside = np.all((centres >= 0) & (centres <= [width - 1, height - 1]), axis=-1)
    light = np.where(inside, images.sample(smooth, np.where(inside[..., None], centres, 0.0)), np.nan)
    return np.nan_to_num(0.5 * (light[:-1, :-1] + light[1:, 1:] - light[:-1, 1:] - light[1:, :-1]))
