"""From an old rig: whoever leads, the result is the portfolio's or better, and it says who won."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from binocal.calibrators.natural import NaturalRequest, calibrate_from_matches
from binocal.calibrators.natural_solves import AGENT, solves_of
from binocal.calibrators.natural_start import AROUND_IT, EQUAL_COST, best_start
from binocal.errors import FormatError
from binocal.geometry import SE3, so3
from binocal.rl.agent_kind import AgentKind
from binocal.rl.epipolar_task import OBSERVED
from binocal.rl.match_batches import MATCH_SETS
from binocal.rl.policy import Policy, save_policy, shipped_policy
from binocal.simulation.matches import MatchDistribution, sample_match_problems
from binocal.solvers.epipolar import EpipolarProblem
from binocal.solvers.epipolar_descent import finish, steer
from binocal.solvers.portfolio import PORTFOLIO, cost_of_seen, is_near
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
        problem, _ = EpipolarProblem.of_matches((one.rig.left, one.rig.right), one.matches)
        yield problem, one.matches, SE3(so3.project_to_rotation(old.R), old.t)


@pytest.mark.parametrize("kind", ["shipped", "random", "not numbers"])
def test_the_result_never_costs_more_than_the_portfolios(kind, tmp_path):
    for index, (problem, matches, old) in enumerate(hard_problems(5)):
        calibrator = "drl"
        if kind != "shipped":
            policy = random_policy(index)
            if kind == "not numbers":
                policy = replace(policy, layers=((np.nan * policy.layers[0][0], policy.layers[0][1]), policy.layers[1]))
            calibrator = str(tmp_path / f"{index}.safetensors")
            save_policy(policy, calibrator)
        led = best_start(problem, matches, old, None, np.random.default_rng(0), calibrator)
        leaders = (
            set() if kind == "not numbers" else {AGENT}
        )  # else it stays at the old rig, where hardly a match is near
        assert led.led_by["asked"] and leaders | set(PORTFOLIO) <= set(led.led_by["costs"])
        pose, scale_px = RelativePose.of(old), led.led_by["compared_at_px"]
        ours = float(cost_of_seen(problem, led.estimate, pose, scale_px))
        for name, one in PORTFOLIO.items():
            end = finish(problem, steer(problem, pose, one.controller, one.n_iterations)).estimate
            outside = 0.0 if is_near(pose, end, 5.5, 6.0) else 0.5 * len(matches)
            assert ours <= float(cost_of_seen(problem, end, pose, scale_px)) + outside + EQUAL_COST, (index, name)
            assert ours <= led.led_by["costs"][name] + EQUAL_COST


def test_the_agent_is_asked_only_where_it_leads():
    problem, matches, old = next(hard_problems(1))
    plain = best_start(problem, matches, old, None, np.random.default_rng(0), "portfolio").led_by
    assert not plain["asked"] and AGENT not in plain["costs"] and AROUND_IT in plain["costs"]
    one = best_start(problem, matches, old, None, np.random.default_rng(0), "lm").led_by
    assert list(one["costs"]) == ["schedule 64 to 1"]


def test_starts_around_find_what_no_schedule_does():
    """From 5 degrees off beside 15 % wrong matches of all kinds: the right minimum, within three standard deviations."""
    found = {"portfolio": 0, "lm": 0}
    drawn = sample_match_problems(MatchDistribution(wrong_share=(0.15, 0.15)), 8, np.random.default_rng(4))
    for index in range(len(drawn)):
        one = drawn.problem(index)
        problem, _ = EpipolarProblem.of_matches((one.rig.left, one.rig.right), one.matches)
        truth = RelativePose.of(one.rig.T_right_left)
        off = np.random.default_rng(index).standard_normal((2, 3))
        off = np.radians(5.0) * off / np.linalg.norm(off * [[1, 1, 1], [1, 1, 0]], axis=1, keepdims=True)
        pose = truth.stepped(np.r_[off[0], off[1, :2]])
        old = SE3(so3.project_to_rotation(pose.R), pose.t)
        right = problem.select(one.is_right)
        information = right.linearize(truth, np.asarray(1.0), "squared").information / one.noise_px**2
        goal = finish(problem, truth).estimate
        for calibrator in found:
            end = best_start(problem, one.matches, old, None, np.random.default_rng(0), calibrator).estimate
            xi = goal.step_to(finish(problem, end).estimate)
            found[calibrator] += float(np.sqrt(xi @ information @ xi / 5)) < 3
    assert found["portfolio"] == 8 > found["lm"]


def test_a_pose_far_from_the_old_rig_wins_where_it_alone_explains_the_matches():
    matches = street(np.random.default_rng(3), cameras(), 300, 0.1, wrong=0.1)
    problem, _ = EpipolarProblem.of_matches(cameras(), matches)
    far = SE3(so3.exp(np.radians([0.0, 12.0, 0.0])) @ T_RIGHT_LEFT.R, T_RIGHT_LEFT.t)
    best = best_start(problem, matches, far, lambda _: T_RIGHT_LEFT, np.random.default_rng(0), "portfolio")
    assert np.degrees(so3.angle_rad(best.estimate.R @ T_RIGHT_LEFT.R.T)) < 0.2


def solve(matches, **known):
    request = NaturalRequest(cameras(), baseline_m=0.54, length_from="test", **known)
    return calibrate_from_matches(matches, request)


def test_everyone_agrees_on_filtered_matches_and_the_result_says_who_led():
    matches = street(np.random.default_rng(0), cameras(), 900, 0.1, wrong=0.1)
    old = replace(T_RIGHT_LEFT, t=T_RIGHT_LEFT.t + [0.0, 0.01, 0.01])
    found = {name: solve(matches, old=old, calibrator=name) for name in ("drl", "portfolio", "lm")}
    for name, first in (("drl", AGENT), ("portfolio", "schedule 64 to 1"), ("lm", "schedule 64 to 1")):
        report = found[name].provenance["agent"]
        assert report["won"] == first and report["agreeing"] == len(report["costs"]) and report["n_matches"] == 400
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
