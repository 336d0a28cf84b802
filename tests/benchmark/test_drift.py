"""The benchmark of drift filters on a few short series."""

from __future__ import annotations

import numpy as np
import pytest

from binocal.benchmark import drift
from binocal.benchmark.drift_peers import ALARMS, ESTIMATORS
from binocal.simulation.drift_series import DriftFamily, simulate_drift


def test_every_filter_is_measured_on_every_family(monkeypatch):
    for name, value in (("N_STEPS", 160), ("JUMP_AT", 110), ("N_AFTER", 40), ("N_FIRST", 60)):
        monkeypatch.setattr(drift, name, value)
    table = drift.run_drift_benchmark(series=8)
    for row in table["errors"]:
        assert list(row["filters"]) == list(ESTIMATORS) and row["family"] in table["text"]
        errors = {name: filtered["rms_mdeg"] for name, filtered in row["filters"].items()}
        assert errors["knows walk, noise and jumps"] == min(errors.values())
    assert [row["filter"] for row in table["alarms"]] == list(ALARMS)
    for row in table["alarms"]:
        assert all(delay["median"] <= delay["p90"] and 0 <= delay["never"] <= 24 for delay in row["delays"])
    assert all(0 <= row["share"] <= 1 for row in table["false_alarms"])


def test_series_are_as_the_family_says():
    family = DriftFamily(jump_every=50, stated_log_sigma=0.2)
    series = simulate_drift(family, 1000, 50, np.random.default_rng(0))
    jumps = np.abs(np.diff(series.true_deg, axis=0)[series.is_jump[1:]])
    assert jumps.min() > 0.009 and jumps.max() < 0.061 and np.mean(series.is_jump) == pytest.approx(0.02, rel=0.1)
    assert series.noise_deg.min() > 0.0029 and series.noise_deg.max() < 0.0251
    assert np.std(np.log(series.stated_deg / series.noise_deg)) == pytest.approx(0.2, rel=0.05)
    z = (series.measured_deg - series.true_deg) / series.noise_deg
    assert np.median(np.abs(z)) == pytest.approx(0.765, rel=0.03)  # of t with 3 degrees of freedom
    neighbours = simulate_drift(DriftFamily(correlation=0.9, degrees_of_freedom=30), 2000, 20, np.random.default_rng(1))
    errors = (neighbours.measured_deg - neighbours.true_deg) / neighbours.noise_deg
    assert np.corrcoef(errors[:-1].ravel(), errors[1:].ravel())[0, 1] == pytest.approx(0.9, abs=0.03)
