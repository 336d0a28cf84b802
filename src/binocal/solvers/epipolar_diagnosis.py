"""What matches ask of the cameras' own parameters, which are held: a sign that these are not the cameras of the images.

Freed for a result, intrinsics go off by more than they were uncertain while the residuals fall. But one parameter that, freed alone
beside the pose, takes away a third of what the residuals are, and does so in every region of the images, says that the parameters
held are wrong, or that the images are not the raw ones of these cameras. All of them freed together show how much of the residuals
is a pattern that other cameras would not leave.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.shapes import Float, Int
from binocal.solvers.epipolar import EpipolarEquations
from binocal.solvers.epipolar_covariance import draws_of_regions

MIN_SIGMAS = 4.0
FREED_TIMES, ALLOWED_SIGMAS = 100.0, 3.0
"""Of what a good calibration leaves uncertain: another lens, or a focal length that is 4 % another; and what may be a good calibration."""
ENOUGH_SIGNIFICANCE = (
    10.0  # by which the log likelihood must rise beyond half the logarithm of n for each parameter freed
)
MIN_FALL = 1 / 3  # of the weighted sum of squares; good calibrations keep systematic errors that ask for a quarter


@dataclass(frozen=True, slots=True)
class Ask:
    """A parameter, by how much it would change, its standard deviation, and the share of the squared residuals that it would save."""

    name: str
    change: float
    sigma: float
    fall: float


def clearest_ask(
    equations: EpipolarEquations,
    regions: Int[ndarray, "n"],
    slopes: Mapping[str, Float[ndarray, "n"]],
    rng: np.random.Generator,
) -> Ask | None:
    """The parameter whose change saves most, if it is clear; ``slopes`` are derivatives of the residuals by each that is asked for."""
    J, w, r = equations.jacobian, equations.weights, equations.residuals_px
    total = float(w @ r**2)
    best: Ask | None = None
    for name, slope in slopes.items():
        if not np.any(slope):
            continue
        step, draws = draws_of_regions(np.column_stack([J, slope]), w, r, regions, rng)
        saved = -r * w @ np.column_stack([J, slope]) @ step
        sigma = float(np.sqrt(np.mean((draws[:, -1] - step[-1]) ** 2)))
        ask = Ask(name, float(step[-1]), sigma, float(saved) / max(total, 1e-300))
        if abs(ask.change) > MIN_SIGMAS * sigma and ask.fall > max(MIN_FALL, best.fall if best else 0.0):
            best = ask
    return best


@dataclass(frozen=True, slots=True)
class CameraMisfit:
    """Residuals (RMS, pixels) with the cameras as they are held, and what of them is a pattern that only other cameras explain."""

    held_px: float
    pattern_px: float

    @property
    def share(self) -> float:
        """Of the squared residuals."""
        return (self.pattern_px / max(self.held_px, 1e-300)) ** 2


def camera_misfit(
    equations: EpipolarEquations,
    pair: Int[ndarray, "n"],
    slopes: Float[ndarray, "n p"],
    covariance: Float[ndarray, "p p"],
) -> CameraMisfit | None:
    """How much of the residuals other cameras would not leave, to first order, the kernel's weights held; None if that may be chance.

    ``slopes`` are derivatives of the residuals by all parameters of both cameras, ``covariance`` what a good calibration leaves
    uncertain of them: of each pattern that they leave, :data:`ALLOWED_SIGMAS` are no other cameras. Every pair has a pose of its own,
    so that pairs which differ count for nothing.
    """
    right = equations.weights > 0
    root = np.sqrt(equations.weights[right])
    r, J, own = root * equations.residuals_px[right], root[:, None] * equations.jacobian[right], pair[right]
    values, vectors = np.linalg.eigh(covariance)
    A = root[:, None] * (slopes[right] @ (vectors * np.sqrt(np.maximum(values, 0.0))))
    n_poses = 0
    for k in np.unique(own):
        here = own == k
        basis, _ = np.linalg.qr(J[here] / np.maximum(np.linalg.norm(J[here], axis=0), 1e-300))
        r[here] -= basis @ (basis.T @ r[here])
        A[here] -= basis @ (basis.T @ A[here])
        n_poses += basis.shape[1]
    patterns, size, _ = np.linalg.svd(A, full_matrices=False)
    n = int(right.sum()) - n_poses
    noise2 = float(r @ r) / max(n, 1)
    told = (FREED_TIMES * size) ** 2 > noise2  # another camera would leave it by more than the noise of the matches
    amplitude = np.abs(patterns.T @ r) * told
    n_told = int(told.sum())
    if n <= 2 * n_told:
        return None
    freed2 = (float(r @ r) - float(amplitude @ amplitude)) / (n - n_told)
    rise = 0.5 * n * np.log(max(noise2, 1e-300) / max(freed2, 1e-300))
    if rise < 0.5 * n_told * np.log(n) + ENOUGH_SIGNIFICANCE:
        return None
    beyond = np.maximum(amplitude - ALLOWED_SIGMAS * size, 0.0)
    weight = n * float((root**2).mean())
    return CameraMisfit(float(np.sqrt(noise2 * n / weight)), float(np.sqrt(beyond @ beyond / weight)))
