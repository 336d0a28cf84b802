"""A stream of measured turns with known truth to drift, jumps and rates."""

from __future__ import annotations

import numpy as np
import pytest

from binocal.calibrators.drift import MeasuredTurn, track_drift
from binocal.errors import DegenerateGeometryError

SIGMA_DEG = np.array([0.01, 0.06, 0.015])


def turns(truth_deg, interval_s=10.0, seed=0):
    rng = np.random.default_rng(seed)
    return [
        MeasuredTurn(
            str(k), true + rng.normal(size=3) * SIGMA_DEG, SIGMA_DEG, None if interval_s is None else k * interval_s
        )
        for k, true in enumerate(truth_deg)
    ]


@pytest.mark.parametrize(("angle", "size_deg"), [(0, 0.1), (1, -0.5), (2, 0.1)])
def test_a_jump_is_told_with_its_angle_time_and_size(angle, size_deg):
    truth = np.zeros((60, 3))
    truth[30:, angle] = size_deg
    track = track_drift(turns(truth))
    (jump,) = track.jumps
    assert jump.angle == angle and abs(jump.at - 30) <= 1 and jump.at <= jump.told_at <= 36
    assert abs(jump.size_deg - size_deg) < 3.5 * jump.sigma_deg
    assert np.abs((track.level_deg[-1] - truth[-1]) / track.level_sigma_deg[-1]).max() < 3.5


def test_two_jumps_are_two_and_a_still_rig_has_none():
    truth = np.zeros((90, 3))
    truth[30:, 0] += 0.1
    truth[60:, 0] -= 0.2
    assert [round(jump.size_deg, 1) for jump in track_drift(turns(truth)).jumps] == [0.1, -0.2]
    for seed in range(5):
        assert not track_drift(turns(np.zeros((60, 3)), seed=seed)).jumps


def test_a_rate_is_told_where_the_stream_is_long_enough_and_has_times():
    hours = np.arange(200)[:, None] * 10.0 / 3600
    track = track_drift(turns(hours * [0.3, 0.0, -0.2]))
    z = (track.rate_deg_per_hour - [0.3, 0.0, -0.2]) / track.rate_sigma_deg_per_hour
    assert np.abs(z).max() < 3.5 and track.rate_sigma_deg_per_hour[0] < 0.1
    assert np.isnan(track_drift(turns(np.zeros((5, 3)), interval_s=0.1)).rate_deg_per_hour).all()
    assert np.isnan(track_drift(turns(np.zeros((60, 3)), interval_s=None)).rate_deg_per_hour).all()


def test_too_few_measurements_are_refused():
    with pytest.raises(DegenerateGeometryError, match="2 of the stream's pairs") as caught:
        track_drift(turns(np.zeros((2, 3))))
    assert caught.value.findings[0].code == "stream-too-few"
