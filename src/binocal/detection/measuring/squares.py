"""Corners of printed squares by a maximum-likelihood fit of blurred quadrilaterals to the raw image, each with its covariance.

Model and fit are :mod:`binocal.kernels.square_fits`'s (``square_fit.hpp``); the noise, and the light's slope, are estimated from all
of an image's squares together as they are from its corners (``corner_pool.hpp``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.detection.measuring.square_spread import measure_spread, outward_steps
from binocal.kernels.corner_fits import pool_corners
from binocal.kernels.image_lens import ImageLens, LensFitOptions, fit_image_lens
from binocal.kernels.square_fits import fit_squares
from binocal.shapes import Float

GAP_SHARE = 0.5  # of the gap to the next square: half of it is this one's
MOST_SPREAD = 0.7  # blurs: what a tone curve moves edges by, of 2.2 0.35; more is a board of other lengths
REACH_PX, REACH_PER_SIDE = 4.0, 0.2  # that a corner may go from where it was found
_ALONG = np.array([0.25, 0.5, 0.75])  # of an edge, where its bow is taken
_NEXT = [1, 2, 3, 0]


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredSquares:
    """Corners, clockwise as printed from the top left, NaN where a square could not be measured, and their covariances.

    ``spread_px`` is by how much the squares' sides seemed to lie outward of the board's; it is taken out where a tone curve explains
    it (``MOST_SPREAD``), else they are of other lengths than the board's.
    """

    corners_px: Float[ndarray, "n 4 2"]
    covariance_px2: Float[ndarray, "n 4 2 2"]
    spread_px: float = 0.0
    has_other_lengths: bool = False


def measure_squares(
    grey: ndarray,
    corners_px: Float[ndarray, "n 4 2"],
    corners_xy: Float[ndarray, "n 4 2"],
    gap_xy: float,
    options: LensFitOptions,
    *,
    is_dark: bool,
) -> MeasuredSquares:
    """Squares of one polarity from their rough corners, those of one image together; NaN where a start is NaN.

    ``corners_xy`` are the same corners on the board, clockwise as printed, and ``gap_xy`` the gap between squares in the same unit.
    The image's own lens, fitted with ``options`` to all corners together, says how its edges are bent.
    """
    size_wh = grey.shape[1], grey.shape[0]
    points, covariance, blur_px = corners_px, np.full((*corners_px.shape, 2), np.nan), 1.0
    for is_rough in (True, False):
        lens = _fit_lens(points, corners_xy, gap_xy, size_wh, options)
        if lens is None:
            return MeasuredSquares(np.full(corners_px.shape, np.nan), covariance)
        bows, outward = _edges(lens, corners_xy)
        side = np.linalg.norm(np.roll(points, -1, axis=1) - points, axis=-1).min(axis=1)
        reach = np.maximum(REACH_PX, REACH_PER_SIDE * side)
        fits = fit_squares(grey, points, bows, GAP_SHARE * outward, reach, blur_px=blur_px, is_rough=is_rough)
        pooled = pool_corners(fits.corners, are_corners=False)
        is_sound = np.isfinite(pooled.points_px[:, 0]) & ((fits.corners.contrast_dn < 0) == is_dark)
        is_sound = is_sound.reshape(-1, 4).all(axis=1)
        if not is_sound.any():
            return MeasuredSquares(np.full(corners_px.shape, np.nan), covariance)
        points = np.where(is_sound[:, None, None], pooled.points_px.reshape(-1, 4, 2), np.nan)
        blur_px = float(np.nanmedian(fits.corners.blur_px))
    covariance = np.where(np.isfinite(points)[..., None], pooled.covariance_px2.reshape(-1, 4, 2, 2), np.nan)
    spread_px = measure_spread(points, corners_xy, size_wh, replace(options, is_robust=False))
    has_other_lengths = abs(spread_px) >= MOST_SPREAD * blur_px
    if np.isfinite(spread_px) and not has_other_lengths:
        points = points - spread_px * outward_steps(points)
    return MeasuredSquares(points, covariance, spread_px, has_other_lengths)


def _fit_lens(
    corners_px: Float[ndarray, "n 4 2"],
    corners_xy: Float[ndarray, "n 4 2"],
    gap_xy: float,
    size_wh: tuple[int, int],
    options: LensFitOptions,
) -> ImageLens | None:
    """The image's lens with the images of all corners, of three places along each edge, and of one beyond its middle by the gap."""
    points, xy = corners_px.reshape(-1, 2), corners_xy.reshape(-1, 2)
    seen = np.isfinite(points[:, 0])
    begins, ends = corners_xy, corners_xy[:, _NEXT]
    along = begins[:, :, None] + _ALONG[:, None] * (ends - begins)[:, :, None]
    way = ends - begins
    away = np.stack([way[..., 1], -way[..., 0]], axis=-1) / np.linalg.norm(way, axis=-1, keepdims=True)
    beyond = along[:, :, 1] + gap_xy * away
    places = np.concatenate([corners_xy[:, :, None], along, beyond[:, :, None]], axis=2).reshape(-1, 2)
    return fit_image_lens(xy[seen], points[seen], size_wh, options, places_xy=places)


def _edges(
    lens: ImageLens, corners_xy: Float[ndarray, "n 4 2"]
) -> tuple[Float[ndarray, "n 4 3"], Float[ndarray, "n 4"]]:
    """The bows of each edge, as :func:`binocal.kernels.square_fits.fit_squares` takes them, and how far beyond it the next square lies."""
    images = lens.images_px.reshape(len(corners_xy), 4, 5, 2)
    begins, along, beyond = images[:, :, 0], images[:, :, 1:4], images[:, :, 4]
    chord = begins[:, _NEXT] - begins
    length = np.linalg.norm(chord, axis=-1)
    t = chord / length[..., None]
    off = along - begins[:, :, None]
    share = np.einsum("nekx,nex->nek", off, t) / length[..., None]
    inward = t[:, :, None, 0] * off[..., 1] - t[:, :, None, 1] * off[..., 0]
    rows = (share * (1 - share))[..., None] * np.stack([np.ones_like(share), share, share**2], axis=-1)
    is_known = np.isfinite(rows).all(axis=(-1, -2)) & np.isfinite(inward).all(axis=-1)
    bows = np.zeros((*is_known.shape, 3))
    bows[is_known] = np.linalg.solve(rows[is_known], inward[is_known][..., None])[..., 0]
    outward = np.linalg.norm(beyond - along[:, :, 1], axis=-1)
    return bows, np.where(np.isfinite(outward), outward, length)
