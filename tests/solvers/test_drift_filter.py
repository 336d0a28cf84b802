"""The filter of many hypotheses: against a plain Kalman filter, the noise it assumes, and series with known truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from binocal.simulation.drift_series import STILL, DriftFamily, simulate_drift
from binocal.solvers import drift_filter, error_memory
from binocal.solvers.drift_filter import ALARM_LOG_ODDS, noise_scales, settled, start_filter, step_filter
from binocal.solvers.error_memory import remembered, start_memory, whitened


def filtered(measured_deg, sigma_deg, interval_s=0.1):
    state = start_filter(measured_deg[0], sigma_deg[0])
    states = [state]
    for y, s in zip(measured_deg[1:], sigma_deg[1:], strict=True):
        state = step_filter(state, y, s, interval_s)
        states.append(state)
    return states


def levels(states):
    return np.array([s.estimate[0][:, 0] for s in states]), np.array([s.estimate[1][:, 0] for s in states])


def test_one_hypothesis_and_normal_noise_are_a_kalman_filter(monkeypatch):
    for name, value in (("JUMPS", ()), ("WALKS_DEG_PER_ROOT_HOUR", (0.03,)), ("LEARNT_AFTER", 1e15)):
        monkeypatch.setattr(drift_filter, name, value)
    monkeypatch.setattr(drift_filter, "noise_scales", lambda: (np.ones(1), np.ones(1)))
    monkeypatch.setattr(error_memory, "MOST", 0.0)
    rng = np.random.default_rng(0)
    measured, sigma = rng.normal(0, 0.01, (30, 2)), rng.uniform(0.005, 0.02, (30, 2))
    state = filtered(measured, sigma, interval_s=7.0)[-1]
    hours = 7.0 / 3600
    F = np.array([[1, hours], [0, 1]])
    for k in range(2):
        mean, P = np.array([measured[0, k], 0.0]), np.diag([3 * sigma[0, k] ** 2, 10.0**2])
        for y, s in zip(measured[1:, k], sigma[1:, k], strict=True):
            mean, P = F @ mean, F @ P @ F.T + np.diag([0.03**2 * hours, 0.0])
            gain = P[:, 0] / (P[0, 0] + s**2)
            mean, P = mean + gain * (y - mean[0]), P - np.outer(gain, P[0])
        np.testing.assert_allclose(state.estimate[0][k], mean, rtol=1e-9)
        np.testing.assert_allclose(state.estimate[1][k], np.sqrt(np.diagonal(P)), rtol=1e-9)


def test_noise_is_a_t_of_a_scale_that_is_roughly_known():
    scales, shares = noise_scales()
    rng = np.random.default_rng(1)
    drawn = rng.standard_t(3, 400_000) * np.exp(0.4 * rng.normal(size=400_000))
    mixed = rng.normal(size=400_000) * np.sqrt(rng.choice(scales, 400_000, p=shares))
    assert shares.sum() == pytest.approx(1)
    for share in (0.5, 0.9, 0.99, 0.999):
        assert np.quantile(np.abs(mixed), share) == pytest.approx(np.quantile(np.abs(drawn), share), rel=0.1)


def test_one_measurement_however_far_off_is_no_jump_yet():
    """The second tells it, with its whole size; of an outlier nothing is told."""
    sigma = np.full((6, 1), 0.01)
    for after, is_jump in ((2.0, True), (0.0, False)):
        states = filtered(np.array([[0.0], [0.0], [0.0], [2.0], [after], [after]]), sigma)
        odds = [float(state.log_odds[0]) for state in states]
        assert odds[3] < ALARM_LOG_ODDS and (odds[4] > ALARM_LOG_ODDS) == is_jump
        assert abs(states[4].estimate[0][0, 0] - after) < 0.05
        assert not is_jump or states[4].last_jump()[0] == 3


def test_errors_are_as_stated_and_near_those_of_who_knows_the_jumps():
    series = simulate_drift(DriftFamily(), 700, 60, np.random.default_rng(2))
    level, sigma = levels(filtered(series.measured_deg, series.stated_deg))
    error = (level - series.true_deg)[100:]
    z = np.abs(error / sigma[100:])
    assert np.sqrt(np.mean(error**2)) < 0.0038  # measured 0.0031; a moving average has 0.0054
    assert 0.65 < np.mean(z < 1) < 0.85 and 0.92 < np.mean(z < 2) < 0.985


def test_an_outlier_is_no_jump_and_a_jump_is_dated():
    series = simulate_drift(STILL, 200, 40, np.random.default_rng(3))
    measured = np.array(series.measured_deg)
    measured[100, :20] += 1.0
    measured[100:, 20:] += 0.08
    states = filtered(measured, series.stated_deg)
    odds = np.array([s.log_odds for s in states])
    assert np.mean(odds[-1, 20:] > ALARM_LOG_ODDS) == 1.0
    assert np.mean(odds[102:, :20].max(axis=0) > ALARM_LOG_ODDS) <= 0.05
    assert np.abs(levels(states)[0][105, :20]).max() < 0.03
    assert np.median(np.abs(states[-1].last_jump()[20:] - 100)) <= 1
    known = settled(states[-1], np.arange(40) >= 20)
    assert (known.log_odds[20:] < -2).all() and np.allclose(known.log_odds[:20], states[-1].log_odds[:20])


def test_still_series_raise_few_alarms():
    series = simulate_drift(STILL, 400, 100, np.random.default_rng(4))
    odds = np.array([s.log_odds for s in filtered(series.measured_deg, series.stated_deg)[1:]])
    assert np.sum(odds.max(axis=0) > ALARM_LOG_ODDS) <= 3  # 0.4 in 100 series of 400, by the rate stated


def test_the_rate_of_a_drift_goes_on_through_a_jump():
    steps, interval_s, rate = 400, 10.0, 0.4
    rng = np.random.default_rng(5)
    truth = rate * np.arange(steps)[:, None] * interval_s / 3600 + 0.1 * (np.arange(steps)[:, None] >= 200)
    measured = truth + rng.normal(0, 0.008, (steps, 8))
    mean, sigma = filtered(measured, np.full((steps, 8), 0.008), interval_s)[-1].estimate
    assert np.abs((mean[:, 1] - rate) / sigma[:, 1]).max() < 3 and sigma[:, 1].max() < 0.1


@pytest.mark.parametrize(("correlation", "most"), [(0.5, 3), (0.9, 9)])
def test_errors_that_are_alike_are_no_jump(correlation, most):
    """Taken for independent they raise an alarm in 40 and in 60 of 60 series; measured 0 and 5."""
    series = simulate_drift(replace(STILL, correlation=correlation), 500, 60, np.random.default_rng(6))
    states = filtered(series.measured_deg, series.stated_deg)
    odds = np.array([s.log_odds for s in states[1:]])
    assert np.sum(odds.max(axis=0) > ALARM_LOG_ODDS) <= most
    assert np.median(states[-1].memory.correlation) == pytest.approx(correlation, abs=0.12)


def test_a_whitened_measurement_repeats_nothing_and_keeps_the_level():
    rng = np.random.default_rng(7)
    errors = rng.normal(size=(4000, 10))
    for k in range(1, len(errors)):
        errors[k] = 0.8 * errors[k - 1] + 0.6 * errors[k]
    level, sigma, series = np.full(10, 5.0), np.ones(10), 5.0 + errors
    memory, white = start_memory(series[0], sigma), []
    for y in series[1:]:
        last, memory = memory, remembered(memory, y, sigma, level)
        white.append(whitened(memory, last, sigma))
    z, sigma = (np.array(part)[1000:] for part in zip(*white, strict=True))
    r = [np.corrcoef(z[1:, k], z[:-1, k])[0, 1] for k in range(10)]
    assert np.abs(memory.correlation - 0.8).max() < 0.05 and np.abs(r).max() < 0.1
    assert z.mean() == pytest.approx(5.0, abs=0.05) and np.std((z - 5) / sigma) == pytest.approx(1, abs=0.05)
