"""Other filters of a level that wanders and jumps: each gives its estimates, and a figure that grows when the level has moved.

Series stand side by side, (steps, n). Their settings were chosen on series of another seed, for the least RMS error; where alarms
ask for other ones, those are their own entries.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy import ndarray

from binocal.shapes import Float
from binocal.simulation.drift_series import DriftSeries
from binocal.solvers.drift_filter import start_filter, step_filter

INTERVAL_S = 0.1
JUMP_VARIANCE_DEG2 = 0.038**2  # of jumps of 10 to 60 mdeg
Filtered = tuple[ndarray, ndarray]


def multi_hypothesis(series: DriftSeries) -> Filtered:
    """Binocal's own; its figure is the log odds of a jump."""
    y, s = series.measured_deg, series.stated_deg
    state = start_filter(y[0], s[0])
    levels, odds = [y[0]], [np.full(y.shape[1], -np.inf)]
    for step in range(1, len(y)):
        state = step_filter(state, y[step], s[step], INTERVAL_S)
        levels.append(state.estimate[0][:, 0])
        odds.append(state.log_odds)
    return np.array(levels), np.array(odds)


def moving_average(series: DriftSeries, gain: float) -> Filtered:
    """Exponentially weighted (Roberts 1959)."""
    level, levels = series.measured_deg[0], []
    for y in series.measured_deg:
        level = level + gain * (y - level)
        levels.append(level)
    return np.array(levels), np.abs(levels)


def robust_kalman(series: DriftSeries, walk_deg: float) -> Filtered:
    """Random walk of known steps, measurements weighted by Student's t of 3 degrees of freedom."""
    return _kalman(series.measured_deg, series.stated_deg, np.full(len(series.measured_deg), walk_deg**2))


def oracle(series: DriftSeries) -> Filtered:
    """The same, told the walk, the noise and when jumps were: out of reach."""
    steps = np.broadcast_to(series.walk_deg**2, series.measured_deg.shape)
    return _kalman(series.measured_deg, series.noise_deg, steps + JUMP_VARIANCE_DEG2 * series.is_jump)


def _kalman(y: Float[ndarray, "steps n"], s: Float[ndarray, "steps n"], steps_deg2: ndarray) -> Filtered:
    level, variance, levels = y[0], s[0] ** 2, []
    for k in range(len(y)):
        variance = variance + steps_deg2[k]
        innovation = y[k] - level
        weight = 4 / (3 + innovation**2 / (s[k] ** 2 + variance))
        gain = variance / (variance + s[k] ** 2 / weight)
        level, variance = level + gain * innovation, (1 - gain) * variance
        levels.append(level)
    return np.array(levels), np.abs(levels)


def adaptive_kalman(series: DriftSeries, memory: float, share: float) -> Filtered:
    """Process noise from correlated innovations (after Mehra 1970), innovations clipped at 2.5 standard deviations.

    Innovations that follow one another with one sign show that the level moves faster than the filter. ``share`` of their running
    mean product is added to the variance.
    """
    y, s = series.measured_deg, series.stated_deg
    level, variance, levels = y[0], s[0] ** 2, []
    before = product = np.zeros_like(level)
    for k in range(len(y)):
        variance = variance + (1e-4) ** 2 + share * np.maximum(product, 0.0)
        total = variance + 2 * s[k] ** 2
        innovation = np.clip(y[k] - level, -2.5 * np.sqrt(total), 2.5 * np.sqrt(total))
        product = product + (innovation * before - product) / memory
        before = innovation
        gain = variance / total
        level, variance = level + gain * innovation, (1 - gain) * variance
        levels.append(level)
    return np.array(levels), np.abs(levels)


def cumulative_sum(series: DriftSeries, slack: float) -> Filtered:
    """Two one-sided sums (Page 1954) of measurements over the stated noise, clipped at 2.5; known to start at zero."""
    z = np.clip(series.measured_deg / series.stated_deg, -2.5, 2.5)
    up = down = np.zeros(z.shape[1])
    sums = []
    for row in z:
        up, down = np.maximum(up + row - slack, 0.0), np.maximum(down - row - slack, 0.0)
        sums.append(np.maximum(up, down))
    return np.zeros_like(z), np.array(sums)


ESTIMATORS: dict[str, Callable[[DriftSeries], Filtered]] = {
    "multi-hypothesis": multi_hypothesis,
    "adaptive Kalman filter": partial(adaptive_kalman, memory=5.0, share=0.03),
    "robust Kalman filter": partial(robust_kalman, walk_deg=2e-3),
    "moving average": partial(moving_average, gain=0.07),
    "knows walk, noise and jumps": oracle,
}
ALARMS: dict[str, Callable[[DriftSeries], Filtered]] = {
    "multi-hypothesis": multi_hypothesis,
    "adaptive Kalman filter": partial(adaptive_kalman, memory=5.0, share=0.003),
    "robust Kalman filter": partial(robust_kalman, walk_deg=1e-3),
    "moving average": partial(moving_average, gain=0.02),
    "cumulative sum": partial(cumulative_sum, slack=1.0),
}
