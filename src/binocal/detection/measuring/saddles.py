"""Corners to a tenth of a pixel from starts a few pixels away: the saddle of a quadratic."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy import ndarray

from binocal.kernels import images
from binocal.shapes import Float, UInt8


def localize_saddles(
    image: UInt8[ndarray, "h w"], points_px: Float[ndarray, "n 2"], spacing_px: Float[ndarray, "n"]
) -> Float[ndarray, "n 2"]:
    """Points moved to the saddle of the quadratic that fits the grey levels around them best, to about 0.1 px.

    A point stays where the fit is no saddle, or moves by more than its window (a third of the smaller spacings, 2 to 8 px).
    NaN stays NaN. Source: Lucchese & Mitra 2002, "Using saddle points for subpixel feature detection".
    """
    points = np.asarray(points_px, dtype=float).copy()
    index = np.nonzero(np.isfinite(points[:, 0]) & np.isfinite(spacing_px))[0]
    if len(index) == 0:
        return points
    reach = int(np.clip(np.sort(spacing_px[index])[len(index) // 5] / 3, 2, 8))
    fit = _quadratic_fit(reach)
    points[index] = images.localize_saddles(image, points[index], fit, reach)
    return points


@lru_cache(maxsize=16)
def _quadratic_fit(reach: int) -> Float[ndarray, "5 k2"]:
    """The matrix from a window's pixels to the coefficients of x^2, xy, y^2, x and y."""
    step = np.arange(-reach, reach + 1)
    y, x = (axis.ravel().astype(float) for axis in np.meshgrid(step, step, indexing="ij"))
    weight = np.exp(-(x**2 + y**2) / reach**2)
    basis = np.stack([x * x, x * y, y * y, x, y, np.ones_like(x)], axis=-1)
    return np.linalg.solve(basis.T @ (weight[:, None] * basis), basis.T * weight)[:5]
