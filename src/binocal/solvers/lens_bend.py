"""One coefficient of radial distortion from the bend of lines that are straight in the scene ("plumb lines", Brown 1971).

A line at the distance h from the principal point is bent by a lens of x (1 + k r²) to a curvature of 2 k h: linear in k, so that all
segments of all images are one robust regression. Curved things are outliers. No focal length is needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from binocal.cameras import Camera
from binocal.evidence.line_segments import LineSegments
from binocal.solvers import robust
from binocal.solvers.epipolar_covariance import regions_of

MIN_BENT = 30  # segments with a measured bend
SAG_PX = 0.3  # of things that are called straight
STARTS = np.linspace(-0.45, 0.25, 36)  # of the coefficient at the image's corner
ROUNDS = 20
SURE_SIGMAS, SURE_PX = 7.0, 1.0  # at the image's corner; rails that curve through rectified images of KITTI reach 5.8


@dataclass(frozen=True, slots=True)
class LensBend:
    """``corner_px``: by how much the lens moves the image's corners outwards, with its standard deviation."""

    corner_px: float
    sigma_px: float
    size_wh: tuple[int, int]

    @property
    def is_sure(self) -> bool:
        """Whether the lens bends lines."""
        return abs(self.corner_px) > max(SURE_SIGMAS * self.sigma_px, SURE_PX)

    @property
    def camera(self) -> Camera:
        """A camera of this lens; its focal length is that of 90 degrees across the diagonal, whatever the true one."""
        half = 0.5 * float(np.hypot(*self.size_wh))
        centre = 0.5 * (np.array(self.size_wh) - 1)
        return Camera("brown4", self.size_wh, np.r_[half, half, centre, 0.0, self.corner_px / half, 0.0, 0.0, 0.0])


def estimate_bend(segments: LineSegments) -> LensBend | None:
    """The lens by which the segments bend; None where too few are long enough to show a bend.

    The principal point is taken for the image's middle, where the lens is not bent.
    """
    told = segments.select(np.isfinite(segments.bend_per_px[:, 1]))
    if len(told) < MIN_BENT:
        return None
    half = 0.5 * float(np.hypot(*told.size_wh))
    along = told.ends_px[:, 1] - told.ends_px[:, 0]
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / told.lengths_px[:, None]
    h = np.sum((told.middles_px - 0.5 * (np.array(told.size_wh) - 1)) * normal, axis=1)
    A, bend = 2 * h / half**2, told.bend_per_px[:, 0]
    sigma = np.hypot(told.bend_per_px[:, 1], 8 * SAG_PX / told.lengths_px**2)
    away = (bend - STARTS[:, None] * A) / sigma
    k = float(STARTS[robust.costs(away**2, np.asarray(1.0), "geman").sum(axis=1).argmin()])
    for _ in range(ROUNDS):
        weights = robust.weights(((bend - A * k) / sigma) ** 2, np.asarray(1.0), "tukey") / sigma**2
        k = float(np.sum(weights * A * bend) / max(np.sum(weights * A**2), 1e-300))
    weights = robust.weights(((bend - A * k) / sigma) ** 2, np.asarray(1.0), "tukey") / sigma**2
    # curved things keep together: each region of the images counts as one draw
    scores = np.bincount(regions_of(told.middles_px, told.size_wh), weights * A * (bend - A * k))
    error = float(np.sqrt(np.sum(scores**2)) / max(np.sum(weights * A**2), 1e-300))
    return LensBend(k * half, error * half, told.size_wh)
