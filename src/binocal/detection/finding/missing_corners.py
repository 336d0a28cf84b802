"""Corners that a search has missed where a board's known ones put them, looked for in small parts of the full image.

Half of a large image shows nine corners in ten of most boards; the rest are often the most foreshortened. The search of the
whole full image would cost four times as much as that of a half, those parts of it hardly anything.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy import ndarray

from binocal.detection.finding.crossings import expected_at, grow_known
from binocal.detection.finding.marker_grid import MarkerGrid
from binocal.detection.finding.xcorners import PEAK_REACH_PER_RADIUS
from binocal.kernels import images
from binocal.kernels.marker_grids import FieldLens
from binocal.shapes import Bool, Float, Int, UInt8

BLUR_PX, RADIUS_PX = 1.0, 3.2  # as the full image is searched
LEAST_RESPONSE = 0.1  # of a saddle of the least contrast of an X-corner; the lattice bears it out
REACH_OF_KNOWN = 2  # lines about a missing corner: the known ones there are in its part, for they say where it is
RIM_PX = 10  # about a part: what the filter and the sectors read
OFF_PX, OFF_STEPS = 8.0, 0.3  # about where missing corners should be: there the saddles are looked for
LEAST_INSIDE_PX = 4.5  # nearer to the image's border no corner is measured
MOST_SADDLES = 1200
PEAK_MARGIN_PX = 2


def grow_missing(
    image: UInt8[ndarray, "h w"],
    grid: MarkerGrid,
    known_px: Float[ndarray, "rows columns 2"],
    lens: FieldLens,
    *,
    is_inverted: bool,
) -> Float[ndarray, "rows columns 2"]:
    """The known corners with those that parts of the full image have where a corner should be in view and is not known."""
    is_known = np.isfinite(known_px[..., 0])
    expected = expected_at(grid, known_px, lens)
    with np.errstate(invalid="ignore"):
        size_wh = np.array(image.shape[::-1])
        is_missing = ~is_known & ((expected > LEAST_INSIDE_PX) & (expected < size_wh - 1 - LEAST_INSIDE_PX)).all(
            axis=-1
        )
    if not is_missing.any():
        return known_px
    n_parts, part = cv2.connectedComponents(is_missing.astype(np.uint8), connectivity=8)
    grown = known_px
    for k in range(1, n_parts):
        grown = _grow_part(image, grid, grown, lens, expected, part == k, is_inverted=is_inverted)
    return grown


def _grow_part(
    image: UInt8[ndarray, "h w"],
    grid: MarkerGrid,
    known_px: Float[ndarray, "rows columns 2"],
    lens: FieldLens,
    expected_px: Float[ndarray, "rows columns 2"],
    is_missing: Bool[ndarray, "rows columns"],
    *,
    is_inverted: bool,
) -> Float[ndarray, "rows columns 2"]:
    reach = 2 * REACH_OF_KNOWN + 1
    is_near = cv2.dilate(is_missing.astype(np.uint8), np.ones((reach, reach), np.uint8)) > 0
    is_told = is_near & np.isfinite(known_px[..., 0])
    wanted, told = expected_px[is_missing], known_px[is_told]
    low, high = _box(np.r_[wanted, told], RIM_PX, image.shape)
    if (high - low < 2 * RIM_PX).any() or not is_told.any():
        return known_px
    smooth = cv2.GaussianBlur(image[low[1] : high[1], low[0] : high[0]].astype(np.float32), (0, 0), BLUR_PX)
    step = np.sqrt(((wanted[:, None] - told) ** 2).sum(axis=-1)).min(axis=1).max()
    first, last = _box(wanted - low, max(OFF_PX, OFF_STEPS * step) + PEAK_MARGIN_PX, smooth.shape)
    part = np.ascontiguousarray(smooth[first[1] : last[1], first[0] : last[0]])
    if min(part.shape) < 3:
        return known_px
    peaks = images.find_peaks(
        images.saddle_response(part),
        max(1, round(PEAK_REACH_PER_RADIUS * RADIUS_PX)),
        PEAK_MARGIN_PX,
        LEAST_RESPONSE,
        MOST_SADDLES,
    )
    # What lies beside the part has no grey values in it.
    near = np.where(is_told[..., None], known_px - low, np.nan)
    part_lens = FieldLens(lens.cx - low[0], lens.cy - low[1], lens.f_px)
    grown = grow_known(grid, near, part_lens, is_inverted, (smooth, 1.0, peaks + first))
    is_new = np.isfinite(grown[..., 0]) & is_near & ~np.isfinite(known_px[..., 0])
    return np.where(is_new[..., None], grown + low, known_px)


def _box(
    places: Float[ndarray, "n 2"], rim_px: float, shape: tuple[int, ...]
) -> tuple[Int[ndarray, "2"], Int[ndarray, "2"]]:
    """First and last (exclusive) column and row of the pixels about some places, in an image of ``shape``."""
    low = np.maximum(np.floor(places.min(axis=0) - rim_px), 0).astype(int)
    return low, np.minimum(np.ceil(places.max(axis=0) + rim_px).astype(int) + 1, shape[::-1])
