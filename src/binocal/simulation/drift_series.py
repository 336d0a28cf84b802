"""Series of measured turns of rigs that wander, drift and are knocked, with the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from binocal.shapes import Bool, Float

SCENE_STEPS = 100.0  # measurements over which the noise of a scene stays alike


@dataclass(frozen=True, slots=True)
class DriftFamily:
    """What moves and how it is measured; degrees, per measurement.

    Values of a pair are drawn evenly between its ends, walk and noise evenly in the logarithm.
    """

    walk_deg: tuple[float, float] = (2e-5, 2e-4)
    jump_deg: tuple[float, float] = (0.01, 0.06)
    jump_every: float = 600.0
    noise_deg: tuple[float, float] = (0.003, 0.025)
    degrees_of_freedom: float = 3.0
    stated_log_sigma: float = 0.4
    """By which the stated noise of a measurement is wrong, as a logarithm."""
    correlation: float = 0.0
    """Of the errors of neighbours in a series, as of a scene that changes slowly."""


STILL = DriftFamily(walk_deg=(0.0, 0.0), jump_every=np.inf)


@dataclass(frozen=True, slots=True, eq=False)
class DriftSeries:
    """Series side by side: measurements, true levels, and what the noise was said to be and was (degrees)."""

    measured_deg: Float[np.ndarray, "steps n"]
    true_deg: Float[np.ndarray, "steps n"]
    stated_deg: Float[np.ndarray, "steps n"]
    noise_deg: Float[np.ndarray, "steps n"]
    is_jump: Bool[np.ndarray, "steps n"]
    walk_deg: Float[np.ndarray, "n"]


def simulate_drift(family: DriftFamily, n_steps: int, n_series: int, rng: np.random.Generator) -> DriftSeries:
    """Series that start at zero. Noise is Student's t times a scale that changes with the scene."""
    shape = n_steps, n_series
    low, high = family.walk_deg
    walk = low * (high / low) ** rng.uniform(0, 1, n_series) if low > 0 else np.zeros(n_series)
    is_jump = rng.random(shape) < 1 / family.jump_every
    is_jump[0] = False
    size = rng.uniform(*family.jump_deg, shape) * rng.choice([-1.0, 1.0], shape)
    steps = rng.normal(size=shape) * walk + np.where(is_jump, size, 0.0)
    steps[0] = 0.0
    true = np.cumsum(steps, axis=0)
    low, high = family.noise_deg
    noise = low * (high / low) ** _scenes(shape, rng)
    errors = rng.standard_t(family.degrees_of_freedom, shape)
    for step in range(1, n_steps if family.correlation else 0):
        errors[step] = family.correlation * errors[step - 1] + np.sqrt(1 - family.correlation**2) * errors[step]
    measured = true + noise * errors
    stated = noise * np.exp(family.stated_log_sigma * rng.normal(size=shape))
    return DriftSeries(measured, true, stated, noise, is_jump, walk)


def _scenes(shape: tuple[int, int], rng: np.random.Generator) -> Float[np.ndarray, "steps n"]:
    """Numbers that are even between 0 and 1 and change slowly along the first axis."""
    keep = np.exp(-1 / SCENE_STEPS)
    value = rng.normal(size=shape)
    for step in range(1, shape[0]):
        value[step] = keep * value[step - 1] + np.sqrt(1 - keep**2) * value[step]
    return 1 / (1 + np.exp(-1.702 * value))  # the normal distribution function to 0.01
