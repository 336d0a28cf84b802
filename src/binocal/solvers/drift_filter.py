"""A level that wanders, drifts and now and then jumps, from a series of measurements with outliers.

Hypotheses on when the last jump was are kept side by side (Adams & MacKay 2007, "Bayesian online changepoint detection"): whether a
far measurement was an outlier or the first after a jump is settled by those that follow. Under each hypothesis a Kalman filter holds
the level and its rate. Measurement noise is Student's t, of a standard deviation that is itself only roughly known: a mixture of
normals of one mean, so that the posterior of a step is a mixture, which is replaced by the normal of its mean and covariance.
Errors of neighbours that are alike are whitened first (:mod:`binocal.solvers.error_memory`).

The odds that the level has jumped are the alarm: what all hypotheses of a jump weigh against those of none. Deviations from the
source: hypotheses are pruned to the heaviest, a jump is normal about the old level rather than from a fixed prior, the rate goes on
through jumps, and the noise and its correlation are learnt along the way. Filters of several series run side by side.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy import ndarray

from binocal.shapes import Bool, Float, Int
from binocal.solvers.error_memory import ErrorMemory, remembered, start_memory, whitened

JUMPS = ((0.04, 1 / 600), (1.0, 1e-4))
"""Knocks, and mounts that give way: standard deviations in degrees, and how many are expected per measurement."""
WALKS_DEG_PER_ROOT_HOUR = (0.006, 0.03)  # 0.03 and 0.15 mdeg from one measurement to the next at 10 Hz
RATE_DEG_PER_HOUR = 10.0  # standard deviation before anything is measured; heat turns rigs by less
N_KEPT = 8  # hypotheses for each walk
DEGREES_OF_FREEDOM = 3.0
STATED_LOG_SIGMA = 0.4  # by which the stated standard deviation of a measurement is wrong, as a logarithm
N_SCALES = 10
LEARNT_AFTER = 50.0  # measurements that the stated noise counts for
LEAST_NOISE = 0.67  # of the stated one: errors that last a scene seem small within it and are a jump to the next
ALARM_LOG_ODDS = 6.3
"""Three filters side by side, as those of a rig's angles, exceed it in 5 % of 1700 measurements in which nothing moves
(``binocal bench drift``)."""


@dataclass(frozen=True, slots=True, eq=False)
class DriftState:
    """What is known of n levels after some measurements: for each walk, the kept hypotheses on the last jump.

    ``mean`` and ``covariance`` are of level and rate (degrees, degrees per hour). ``jumped_at`` is the number of the first measurement
    after the hypothesis's last jump, -1 for none. ``noise`` is the variance found and the number of measurements it was found in.
    """

    mean: Float[ndarray, "n walks kept 2"]
    covariance: Float[ndarray, "n walks kept 2 2"]
    log_weight: Float[ndarray, "n walks kept"]
    jumped_at: Int[ndarray, "n walks kept"]
    noise: tuple[Float[ndarray, "n"], float]
    memory: ErrorMemory
    settled_at: Int[ndarray, "n"]
    """Jumps up to here are known, and no alarm any more."""
    n_measured: int = 1

    @property
    def weights(self) -> Float[ndarray, "n walks kept"]:
        """Probabilities of the hypotheses."""
        return _probabilities(self.log_weight)

    @property
    def estimate(self) -> tuple[Float[ndarray, "n 2"], Float[ndarray, "n 2"]]:
        """Level and rate over all hypotheses but those of a jump at the last measurement, and their standard deviations.

        That one measurement alone tells a jump happens only where it is very far off, and then it may as well be an outlier.
        """
        is_older = self.jumped_at < self.n_measured - 1
        weights = _probabilities(np.where(is_older, self.log_weight, -np.inf))
        mean, covariance = _merged(weights, self.mean, self.covariance, (1, 2))
        return mean, np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))

    @property
    def log_odds(self) -> Float[ndarray, "n"]:
        """Of a jump before the last measurement that is not known yet, against none, times (1 - r) where neighbours' errors correlate by r.

        One measurement alone, however far off, may be an outlier.

        How well r is known limits what measurements that are alike can tell together: without the factor the log odds that 5 % of
        still series exceed grow from 6 at r = 0 to 50 at 0.9.
        """
        is_new = self.jumped_at > self.settled_at[:, None, None]
        weights = self.weights
        is_older = self.jumped_at < self.n_measured - 1
        new, none = ((weights * part).sum(axis=(1, 2)) for part in (is_new & is_older, ~is_new))
        odds = np.log(np.maximum(new, 1e-300)) - np.log(np.maximum(none, 1e-300))
        return odds * (1 - self.memory.correlation) ** 1.5

    def last_jump(self) -> Int[ndarray, "n"]:
        """The number of the measurement since which the level is another, by the heaviest hypothesis of a new jump."""
        is_new = (self.jumped_at > self.settled_at[:, None, None]) & (self.jumped_at < self.n_measured - 1)
        new = np.where(is_new, self.log_weight, -np.inf)
        best = new.reshape(len(new), -1).argmax(axis=1)
        return self.jumped_at.reshape(len(new), -1)[np.arange(len(new)), best]


def start_filter(measured_deg: Float[ndarray, "n"], sigma_deg: Float[ndarray, "n"]) -> DriftState:
    """After the first measurement of each series."""
    shape = len(measured_deg), len(WALKS_DEG_PER_ROOT_HOUR), N_KEPT
    mean, covariance = np.zeros((*shape, 2)), np.zeros((*shape, 2, 2))
    mean[..., 0] = measured_deg[:, None, None]
    covariance[..., 0, 0] = (DEGREES_OF_FREEDOM * sigma_deg**2)[:, None, None]
    covariance[..., 1, 1] = RATE_DEG_PER_HOUR**2
    log_weight = np.full(shape, -np.inf)
    log_weight[:, :, 0] = -np.log(len(WALKS_DEG_PER_ROOT_HOUR))
    none = np.full(shape, -1)
    noise = np.full(len(measured_deg), LEARNT_AFTER), LEARNT_AFTER
    memory = start_memory(measured_deg, sigma_deg)
    return DriftState(mean, covariance, log_weight, none, noise, memory, np.zeros(len(measured_deg), dtype=np.int64))


def step_filter(
    state: DriftState, measured_deg: Float[ndarray, "n"], sigma_deg: Float[ndarray, "n"], elapsed_s: float
) -> DriftState:
    """After one more measurement of each series, ``elapsed_s`` after the last."""
    memory = remembered(state.memory, measured_deg, sigma_deg, state.estimate[0][:, 0])
    measured_deg, sigma_deg = whitened(memory, state.memory, sigma_deg)
    mean, covariance, log_weight, jumped_at = _with_jumps(_predicted(state, elapsed_s / 3600))
    found, count = state.noise
    learnt = np.maximum(found / count, LEAST_NOISE**2)
    scales, shares = noise_scales()
    noise = (learnt * sigma_deg**2)[:, None, None, None] * scales
    innovation = (measured_deg[:, None, None] - mean[..., 0])[..., None]
    level = covariance[..., 0, 0, None]
    total = level + noise
    likely = shares / np.sqrt(total) * np.exp(-0.5 * innovation**2 / total) + 1e-300
    likelihood = likely.sum(axis=-1)
    share = likely / likelihood[..., None]
    gain = level / total
    moved = (share * gain * innovation).sum(axis=-1)
    left = (share * (level * (1 - gain) + (gain * innovation) ** 2)).sum(axis=-1) - moved**2
    along = covariance[..., 0] / level  # what a change of the level tells of the rate
    mean = mean + along * moved[..., None]
    change = left - level[..., 0]
    covariance = covariance + change[..., None, None] * along[..., :, None] * along[..., None, :]
    log_weight = log_weight + np.log(likelihood)
    log_weight -= log_weight.max(axis=(1, 2), keepdims=True)
    stepped = replace(
        state,
        mean=mean,
        covariance=covariance,
        log_weight=log_weight,
        jumped_at=jumped_at,
        memory=memory,
        n_measured=state.n_measured + 1,
    )
    rest = ((1 - gain) * innovation) ** 2 + level * (1 - gain)  # expected square of the measurement's error
    seen = (share * rest / noise).sum(axis=-1) * learnt[:, None, None]
    return replace(stepped, noise=(found + (stepped.weights * seen).sum(axis=(1, 2)), count + 1))


def settled(state: DriftState, is_known: Bool[ndarray, "n"]) -> DriftState:
    """The state in which jumps of some series up to now raise no alarm any more."""
    return replace(state, settled_at=np.where(is_known, state.n_measured - 1, state.settled_at))


def _predicted(state: DriftState, hours: float) -> DriftState:
    F = np.array([[1.0, hours], [0.0, 1.0]])
    covariance = F @ state.covariance @ F.T
    covariance[..., 0, 0] += np.square(WALKS_DEG_PER_ROOT_HOUR)[:, None] * hours
    return replace(state, mean=state.mean @ F.T, covariance=covariance)


def _with_jumps(state: DriftState) -> tuple[ndarray, ndarray, ndarray, ndarray]:
    """Mean, covariance, log weight and number of the last jump, the lightest hypotheses replaced by those of a jump just now.

    The heaviest one of no new jump is always kept.
    """
    mean, covariance = np.array(state.mean), np.array(state.covariance)
    log_weight, jumped_at = np.array(state.log_weight), np.array(state.jumped_at)
    highest = log_weight.max(axis=2)
    weights = np.exp(log_weight - highest[..., None])
    together = weights.sum(axis=2)
    merged_mean, merged_covariance = _merged(weights / together[..., None], mean, covariance, (2,))
    is_new = jumped_at > state.settled_at[:, None, None]
    of_none = np.where(is_new, -np.inf, log_weight).argmax(axis=2)[..., None]  # an outlier must not put it out for good
    order = np.array(log_weight)
    np.put_along_axis(order, of_none, np.inf, axis=2)
    lightest = np.argsort(order, axis=2)
    log_weight += np.log1p(-sum(hazard for _, hazard in JUMPS))
    for rank, (jump_deg, hazard) in enumerate(JUMPS):
        place = (*np.ogrid[: lightest.shape[0], : lightest.shape[1]], lightest[..., rank])
        mean[place], covariance[place] = merged_mean, merged_covariance
        covariance[(*place, 0, 0)] += jump_deg**2
        log_weight[place] = highest + np.log(together) + np.log(hazard)
        jumped_at[place] = state.n_measured
    return mean, covariance, log_weight, jumped_at


def _probabilities(log_weight: ndarray) -> ndarray:
    weights = np.exp(log_weight - log_weight.max(axis=(1, 2), keepdims=True))
    return weights / weights.sum(axis=(1, 2), keepdims=True)


def _merged(weights: ndarray, mean: ndarray, covariance: ndarray, axis: tuple[int, ...]) -> tuple[ndarray, ndarray]:
    """Mean and covariance of mixtures; weights add up to 1 over the axes."""
    middle = (weights[..., None] * mean).sum(axis=axis, keepdims=True)
    away = mean - middle
    each = covariance + away[..., :, None] * away[..., None, :]
    return middle.squeeze(axis), (weights[..., None, None] * each).sum(axis=axis)


@cache
def noise_scales() -> tuple[Float[ndarray, "k"], Float[ndarray, "k"]]:
    """Variances over the square of the stated sigma, and their shares, of the normals that make up the noise.

    Student's t is a mixture of normals with variances of an inverse chi-squared distribution; the stated sigma's own error is a
    normal of their logarithm. The product's distribution is cut into equal pieces of the logarithm, to its tail of 1e-5.
    """
    u = np.arange(-10.0, 25.0, 0.01)
    half = DEGREES_OF_FREEDOM / 2
    of_t = np.exp(-half * (u + np.exp(-u)))
    kernel = np.arange(-6 * STATED_LOG_SIGMA, 6 * STATED_LOG_SIGMA + 0.005, 0.01)
    density = np.convolve(of_t, np.exp(-0.5 * (kernel / (2 * STATED_LOG_SIGMA)) ** 2), mode="same")
    density /= density.sum()
    below = np.cumsum(density)
    ends = np.interp([0.01, 0.99999], below, u)
    piece = np.clip(np.floor((u - ends[0]) / (ends[1] - ends[0]) * N_SCALES), 0, N_SCALES - 1).astype(int)
    shares = np.bincount(piece, density)
    return np.exp(np.bincount(piece, density * u) / shares), shares
