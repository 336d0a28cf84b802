"""Corners by a maximum-likelihood fit of a blurred saddle to the raw image, each with its covariance.

The model and the fit are :mod:`binocal.kernels.corner_fits`'s (``corner_fit.hpp``, ``board_corners.hpp`` and ``corner_pool.hpp`` state
them): each corner on its own first, then along edges bent as the image's lens bends them, then all of an image as one
estimate, for they share the pixels' noise and the light's slope.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.kernels import corner_fits
from binocal.shapes import Float


@dataclass(frozen=True, slots=True, eq=False)
class FittedCorners:
    """Corners and covariances, NaN where no saddle could be fitted.

    ``cross_covariance_px2`` is the sum of a corner's covariances with the image's other corners: neighbours on one edge
    share its pixels where squares are narrower than the discs are wide, 28 px.

    ``misfit`` is the variance of the residuals' odd part over the image's noise: 1 where the model holds.
    ``blur_px`` are the two edges' blurs (Gaussian sigma, pixel integration taken out), ``contrast_dn`` bright minus dark.
    """

    points_px: Float[ndarray, "n 2"]
    covariance_px2: Float[ndarray, "n 2 2"]
    cross_covariance_px2: Float[ndarray, "n 2 2"]
    noise_dn: float
    misfit: Float[ndarray, "n"]
    blur_px: Float[ndarray, "n 2"]
    contrast_dn: Float[ndarray, "n"]


def fit_corners(
    grey: ndarray,
    points_px: Float[ndarray, "n 2"],
    reach_px: Float[ndarray, "n"],
    strip_px: Float[ndarray, "n"] | None = None,
    *,
    board: corner_fits.BoardPlaces | None = None,
) -> FittedCorners:
    """Fit the corner model around each point of an image (h, w), uint8, uint16 or float32.

    ``reach_px`` is the distance to the nearest edge that is not the corner's own: the fit takes a disc of 0.85 of it, at
    most 14 px and at least 2.5, less where the blur carries that edge in. ``strip_px`` limits it to bands along the
    corner's edges, where squares are not plain. Starts must lie within half the reach (at least 1.5 px); a corner
    whose disc leaves the image, or that shows no saddle, is NaN. With the corners' places on the board the edges are fitted
    as the curves that the image's own lens makes of them.
    """
    points_px = np.asarray(points_px, dtype=float)
    strip = np.full(len(points_px), np.inf) if strip_px is None else strip_px
    fits = corner_fits.fit_corners(grey, points_px, reach_px, strip, board=board)
    pooled = corner_fits.pool_corners(fits)
    blur = np.sqrt(np.maximum(fits.blur_px**2 - 1 / 12, 0))
    return FittedCorners(
        pooled.points_px,
        pooled.covariance_px2,
        pooled.cross_covariance_px2,
        pooled.noise_dn,
        pooled.misfit,
        blur,
        np.abs(fits.contrast_dn),
    )
