"""What matches ask of the cameras' own parameters, which are held: a sign that these are not the cameras of the images.

Freed for a result, intrinsics go off by more than they were uncertain while the residuals fall. But one parameter that, freed alone
beside the pose, takes away a third of what the residuals are, and does so in every region of the images, says that the parameters
held are wrong, or that the images are not the raw ones of these cameras.
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
