"""Do the squares and corners of a grid look like a chessboard's?"""

from __future__ import annotations

import cv2
import numpy as np
from numpy import ndarray

from binocal.detection.finding.grid import grid_spacing
from binocal.detection.finding.search import SearchLevel
from binocal.detection.finding.xcorners import WEAK_CONTRAST_DN, WEAK_UNLIKENESS, read_rings
from binocal.kernels import images
from binocal.shapes import Bool, Float, UInt8

MAX_SHARE_DARK = 0.25  # of a bright square's samples, in the median square: a marker fills more than half of its square
SQUARE_PX = 24.0  # at which noise is averaged and a marker's border, a tenth of the square, is still seen
LEAST_SQUARE_PX = (
    20.0  # below it markers look like grey squares: ChArUco boards were told at 20 px in every rendered case
)
MOST_LOOKED_AT = 5  # corners along an axis
FAINT_RATIO = 3.0  # the typical corner's contrast over a covered one's; a shadow dims brightness and contrast alike
RING_PER_SPACING = 0.2  # of the typical spacing, within RING_LIMITS_PX: well within the squares about the corner
RING_LIMITS_PX = (2.5, 8.0)
MIN_SHARE_CLEAR = 0.5  # of the corners must look like X-corners before those that do not are called covered


def are_squares_patterned(smooth: ndarray, grid: Float[ndarray, "rows columns 2"], is_dark_first: bool) -> bool:
    """Whether the bright squares are not plain: a marker fills most of its square with dark, shading only tints it.

    Each bright square is compared with the dark squares beside it, for shadows may lie on the board.
    """
    corners = np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]], axis=2)  # (rows, columns, 4, 2)
    share = np.linspace(0.2, 0.8, 7)
    v, u = (axis.ravel() for axis in np.meshgrid(share, share, indexing="ij"))
    weights = np.stack([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v], axis=-1)
    places = np.tensordot(corners, weights, axes=(2, 1)).transpose(0, 1, 3, 2)  # (rows, columns, samples, 2)
    values = images.sample(smooth, places)
    rows, columns = values.shape[:2]
    is_whole = np.isfinite(corners[..., 0]).all(axis=2)
    is_bright = ((np.add.outer(np.arange(rows), np.arange(columns)) % 2 == 1) ^ (not is_dark_first)) & is_whole
    middle = np.where(is_whole & ~is_bright, values.mean(axis=-1), np.nan)
    around = np.full((rows + 2, columns + 2), np.nan)
    around[1:-1, 1:-1] = middle
    dark = np.fmax(np.fmax(around[:-2, 1:-1], around[2:, 1:-1]), np.fmax(around[1:-1, :-2], around[1:-1, 2:]))
    usable = is_bright & np.isfinite(dark)
    if not usable.any():
        return False
    values, dark = values[usable], dark[usable]
    share_dark = np.mean(values < 0.5 * (dark + values.max(axis=-1))[:, None], axis=-1)
    return bool(np.median(share_dark) > MAX_SHARE_DARK)


def is_board_patterned(
    image: UInt8[ndarray, "h w"], grid_px: Float[ndarray, "rows columns 2"], spacing_px: float
) -> bool:
    """As :func:`are_squares_patterned`, of a board in the image itself, made smaller to squares of 24 px.

    In the coarse image of a search markers of 20 px are blurred away. Which squares are dark is taken from their middles; some in
    the middle of the board are enough.
    """
    rows, columns = (
        slice(max(n - MOST_LOOKED_AT, 0) // 2, max(n - MOST_LOOKED_AT, 0) // 2 + MOST_LOOKED_AT)
        for n in grid_px.shape[:2]
    )
    if np.isfinite(grid_px[rows, columns, 0]).sum() > MOST_LOOKED_AT**2 / 2:
        grid_px = grid_px[rows, columns]
    low = np.maximum(np.nanmin(grid_px, axis=(0, 1)).astype(int), 0)
    high = np.nanmax(grid_px, axis=(0, 1)).astype(int) + 2
    part = image[low[1] : high[1], low[0] : high[0]]
    scale = min(1.0, SQUARE_PX / spacing_px)
    small = cv2.resize(part, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    smooth = cv2.GaussianBlur(small.astype(np.float32), (0, 0), 0.8)
    grid = (grid_px - low + 0.5) * (np.array(small.shape[::-1]) / part.shape[::-1]) - 0.5
    middles = 0.25 * (grid[:-1, :-1] + grid[:-1, 1:] + grid[1:, 1:] + grid[1:, :-1])
    is_whole = np.isfinite(middles[..., 0])
    values, is_even = images.sample(smooth, middles), np.add.outer(*map(np.arange, middles.shape[:2])) % 2 == 0
    even, odd = values[is_even & is_whole], values[~is_even & is_whole]
    is_dark_first = bool(len(even) and len(odd) and np.median(even) < np.median(odd))
    return are_squares_patterned(smooth, grid, is_dark_first)


def are_faint(
    level: SearchLevel, points_px: Float[ndarray, "n 2"], grid_px: Float[ndarray, "rows columns 2"]
) -> Bool[ndarray, "n"]:
    """Which points of the image do not look like the others, likely covered: no X-corner, or one with a third of their contrast.

    Contrast is taken absolutely and relative to the brightness about the corner, because a shadow dims both. Says
    nothing (all False) where most points fail: an image too blurred for rings of this size is not covered everywhere.
    """
    smooth, points = level.saddles.smooth, level.from_image(points_px)
    spacing = grid_spacing(level.from_image(grid_px)).ravel()
    seen = np.isfinite(points[:, 0])
    faint = np.zeros(len(points), bool)
    if not seen.any():
        return faint
    radius = float(np.clip(RING_PER_SPACING * np.median(spacing[seen]), *RING_LIMITS_PX))
    is_corner, _, contrast = read_rings(
        smooth, points[seen], radius, min_contrast_dn=WEAK_CONTRAST_DN, max_unlikeness=WEAK_UNLIKENESS
    )
    if is_corner.mean() > MIN_SHARE_CLEAR:
        relative = contrast / (images.sample(smooth, points[seen]) + 1)
        faint[seen] = ~is_corner
        faint[seen] |= (contrast < np.median(contrast[is_corner]) / FAINT_RATIO) & (
            relative < np.median(relative[is_corner]) / FAINT_RATIO
        )
    return faint
