"""How alike the errors of neighbouring measurements are, learnt along the way, and measurements freed of what they repeat.

Frames of one scene share its errors. Taken for independent they look like a level that moves, and every rate and alarm is wrong.
Errors that decay by a constant share from one measurement to the next (an autoregressive process of order one; Box & Jenkins 1970)
are whitened by a weighted difference of neighbours, which leaves the level as it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.shapes import Float

CLIPPED_AT = 2.0  # stated standard deviations: outliers and jumps must not decide on how alike errors are
INDEPENDENT_FOR = np.array([[10.0], [1.0]])  # measurements that the assumption of independent errors counts for
MOST = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class ErrorMemory:
    """The last measurement of n series, the level believed before it, and running sums over neighbouring errors.

    Errors are in stated standard deviations. ``products`` and ``squares`` have two rows: of measurements against the filter's level,
    and of the differences of measurements, which know no level but take more measurements to tell as much.
    """

    last_deg: Float[ndarray, "n"]
    last_level_deg: Float[ndarray, "n"]
    last_sigma_deg: Float[ndarray, "n"]
    last_errors: Float[ndarray, "2 n"]
    products: Float[ndarray, "2 n"]
    squares: Float[ndarray, "2 n"]
    n_measured: int = 1

    @property
    def correlation(self) -> Float[ndarray, "n"]:
        """Of the errors of neighbours, 0 to 0.95.

        From errors against the level, which are too small where the level follows them, or from differences, less their standard
        error of 2 / sqrt(k), where those say more: differences of errors correlated by r are correlated by (r - 1) / 2. Both are
        lowered while there are a few measurements only, which a jump makes look alike.
        """
        n = self.n_measured
        against_level = self.products[0] / self.squares[0] - 2 / n
        of_differences = 1 + 2 * self.products[1] / self.squares[1] - 2 / np.sqrt(n) - 8 / n
        return np.clip(np.maximum(against_level, of_differences), 0.0, MOST)


def start_memory(measured_deg: Float[ndarray, "n"], sigma_deg: Float[ndarray, "n"]) -> ErrorMemory:
    """After the first measurement of each series."""
    none = np.zeros((2, len(measured_deg)))
    independent = np.array([[0.0], [-0.5]])  # correlations of errors and of their differences
    return ErrorMemory(
        measured_deg, measured_deg, sigma_deg, none, none + INDEPENDENT_FOR * independent, none + INDEPENDENT_FOR
    )


def remembered(
    memory: ErrorMemory,
    measured_deg: Float[ndarray, "n"],
    sigma_deg: Float[ndarray, "n"],
    level_deg: Float[ndarray, "n"],
) -> ErrorMemory:
    """After one more measurement of each series, whose level was believed to be ``level_deg`` before it."""
    against_level = (measured_deg - level_deg) / sigma_deg
    difference = (measured_deg - memory.last_deg) / np.hypot(sigma_deg, memory.last_sigma_deg)
    errors = np.clip([against_level, difference], -CLIPPED_AT, CLIPPED_AT)
    squares = (errors**2 + memory.last_errors**2) / 2 if memory.n_measured > 1 else 0.0
    return ErrorMemory(
        measured_deg,
        level_deg,
        sigma_deg,
        errors,
        memory.products + errors * memory.last_errors,
        memory.squares + squares,
        memory.n_measured + 1,
    )


def whitened(
    memory: ErrorMemory, last: ErrorMemory, sigma_deg: Float[ndarray, "n"]
) -> tuple[Float[ndarray, "n"], Float[ndarray, "n"]]:
    """The measurement less what it repeats of the last one's error, of the same level, and its standard deviation.

    A single outlier is not repeated: the less alike errors are, the smaller the last error that counts in full.
    """
    r = memory.correlation
    most = CLIPPED_AT * last.last_sigma_deg / (1 - r)
    before = last.last_level_deg + np.clip(last.last_deg - last.last_level_deg, -most, most)
    return (memory.last_deg - r * before) / (1 - r), sigma_deg * np.sqrt((1 + r) / (1 - r))
