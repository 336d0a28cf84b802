"""What a relative pose from matches is good for: regions of the images drawn again, and what the intrinsics are uncertain by.

Errors of matches are alike within a region of the images (a lens that its model does not follow, a surface, a repeated structure);
the noise of single matches is 10 to 60 times too small an error. So whole regions are drawn, each through all pairs. And the
intrinsics that were held have errors of their own, which go straight into the pose. Source: Efron & Tibshirani 1993 (block
bootstrap), one Newton step for each draw; the implicit function theorem for the intrinsics.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy import ndarray

from binocal.cameras import Camera
from binocal.shapes import Float, Int
from binocal.solvers.epipolar import EpipolarEquations, EpipolarProblem, RelativePose

REGIONS = (4, 3)  # columns and rows of the left image
DRAWS = 400
STEP_SHARE = 0.5  # of a standard deviation of an intrinsic, either way, for its derivative


def regions_of(left_px: Float[ndarray, "n 2"], size_wh: tuple[int, int]) -> Int[ndarray, "n"]:
    """Which region of the left image each match lies in."""
    place = np.floor(left_px / np.array(size_wh) * REGIONS).astype(int)
    place = np.clip(place, 0, np.array(REGIONS) - 1)
    return place[:, 1] * REGIONS[0] + place[:, 0]


def covariance_by_regions(
    equations: EpipolarEquations, regions: Int[ndarray, "n"], rng: np.random.Generator
) -> Float[ndarray, "5 5"]:
    """Covariance of the five unknowns from draws of whole regions, the kernel's weights held."""
    present = np.unique(regions)
    J, w, r = equations.jacobian, equations.weights, equations.residuals_px
    H = np.stack([J[regions == k].T @ (w[regions == k, None] * J[regions == k]) for k in present])
    g = np.stack([-J[regions == k].T @ (w[regions == k] * r[regions == k]) for k in present])
    size = np.sqrt(np.maximum(np.diagonal(H.sum(axis=0)), 1e-300))
    H, g = H / size[:, None] / size, g / size
    ridge = 1e-9 * np.eye(5)
    counts = rng.multinomial(len(present), np.full(len(present), 1 / len(present)), size=DRAWS).astype(float)
    steps = np.linalg.solve(np.einsum("dk,kij->dij", counts, H) + ridge, (counts @ g)[..., None])[..., 0] / size
    share = len(present) / max(len(present) - 1, 1)
    return steps.T @ steps / DRAWS * share


def covariance_of_noise(equations: EpipolarEquations, noise_px: float) -> Float[ndarray, "5 5"]:
    """What independent noise of the matches leaves: a lower bound."""
    H = equations.information
    size = np.sqrt(np.maximum(np.diagonal(H), 1e-300))
    return np.linalg.inv(H / np.outer(size, size) + 1e-12 * np.eye(5)) / np.outer(size, size) * noise_px**2


def steps_by_intrinsics(
    equations: EpipolarEquations,
    problem_of: Callable[[tuple[Camera, Camera]], EpipolarProblem],
    cameras: tuple[Camera, Camera],
    estimate: RelativePose,
    sigma: tuple[Float[ndarray, "p"], Float[ndarray, "q"]],
) -> tuple[Float[ndarray, "5 p"], Float[ndarray, "5 q"]]:
    """By how much the five unknowns move for one unit of each intrinsic parameter; 0 for those without a standard deviation.

    ``problem_of`` gives the problem of the same matches with other cameras.
    """
    H = equations.information
    size = np.sqrt(np.maximum(np.diagonal(H), 1e-300))
    inverse = np.linalg.inv(H / np.outer(size, size) + 1e-12 * np.eye(5)) / np.outer(size, size)
    pull = -inverse @ (equations.jacobian * equations.weights[:, None]).T
    found = []
    for side in range(2):
        columns = np.zeros((5, len(sigma[side])))
        for k, s in enumerate(sigma[side]):
            if not s > 0:
                continue
            ends = []
            for sign in (1.0, -1.0):
                moved = cameras[side].parameters.copy()
                moved[k] += sign * STEP_SHARE * s
                other = Camera(cameras[side].model, cameras[side].size_wh, moved)
                pair = (other, cameras[1]) if side == 0 else (cameras[0], other)
                ends.append(problem_of(pair).residuals_px(estimate))
            slope = (ends[0] - ends[1]) / (2 * STEP_SHARE * s)
            columns[:, k] = pull @ np.where(np.isfinite(slope), slope, 0.0)
        found.append(columns)
    return found[0], found[1]
