"""Round spots by a maximum-likelihood fit of a blurred ellipse to the raw image, each with its covariance.

Model and fit are :mod:`binocal.kernels.ellipse_fits`'s (``ellipse_fit.hpp``); the noise, and the light's slope, are estimated from all
of an image's spots together as they are from its corners (``corner_pool.hpp``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.detection.measuring.centroids import centre_covariance, refine_centres
from binocal.kernels.corner_fits import pool_corners
from binocal.kernels.ellipse_fits import fit_ellipses
from binocal.shapes import Float

GAP_SHARE = 0.5  # of the gap to the next spot: half of it is this one's


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredSpots:
    """Centres of the spots' outlines in the image, their covariances and the outlines' areas; NaN where a spot shows no ellipse."""

    centres_px: Float[ndarray, "n 2"]
    covariance_px2: Float[ndarray, "n 2 2"]
    areas_px2: Float[ndarray, "n"]
    shape_residuals: Float[ndarray, "n"]
    """What of the image about each outline no ellipse explains, alike on opposite sides, over the contrast; NaN where none was fitted.

    Noise is not in it (half of it is odd about the centre): 0.01 of discs, 0.15 of squares.
    """


def measure_spots(
    grey: ndarray,
    centres_px: Float[ndarray, "n 2"],
    axes_px: Float[ndarray, "n 2"],
    angles_rad: Float[ndarray, "n"],
    *,
    is_dark: bool,
    holes: Float[ndarray, "n"] | None = None,
) -> MeasuredSpots:
    """Spots of one polarity from their rough outlines, those of one image together; NaN where a start is NaN.

    ``holes`` are the diameters of rings' holes over the rings' own, 0 of discs: the outer outlines are measured.

    Where the ellipse cannot be fitted (a radius below the blur's, a spot at the border) the centroid of the spot's light is
    taken, with its own, larger, covariance; but not where the fitted ellipse contradicts the image (covered, glare).
    """
    gap = GAP_SHARE * _gaps(centres_px, axes_px, angles_rad)
    inward = np.full(len(gap), np.inf)
    if holes is not None:
        inward[holes > 0] = (GAP_SHARE * (1 - holes) * axes_px.min(axis=1))[holes > 0]
    fits = fit_ellipses(grey, centres_px, axes_px, angles_rad, gap, inward)
    pooled = pool_corners(fits.centres, are_corners=False)
    is_open = ~np.isfinite(pooled.misfit) & np.isfinite(centres_px[:, 0])
    is_open |= np.isfinite(pooled.misfit) & ((fits.centres.contrast_dn > 0) != is_dark)
    centres, covariance, areas = pooled.points_px.copy(), pooled.covariance_px2.copy(), fits.areas_px2.copy()
    areas[np.isnan(centres[:, 0])] = np.nan
    if is_open.any():
        centroids, variance, area = refine_centres(
            grey, centres_px[is_open], axes_px[is_open], angles_rad[is_open], is_dark=is_dark
        )
        centres[is_open], areas[is_open] = centroids, area
        covariance[is_open] = centre_covariance(variance, centroids)
    even = np.sqrt(np.maximum(fits.centres.variance - fits.centres.odd_variance, 0.0))
    return MeasuredSpots(centres, covariance, areas, even / np.abs(fits.centres.contrast_dn))


def _gaps(
    centres_px: Float[ndarray, "n 2"], axes_px: Float[ndarray, "n 2"], angles_rad: Float[ndarray, "n"]
) -> Float[ndarray, "n"]:
    """From each ellipse's outline to the nearest other one's, along the line of their centres."""
    way = centres_px[None] - centres_px[:, None]
    apart = np.hypot(way[..., 0], way[..., 1])
    turn = np.arctan2(way[..., 1], way[..., 0]) - angles_rad[:, None]
    radius = 1 / np.hypot(np.cos(turn) / axes_px[:, None, 0], np.sin(turn) / axes_px[:, None, 1])
    gap = apart - radius - radius.T  # an ellipse's radius is the same both ways
    np.fill_diagonal(gap, np.inf)
    return np.where(np.isfinite(gap), gap, np.inf).min(axis=1, initial=np.inf)
