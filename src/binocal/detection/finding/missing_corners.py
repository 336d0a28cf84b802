"""Corners that a search has missed where a board's known ones put them, looked for in small parts of the full image.

Half of a large image shows nine corners in ten of most boards; the rest are often the most foreshortened. The search of the
whole full image would cost four times as much as that of a half, those parts of it hardly anything.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy import ndarray

from binocal.detection.finding.crossings import INSIDE_PX, expected_at, grow_known
from binocal.detection.finding.marker_grid import MarkerGrid
from binocal.detection.finding.xcorners import PEAK_REACH_PER_RADIUS, SaddleImage
from binocal.kernels import images
from binocal.kernels.marker_grids import FieldLens
from binocal.shapes import Bool, Float, UInt8

BLUR_PX, RADIUS_PX = 1.0, 3.2  # as the full image is searched
LEAST_RESPONSE = 0.1  # of a saddle of the least contrast of an X-corner; the lattice bears it out
REACH_OF_KNOWN = 3  # lines about a missing corner: the known ones there are in its part, for they say where it is
RIM_PX = 10  # about a part: what the filter and the sectors read
MOST_SADDLES = 1200


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
        is_missing = ~is_known & ((expected > 0.5 * INSIDE_PX) & (expected < size_wh - 1 - 0.5 * INSIDE_PX)).all(
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
    places = np.r_[expected_px[is_missing], known_px[is_told]]
    low = np.maximum(np.floor(places.min(axis=0)).astype(int) - RIM_PX, 0)
    high = np.minimum(np.ceil(places.max(axis=0)).astype(int) + RIM_PX + 1, image.shape[::-1])
    (x0, y0), (x1, y1) = low, high
    if min(x1 - x0, y1 - y0) < 2 * RIM_PX:
        return known_px
    smooth = cv2.GaussianBlur(image[y0:y1, x0:x1].astype(np.float32), (0, 0), BLUR_PX)
    saddles = SaddleImage.of(smooth, RADIUS_PX)
    peaks = images.find_peaks(
        saddles.response, max(1, round(PEAK_REACH_PER_RADIUS * RADIUS_PX)), 2, LEAST_RESPONSE, MOST_SADDLES
    )
    # What lies beside the part has no grey values in it.
    told = np.where(is_told[..., None], known_px - low, np.nan)
    part_lens = FieldLens(lens.cx - x0, lens.cy - y0, lens.f_px)
    grown = grow_known(grid, told, part_lens, is_inverted, (saddles, 1.0, peaks))
    is_new = np.isfinite(grown[..., 0]) & ~is_told & is_near & ~np.isfinite(known_px[..., 0])
    return np.where(is_new[..., None], grown + low, known_px)
