"""The agent leads, the answer is the classical one: whatever the weights are, and the result tells what happened."""

from dataclasses import replace

import numpy as np
import pytest

import binocal
from binocal.benchmark.agent import largest_difference_sigma
from binocal.boards import parse_board
from binocal.calibrators.base import CalibrationRequest
from binocal.calibrators.learned import calibrate_with_policy
from binocal.rl.agent_kind import AgentKind
from binocal.rl.policy import Policy, shipped_policy
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig
from binocal.simulation.corruptions import flip_view
from binocal.solvers import controlled

BOARD = parse_board("chessboard:11x8:20mm")
REQUEST = CalibrationRequest("brown4")


def make_detections(seed=0, *, outlier_share=0.0, n_views=12, noise_px=0.2):
    rng = np.random.default_rng(seed)
    rig = table2_rig()
    scene = StereoScene(rig, BOARD, sample_board_poses(rig, BOARD, n_views, rng))
    return simulate_detections(scene, rng, noise_px=noise_px, outlier_share=outlier_share, outlier_px=15.0)


@pytest.fixture
def always_controlled(monkeypatch):
    """The agent leads from every start, near ones too."""
    monkeypatch.setattr(controlled, "FAR_PX", 0.0)
    monkeypatch.setattr(controlled, "FAR_TURN_RAD", 0.0)


def with_weights(change):
    policy = shipped_policy(AgentKind.DRL)
    return replace(policy, layers=tuple((change(w), change(b)) for w, b in policy.layers))


def random_weights(seed):
    rng = np.random.default_rng(seed)
    return with_weights(lambda a: rng.standard_normal(a.shape))


@pytest.mark.parametrize("outlier_share", [0.0, 0.05])
@pytest.mark.parametrize("calibrator", ["drl", "drl-increments"])
def test_the_answer_is_that_of_lm_though_the_agent_leads(calibrator, outlier_share, always_controlled):
    # asked: 0.01 sigma. The classical loop itself stops where the next step is shorter than 0.02 over all unknowns
    for seed in range(4):
        detections = make_detections(seed, outlier_share=outlier_share)
        lm = binocal.calibrate(detections, calibrator="lm", model="brown4")
        drl = binocal.calibrate(detections, calibrator=calibrator, model="brown4")
        assert largest_difference_sigma(lm, drl) < 0.01  # measured: 0.003 at most
        assert drl.provenance["calibrator"] == calibrator and drl.provenance["agent"]["iterations"] > 0


@pytest.mark.parametrize("seed", range(3))
def test_random_weights_change_the_way_and_not_the_answer(seed, always_controlled):
    detections = make_detections(seed, outlier_share=0.03)
    lm = binocal.calibrate(detections, calibrator="lm", model="brown4")
    drl = calibrate_with_policy(detections, REQUEST, random_weights(seed))
    assert largest_difference_sigma(lm, drl) < 0.01
    assert drl.n_iterations >= lm.n_iterations


def test_weights_that_are_not_numbers_fall_back_and_say_so(always_controlled):
    detections = make_detections(1)
    broken = calibrate_with_policy(detections, REQUEST, with_weights(lambda a: a * np.nan))
    assert largest_difference_sigma(binocal.calibrate(detections, calibrator="lm", model="brown4"), broken) < 0.01
    assert any("not finite" in solve["fallback_reason"] for solve in broken.provenance["agent"]["solves"])


def test_the_result_tells_what_the_agent_did(always_controlled):
    agent = binocal.calibrate(make_detections(2), model="brown4").provenance["agent"]
    iterations = [iteration for solve in agent["solves"] for iteration in solve["iterations"]]
    assert agent["iterations"] == len(iterations) > 0
    names = {"damping", "pose_damping", "scale_factor", "rotation_stretch", "translation_stretch", "bend"}
    assert names < set(iterations[0]) and iterations[0]["decrement_sigma"] > 3
    assert all(solve["remaining_sigma"] >= 0 for solve in agent["solves"])


def test_mistakes_are_found_with_the_agent_as_without_it(always_controlled):
    detections = flip_view(make_detections(3), 4, side="right")
    lm, drl = (binocal.calibrate(detections, calibrator=name, model="brown4") for name in ("lm", "drl"))
    assert largest_difference_sigma(lm, drl) < 0.01
    assert [view.note for view in drl.views] == [view.note for view in lm.views] and any(v.note for v in drl.views)


def test_a_good_start_needs_no_agent_and_takes_the_steps_of_lm():
    detections = make_detections(5)
    lm, drl = (binocal.calibrate(detections, calibrator=name, model="brown4") for name in ("lm", "drl"))
    assert drl.provenance["agent"]["iterations"] == 0 and drl.n_iterations == lm.n_iterations
    assert np.array_equal(drl.rig.T_right_left.t, lm.rig.T_right_left.t)


def test_no_policy_is_asked_for_torch():
    assert isinstance(shipped_policy(AgentKind.DRL), Policy)
