"""The row error that views have in common: what is left of a rig's own error once the corners' noise is averaged out.

Noise, and boards that two cameras saw at two moments, put rows off by another amount in each view; a camera that turned puts them off
alike in all. So the rows' differences are fitted by a constant and a slope along both axes of the left image, and what the views
scatter about it tells how well that is known: no board's pose, and no standard deviation of the rig, is needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.cameras import StereoRig
from binocal.evidence import Detections
from binocal.findings import Finding, finding
from binocal.metrics.image import row_differences
from binocal.shapes import Float

LEAST_VIEWS = 4  # of fewer the scatter says too little
VIEWS_FOR_SLOPES = 8  # a constant and two slopes, and as many views again and more to tell their scatter
CHANCE = 1e-4  # how often a rig that has not changed may be said to have
LEAST_PX = 0.1  # no stereo matcher notices less


@dataclass(frozen=True, slots=True)
class CommonRows:
    """``common_px`` is the RMS of the part that the views share, ``rest_px`` that of all else; ``p_value`` that chance makes it."""

    common_px: float
    rest_px: float
    p_value: float
    n_views: int

    @property
    def is_off(self) -> bool:
        """Whether rows are off by more than chance makes and than all that differs between the views."""
        return self.p_value < CHANCE and self.common_px > max(LEAST_PX, self.rest_px)

    @property
    def finding(self) -> Finding | None:
        """Rows that are off as a finding; None where they are not."""
        if not self.is_off:
            return None
        return finding("rows-off", common_px=self.common_px, rest_px=self.rest_px, p_value=self.p_value)


def common_rows(rig: StereoRig, detections: Detections) -> CommonRows | None:
    """The row error that the views share; None where fewer than :data:`LEAST_VIEWS` have corners that both cameras saw.

    The p-value is of Hotelling's T² over the views (Student's t of the constant alone, where views are few).

    Raises:
        DegenerateGeometryError: The rig cannot be rectified.
    """
    difference = row_differences(rig, detections)
    known = np.isfinite(difference)
    views = np.flatnonzero(known.any(axis=1))
    if len(views) < LEAST_VIEWS:
        return None
    size = np.array(rig.left.size_wh)
    place = (detections.left_px - (size - 1) / 2) / size
    basis = np.concatenate([np.ones((*difference.shape, 1)), place], axis=2)
    if len(views) < VIEWS_FOR_SLOPES:
        basis = basis[..., :1]
    A, d = basis[known], difference[known]
    coefficients, *_ = np.linalg.lstsq(A, d, rcond=1e-9)
    rest = d - A @ coefficients
    return CommonRows(
        float(np.sqrt(np.mean((A @ coefficients) ** 2))),
        float(np.sqrt(np.mean(rest**2))),
        _chance(A, rest, coefficients, np.repeat(np.arange(len(views)), known[views].sum(axis=1))),
        len(views),
    )


def _chance(
    A: Float[ndarray, "n q"], rest: Float[ndarray, "n"], coefficients: Float[ndarray, "q"], view: ndarray
) -> float:
    """How often the coefficients are as large by chance; their covariance from leaving out one view at a time."""
    from scipy.special import fdtrc  # a tenth of a second to import

    n_views, q = int(view[-1]) + 1, A.shape[1]
    normal = np.zeros((n_views, q, q))
    scores = np.zeros((n_views, q))
    np.add.at(normal, view, A[:, :, None] * A[:, None, :])
    np.add.at(scores, view, A * rest[:, None])
    moved = np.einsum("vij,vj->vi", np.linalg.pinv(A.T @ A - normal), scores)  # by leaving out each view
    covariance = (n_views - 1) / n_views * moved.T @ moved
    T2 = float(coefficients @ np.linalg.pinv(covariance) @ coefficients)
    return float(fdtrc(q, n_views - q, (n_views - q) / (q * (n_views - 1)) * T2))
