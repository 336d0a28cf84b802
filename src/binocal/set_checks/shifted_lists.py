"""Whether one camera's corner lists are off by a row or column of the board in all views."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.geometry import SE3
from binocal.shapes import Float, Int
from binocal.solvers.board_views import BundleEstimate, BundleProblem
from binocal.solvers.minimization import LoopOptions, minimize
from binocal.solvers.shape_model import pitch_of

REPAIRED_SHARE = 0.7  # of the noise as given: true shifts leave 0.01 to 0.7, other causes 0.8 and more
MIN_CORNERS_SHARE = 0.3  # of the board, that must be left once a row or column is gone
OPTIONS = LoopOptions(tolerance_sigma=0.3, max_iterations=30)


@dataclass(frozen=True, slots=True)
class Shift:
    """How the left lists are put right, and the noise that is left then.

    ``by`` is added to the number of every left corner's ``line``, which is ``column`` or ``row``.
    """

    line: str
    by: int
    noise_px: float


def find_shift(problem: BundleProblem, estimate: BundleEstimate, noise_px: float) -> Shift | None:
    """The shift of the left lists by one row or column that makes the corners fit, if one does."""
    points = problem.object_points
    pitch = pitch_of(points)
    best: Shift | None = None
    for axis, name in ((0, "column"), (1, "row")):
        for sign in (1, -1):
            step = np.zeros(3)
            step[axis] = sign * pitch
            source = _neighbours(points, step, 0.1 * pitch)
            if (source >= 0).mean() < MIN_CORNERS_SHARE:
                continue
            left = problem.cameras[0]
            is_seen = left.is_seen[:, source] & (source >= 0)
            pixels = np.where(is_seen[:, None, :], left.pixels[:, :, source], 0.0)
            whitening = None if left.whitening is None else np.ascontiguousarray(left.whitening[:, :, source])
            moved = replace(left, pixels=np.ascontiguousarray(pixels), is_seen=is_seen, whitening=whitening)
            shifted = replace(problem, cameras=(moved, problem.cameras[1]))
            # the corners that the left camera saw at p are now called p - step: its board stands step further on
            T = estimate.T_left_board
            start = replace(estimate, T_left_board=SE3.unchecked(T.R, T.t + T.R @ step))
            minimum = minimize(shifted, start, OPTIONS)
            found = float(minimum.scale_px)
            if minimum.is_converged and found < REPAIRED_SHARE * noise_px and (best is None or found < best.noise_px):
                best = Shift(name, -sign, found)
    return best


def _neighbours(points: Float[ndarray, "3 n"], step: Float[ndarray, "3"], limit: float) -> Int[ndarray, "n"]:
    """For each point the one that lies a step further on the board; -1 where there is none."""
    distance = np.linalg.norm(points[:, :, None] + step[:, None, None] - points[:, None, :], axis=0)
    nearest = distance.argmin(axis=1)
    return np.where(distance[np.arange(len(nearest)), nearest] < limit, nearest, -1)
