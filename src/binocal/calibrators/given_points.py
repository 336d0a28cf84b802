"""Whether the points of a target that is no plane are where they were given."""

from __future__ import annotations

import numpy as np

from binocal.calibrators.board_and_exposures import RealViewsSolve, with_points_freed
from binocal.evidence import Detections
from binocal.findings import Finding, finding

FREED_SHARE = 0.05  # of the target's extent: standard deviation of the points' coordinates
LEAST_NOISE_PX = 0.01  # what fits better is as given, for all that anybody measures
LEAST_FALL = 0.7  # of the corners' noise: points as given leave 0.97 to 1.03 of it


def points_as_given(solve: RealViewsSolve, detections: Detections) -> tuple[Finding, ...]:
    """The finding that they are elsewhere, where the corners fit far better once the points may move; else nothing."""
    if solve.noise_px < LEAST_NOISE_PX:
        return ()
    points = detections.object_points_m
    extent = float(np.ptp(points, axis=0).max())
    freed = with_points_freed(solve, np.full(len(points), FREED_SHARE * extent))
    if not freed.noise_px < LEAST_FALL * solve.noise_px:
        return ()
    off = np.linalg.norm(freed.minimum.estimate.points.T - points, axis=1)
    unit, factor = ("mm", 1e3) if detections.is_metric else ("units of the points", 1.0)
    worst = int(np.argmax(off))
    found = finding(
        "points-not-as-given",
        free_px=freed.noise_px,
        given_px=solve.noise_px,
        rms=factor * float(np.sqrt(np.mean(off**2))),
        unit=unit,
        worst=worst,
        worst_off=factor * float(off[worst]),
    )
    return (found,)
