"""Least-squares template matching between two images, compiled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.kernels import _kernel
from binocal.kernels.arrays import NOTHING, as_floats
from binocal.shapes import Bool, Float, Float32
from binocal.threads import n_threads

MATCHES_PER_THREAD = 50  # several milliseconds of work


@dataclass(frozen=True, slots=True, eq=False)
class TemplateMatches:
    """Where windows of one image lie in the other; NaN where the match failed.

    ``warp`` maps offsets in the first image to offsets in the second, row by row. ``likeness`` is the correlation after gain and
    offset are taken out, ``covariance_px2`` what the windows' residuals leave of the place: xx, xy, yy.
    """

    points_px: Float[ndarray, "n 2"]
    warp: Float[ndarray, "n 2 2"]
    likeness: Float[ndarray, "n"]
    covariance_px2: Float[ndarray, "n 3"]
    is_converged: Bool[ndarray, "n"]


def match_templates(
    from_image: Float32[ndarray, "h w"],
    to_image: Float32[ndarray, "h2 w2"],
    from_px: Float[ndarray, "n 2"],
    to_px: Float[ndarray, "n 2"],
    warp: Float[ndarray, "n 2 2"] | None = None,
    *,
    half: int = 7,
    max_iterations: int = 12,
    tolerance_px: float = 0.003,
    sigma_share: float = 0.6,
) -> TemplateMatches:
    """Match windows of ``2 half + 1`` pixels around points of the first image near points of the second.

    An affine warp, a gain and an offset are fitted with Gaussian weights of ``sigma_share`` times ``half``; samples are Lanczos'.
    Source: Gruen 1985, "Adaptive least squares correlation"; Baker & Matthews 2004 for the inverse compositional steps.
    """
    n = len(from_px)
    place, matrix = np.full((n, 2), np.nan), np.full((n, 4), np.nan)
    likeness, spread, is_converged = np.full(n, np.nan), np.full((n, 3), np.nan), np.zeros(n, dtype=bool)
    start = NOTHING if warp is None else as_floats(warp.reshape(n, 4))
    threads = min(n_threads(), 1 + n // MATCHES_PER_THREAD)
    _kernel.match_templates(
        np.ascontiguousarray(from_image),
        np.ascontiguousarray(to_image),
        as_floats(from_px),
        as_floats(to_px),
        start,
        half,
        max_iterations,
        tolerance_px,
        sigma_share,
        place,
        matrix,
        likeness,
        spread,
        is_converged,
        threads,
    )
    return TemplateMatches(place, matrix.reshape(n, 2, 2), likeness, spread, is_converged)
