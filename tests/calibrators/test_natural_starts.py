"""From an old rig: whoever leads, the result is the portfolio's or better, and it says who won."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from binocal.calibrators.natural import NaturalRequest, calibrate_from_matches
from binocal.calibrators.natural_starts import AGENT, closed_from_old_rig, led_by_agent, solves_of
from binocal.errors import FormatError
from binocal.rl.agent_kind import AgentKind
from binocal.rl.epipolar_task import OBSERVED
from binocal.rl.match_batches import MATCH_SETS
from binocal.rl.policy import Policy, save_policy, shipped_policy
from binocal.simulation.matches import sample_match_problems
from binocal.solvers.epipolar import EpipolarProblem
from binocal.solvers.portfolio import PORTFOLIO, cost_beside
from binocal.solvers.relative_pose import RelativePose
from streets import T_RIGHT_LEFT, cameras, street


def random_policy(seed, scale=1.0):
    rng = np.random.default_rng(seed)
    sizes = (len(OBSERVED), 16, 2)
    layers = tuple((scale * rng.standard_normal((b, a)), rng.standard_normal(b)) for a, b in pairwise(sizes))
    return Policy(AgentKind.DRL_STREETS, np.zeros(len(OBSERVED)), np.ones(len(OBSERVED)), layers, {"seed": seed})


def hard_problems(n):
    drawn = sample_match_problems(MATCH_SETS["drift_hard"].matches, n, np.random.default_rng(11))
    for i in range(n):
        one = drawn.problem(i)
        truth = RelativePose.of(one.rig.T_right_left)
        old = truth.stepped(np.radians(np.random.default_rng(i).normal(0, 1.5, 5)))
        yield EpipolarProblem.of_matches((one.rig.left, one.rig.right), one.matches)[0], old


@pytest.mark.parametrize("kind", ["shipped", "random", "not numbers"])
def test_the_result_never_costs_more_than_the_portfolios(kind):
    for index, (problem, old) in enumerate(hard_problems(6)):
        policy = shipped_policy(AgentKind.DRL_STREETS) if kind == "shipped" else random_policy(index)
        if kind == "not numbers":
            policy = replace(policy, layers=((np.nan * policy.layers[0][0], policy.layers[0][1]), policy.layers[1]))
        led = closed_from_old_rig(problem, old, None, {AGENT: led_by_agent(policy), **PORTFOLIO}, 0)
        plain = closed_from_old_rig(problem, old, None, PORTFOLIO, 0)
        ours, theirs = (float(cost_beside(problem, closed.estimate, old)) for closed in (led, plain))
        assert ours <= theirs + 1e-3, index
        assert led.led_by["asked"] and not plain.led_by["asked"]
        assert set(led.led_by["costs"]) == {AGENT, *PORTFOLIO}


def solve(matches, **known):
    request = NaturalRequest(cameras(), baseline_m=0.54, length_from="test", **known)
    return calibrate_from_matches(matches, request)


def test_everyone_agrees_on_filtered_matches_and_the_result_says_who_led():
    matches = street(np.random.default_rng(0), cameras(), 900, 0.1, wrong=0.1)
    old = replace(T_RIGHT_LEFT, t=T_RIGHT_LEFT.t + [0.0, 0.01, 0.01])
    found = {name: solve(matches, old=old, calibrator=name) for name in ("drl", "portfolio", "lm")}
    for name, first in (("drl", AGENT), ("portfolio", "schedule 64 to 1"), ("lm", "schedule 64 to 1")):
        report = found[name].provenance["agent"]
        assert report["won"] == first and report["agreeing"] == len(report["costs"]) and report["n_matches"] == 500
        assert found[name].provenance["start"] == "old rig"
    turn = [calibration.rig.T_right_left.R for calibration in found.values()]
    np.testing.assert_allclose(turn[1:], turn[:1] * 2, atol=1e-6)
    unknown = solve(matches).provenance["agent"]
    assert not unknown["asked"] and unknown["reason"] == "no old rig"


def test_calibrators_are_known_by_name_or_weights(tmp_path):
    with pytest.raises(ValueError, match="known: drl, portfolio, lm"):
        solves_of("best")
    save_policy(random_policy(0), tmp_path / "own.safetensors")
    assert list(solves_of(str(tmp_path / "own.safetensors"))) == [AGENT, *PORTFOLIO]
    save_policy(shipped_policy(AgentKind.DRL), tmp_path / "boards.safetensors")
    with pytest.raises(FormatError, match=r"boards\.safetensors.*weights of drl, which sees boards"):
        solves_of(str(tmp_path / "boards.safetensors"))


def test_weights_for_streets_calibrate_no_board(tmp_path):
    from binocal.calibrators import load_calibrator

    save_policy(random_policy(0), tmp_path / "streets.safetensors")
    with pytest.raises(FormatError, match="binocal recalibrate"):
        load_calibrator(str(tmp_path / "streets.safetensors"))
