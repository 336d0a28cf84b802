"""The benchmark of poses from matches, on a few problems."""

from __future__ import annotations

import numpy as np
import pytest

from binocal.benchmark import natural
from binocal.geometry import so3
from binocal.simulation import MatchDistribution
from binocal.solvers.relative_pose import RelativePose


@pytest.mark.slow
def test_ratios_coverage_and_refusals_are_counted(monkeypatch):
    monkeypatch.setattr(natural, "SHARES", ((natural.FEW_WRONG, (0.0, 0.0)), (natural.MANY_WRONG, (0.7, 0.7))))
    table = natural.run_natural_benchmark(n_problems=5, n_untold=2, seed=1)
    clean, wrong = table["rows"]
    assert clean["binocal"]["found_share"] == 1 and 0.4 < clean["binocal"]["median"] < 1.6
    assert 0.4 < clean["within_1_sigma"] < 0.95 and clean["within_2_sigma"] > 0.8
    assert clean["refused"] == 0 and wrong["opencv"]["median"] > 1
    for row in table["untold"]:
        assert row["refused_without_old_rig"] == row["n"] == 2
        assert row["scene"] in table["text"]
    assert "70 %" in table["text"]


def test_errors_are_measured_against_the_bound():
    rng = np.random.default_rng(0)
    drawn = natural.sample_match_problems(MatchDistribution(), 1, rng).problem(0)
    problem = natural._posed(drawn, rng)
    assert problem.ratio(problem.truth) == 0
    backward = RelativePose(problem.truth.R, -problem.truth.t)
    assert problem.ratio(backward) == 0  # the sign is told by visibility, not by the residuals
    sigma = np.sqrt(np.linalg.inv(problem.information)[2, 2])
    for factor in (1.0, 3.0):
        xi = factor * np.linalg.inv(problem.information)[:, 2] / sigma
        assert problem.ratio(problem.truth.stepped(xi)) == pytest.approx(factor / np.sqrt(5), rel=0.02)
    off_deg = np.degrees(so3.angle_rad(problem.old.R @ problem.truth.R.T))
    assert off_deg == pytest.approx(5.0)


def test_no_result_is_no_error():
    summary = natural._summary([(float("nan"), False), (1.0, True), (9.0, False)])
    assert summary["median"] == 5.0 and summary["rms"] == 1.0 and summary["found_share"] == pytest.approx(1 / 3)
    assert np.isnan(natural._summary([(float("nan"), False)])["median"])
