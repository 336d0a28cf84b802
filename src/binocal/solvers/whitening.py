"""Corner covariances as weights: residuals in units in which every corner is known equally well.

A corner's covariance is what its image says of it, plus what no image knows: a board that is not flat, a lens that
the model does not follow, images not taken together. That misfit is the same for sharp corners and for blurred ones,
so the covariances count the less the larger it is; it is estimated from the residuals, never assumed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.evidence import Detections
from binocal.shapes import Bool, Float, Int
from binocal.solvers import robust

MEDIAN_CORNERS = 4000  # evenly chosen; their median is known to 1.5 %
MISFIT_STEPS = 20  # halvings of the bracket


@dataclass(frozen=True, slots=True, eq=False)
class CornerWeights:
    """What the residuals of each camera are multiplied by, None where all corners are alike.

    A residual (u, v) becomes (a u, b u + c v). Whitened residuals are pixels of a corner with the noise ``unit_px``: as
    many corners of that noise would carry as much information as these do. ``left_lengths2`` and ``right_lengths2`` are what
    squared whitened residuals are on average over the square of the noise; None: 2 of all.
    """

    left: Float[ndarray, "views 3 n"] | None = None
    right: Float[ndarray, "views 3 n"] | None = None
    unit_px: float = 0.0
    left_lengths2: Float[ndarray, "views n"] | None = None
    right_lengths2: Float[ndarray, "views n"] | None = None

    @property
    def is_uniform(self) -> bool:
        """Whether no corner counts more than another."""
        return self.left is None

    def select(self, views: Int[ndarray, "k"] | slice) -> CornerWeights:
        """The weights of some views only."""
        if self.left is None or self.right is None:
            return self
        lengths2 = [None if a is None else a[views] for a in (self.left_lengths2, self.right_lengths2)]
        return CornerWeights(self.left[views], self.right[views], self.unit_px, *lengths2)


def corner_weights(detections: Detections, misfit_px: float = 0.0) -> CornerWeights:
    """Weights from the corners' covariances, each widened by the misfit (standard deviation of one coordinate).

    A corner of unknown covariance is taken for one of ``unit_px``. Cross-covariances are added to a corner's own: of what
    varies slowly over a board, as all that the rig is estimated from does, the sum of the corners' information is then that
    of their pixels, each counted once (row sums of the covariance matrix in place of the matrix).
    """
    if not detections.has_covariances:
        return CornerWeights()
    factors, information = [], []
    for side, is_seen in (("left", detections.left_is_seen), ("right", detections.right_is_seen)):
        covariance, cross = _covariances(detections, side)
        factor = np.full((*is_seen.shape[:1], 3, *is_seen.shape[1:]), np.nan)
        if covariance is not None:
            total = covariance if cross is None else covariance + cross
            factor = inverse_root(total, max(misfit_px, robust.SCALE_FLOOR_PX))
            information.append(0.5 * np.sum(factor**2, axis=1)[is_seen])
        factors.append(factor)
    known = np.concatenate(information)
    unit_px = float(1 / np.sqrt(np.nanmean(known)))
    one = np.array([1.0, 0.0, 1.0])[:, None]
    left, right = (np.where(np.isfinite(factor), unit_px * factor, one) for factor in factors)
    return CornerWeights(left, right, unit_px, *(expected_lengths2(detections, misfit_px) or ()))


def expected_lengths2(detections: Detections, misfit_px: float) -> tuple[Float[ndarray, "views n"], ...] | None:
    """What a corner's squared residual is on average, whitened, over the square of the noise; None if it is 2 for all.

    It is less where :func:`corner_weights` counts more than the corner's own covariance.
    """
    if detections.left_cross_covariance_px2 is None and detections.right_cross_covariance_px2 is None:
        return None
    expected = []
    floor2 = max(misfit_px, robust.SCALE_FLOOR_PX) ** 2
    for side, is_seen in (("left", detections.left_is_seen), ("right", detections.right_is_seen)):
        covariance, cross = _covariances(detections, side)
        lengths2 = np.full(is_seen.shape, 2.0)
        if covariance is not None and cross is not None:
            # 2 - trace(inverse(total) cross), total being the sum of both and the misfit
            xx, xy, yy = (covariance[..., i, j] + cross[..., i, j] for i, j in ((0, 0), (0, 1), (1, 1)))
            xx, yy = xx + floor2, yy + floor2
            extra = cross[..., 0, 0] * yy - 2 * cross[..., 0, 1] * xy + cross[..., 1, 1] * xx
            lengths2 -= np.nan_to_num(extra / (xx * yy - xy * xy))
        expected.append(lengths2)
    return tuple(expected)


def _covariances(
    detections: Detections, side: str
) -> tuple[Float[ndarray, "views n 2 2"] | None, Float[ndarray, "views n 2 2"] | None]:
    """A camera's covariances and cross-covariances, the latter 0 where they are not known of a corner."""
    cross = getattr(detections, f"{side}_cross_covariance_px2")
    return getattr(detections, f"{side}_covariance_px2"), None if cross is None else np.nan_to_num(cross)


def inverse_root(covariance_px2: Float[ndarray, "views n 2 2"], misfit_px: float) -> Float[ndarray, "views 3 n"]:
    """a, b, c of L⁻¹ = [[a, 0], [b, c]] with L Lᵀ the covariance plus the misfit's; NaN where it is unknown."""
    xx = covariance_px2[..., 0, 0] + misfit_px**2
    xy = covariance_px2[..., 0, 1]
    yy = covariance_px2[..., 1, 1] + misfit_px**2
    a = 1 / np.sqrt(xx)
    c = 1 / np.sqrt(yy - xy * xy / xx)
    return np.stack([a, -c * xy / xx, c], axis=-2)


def estimate_misfit_px(detections: Detections, r2_px2: tuple[Float[ndarray, "views n"], ...]) -> float:
    """The misfit that, added to the covariances, makes the median residual what it should be; 0 where none is needed.

    ``r2_px2`` are squared lengths in pixels, not whitened. Each corner's variance is its covariance's mean over the
    directions. Corners of unknown covariance do not count.
    """
    lengths2, variances = [], []
    for covariance, r2, is_seen in (
        (detections.left_covariance_px2, r2_px2[0], detections.left_is_seen),
        (detections.right_covariance_px2, r2_px2[1], detections.right_is_seen),
    ):
        if covariance is not None:
            variance = 0.5 * (covariance[..., 0, 0] + covariance[..., 1, 1])
            counts: Bool[ndarray, "views n"] = is_seen & np.isfinite(variance)
            lengths2.append(r2[counts])
            variances.append(variance[counts])
    length2, variance = np.concatenate(lengths2), np.concatenate(variances)
    step = max(len(length2) // MEDIAN_CORNERS, 1)
    length2, variance = length2[::step], variance[::step]
    expected = robust.MEDIAN_OF_RAYLEIGH**2
    low, high = 0.0, float(np.median(length2)) / expected
    if np.median(length2 - expected * variance) <= 0:  # the same as of their ratio, and covariances may be 0
        return 0.0
    for _ in range(MISFIT_STEPS):
        middle = 0.5 * (low + high)
        if np.median(length2 / (variance + middle)) > expected:
            low = middle
        else:
            high = middle
    return float(np.sqrt(high))
