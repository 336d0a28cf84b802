"""Robust kernels on squared residual lengths, and the scale they are measured in.

A residual here is the 2-vector of one corner; ``r2`` is its squared length. With Gaussian noise of standard deviation
sigma per coordinate its length is Rayleigh distributed, so the median length is 1.1774 sigma.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy import ndarray

from binocal.shapes import Bool, Float

Kernel = Literal["squared", "cauchy", "hampel", "geman", "tukey"]
"""The last two are for matches, of which many may be wrong; the compiled board equations do not have them."""

MEDIAN_OF_RAYLEIGH = 1.1774100225154747  # sqrt(2 ln 2)
SCALE_FLOOR_PX = 1e-3  # no corner is measured better; keeps exact input from being cut by its own rounding errors

HAMPEL_FLAT, HAMPEL_DROP, HAMPEL_END = 3.5, 4.5, 7.0
"""Hampel's three corners in sigmas.

A corner of Gaussian noise lies beyond 3.5 sigma once in 460, so 99.9 % of the efficiency stays.
"""


TUKEY_END = 4.685
"""Tukey's biweight in sigmas: 95 % of the efficiency under Gaussian noise."""

HAMPEL_LIMIT = HAMPEL_FLAT * (0.5 * (HAMPEL_DROP + HAMPEL_END) - 0.5 * HAMPEL_FLAT)
"""Cost of a corner without weight, in squared scales."""


def weights(
    r2: Float[ndarray, "*batch"], scale_px: Float[ndarray, "*#batch"], kernel: Kernel
) -> Float[ndarray, "*batch"]:
    """IRLS weight psi(r) / r of each residual; 1 at 0.

    Source: Hampel 1974, "The influence curve and its role in robust estimation" (three-part redescending); Cauchy with
    c = scale; Geman & McClure 1985 with c = scale; Beaton & Tukey 1974 (biweight).
    """
    if kernel == "squared":
        return np.ones_like(r2)
    q2 = r2 / (scale_px * scale_px)
    if kernel == "cauchy":
        return 1 / (1 + q2)
    if kernel == "geman":
        return 1 / (1 + q2) ** 2
    if kernel == "tukey":
        return np.maximum(1 - q2 / TUKEY_END**2, 0) ** 2
    w = np.ones_like(q2)
    beyond = np.nonzero(q2 > HAMPEL_FLAT**2)
    q = np.sqrt(q2[beyond])
    fall = np.clip((HAMPEL_END - q) / (HAMPEL_END - HAMPEL_DROP), 0, 1)
    w[beyond] = HAMPEL_FLAT * fall / q
    return w


def carries_weight(
    r2: Float[ndarray, "*batch"], scale_px: Float[ndarray, "*#batch"], kernel: Kernel
) -> Bool[ndarray, "*batch"]:
    """Whether a residual's weight is above 0."""
    ends = {"hampel": HAMPEL_END, "tukey": TUKEY_END}
    return r2 < (ends[kernel] * scale_px) ** 2 if kernel in ends else np.ones(r2.shape, dtype=bool)


def costs(
    r2: Float[ndarray, "*batch"], scale_px: Float[ndarray, "*#batch"], kernel: Kernel
) -> Float[ndarray, "*batch"]:
    """Robust cost rho(r) of each residual, in px², half of r² near 0."""
    if kernel == "squared":
        return 0.5 * r2
    s2 = scale_px * scale_px
    q2 = r2 / s2
    if kernel == "cauchy":
        return 0.5 * s2 * np.log1p(q2)
    if kernel == "geman":
        return 0.5 * s2 * q2 / (1 + q2)
    if kernel == "tukey":
        return s2 * TUKEY_END**2 / 6 * (1 - np.maximum(1 - q2 / TUKEY_END**2, 0) ** 3)
    rho = 0.5 * q2
    beyond = np.nonzero(q2 > HAMPEL_FLAT**2)
    q = np.sqrt(q2[beyond])
    a, b, c = HAMPEL_FLAT, HAMPEL_DROP, HAMPEL_END
    flat = a * np.minimum(q, b) - 0.5 * a * a
    fall = np.clip((c - q) / (c - b), 0, 1)
    rho[beyond] = flat + np.where(q > b, 0.5 * a * (c - b) * (1 - fall * fall), 0.0)
    return rho * s2


def scale_of_median(median_r2: Float[ndarray, "*batch"]) -> Float[ndarray, "*batch"]:
    """Noise of one coordinate, pixels, from the median squared residual length (the MAD of residuals about 0); floored."""
    return np.maximum(np.sqrt(median_r2) / MEDIAN_OF_RAYLEIGH, SCALE_FLOOR_PX)
