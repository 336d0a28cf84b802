"""Benchmarks of uncertainty and plans in small: every case is drawn, every row is counted, mrcal is asked where it is."""

import numpy as np
import pytest

from binocal.benchmark import mrcal_peer, plan, uncertainty
from binocal.benchmark.uncertainty_cases import CASES, simulate_case

pytestmark = pytest.mark.usefixtures("many_calls")


def test_the_table_has_every_case_and_figure(monkeypatch):
    monkeypatch.setattr(uncertainty, "find_mrcal", lambda: None)
    table = uncertainty.run_uncertainty_benchmark(rigs=3)
    assert {row["case"] for row in table["rows"]} == set(CASES) and table["mrcal"] is None
    for row in table["rows"]:
        assert 0 <= row["within_1_sigma"] <= row["within_2_sigma"] <= 1 and 0.1 < row["rms"] < 4
        assert row["n_rigs"] <= 3 and row["n_failed"] == 0
    assert "bowed board" in table["text"] and "mrcal is not installed" in table["text"]


def test_cases_are_what_they_say():
    rng = np.random.default_rng(0)
    cut = simulate_case(CASES["one-sided coverage"], rng).detections
    assert np.nanmax(cut.left_px[..., 0]) < 0.6 * cut.left_size_wh[0]
    partial = simulate_case(CASES["partial boards"], rng).detections
    assert 0.5 <= partial.left_is_seen.mean() < 1


@pytest.mark.skipif(mrcal_peer.find_mrcal() is None, reason="no Python here has mrcal")
def test_projection_is_that_of_mrcal(monkeypatch):
    monkeypatch.setattr(uncertainty, "N_PEER_RIGS", 2)
    peer = uncertainty._beside_mrcal(1)
    for ratio in peer["ratio"].values():
        assert ratio["median"] == pytest.approx(1.01, abs=0.01) and 0.97 < ratio["low"] <= ratio["high"] < 1.05
    assert peer["elapsed_s"]["binocal"] < peer["elapsed_s"]["mrcal"]


def test_plans_are_compared_with_random_views(monkeypatch):
    monkeypatch.setattr(plan, "N_RANDOM", 4)
    table = plan.run_plan_benchmark(cases=2, rigs=2)
    assert all(row["planned"] < row["before"] for row in table["cases"]) and table["n_failed"] == 0
    assert all(row["planned"] < row["random"] for row in table["views_needed"]) and table["median_ratio"] < 0.6
    assert "best of 4 random" in table["text"]
