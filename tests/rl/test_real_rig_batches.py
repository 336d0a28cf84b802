"""RigBatch drawn from one rig's own views: what is left without truth, halves, and an agent that is used afterwards."""

from dataclasses import replace

import numpy as np
import pytest

import binocal
from binocal.boards import parse_board
from binocal.errors import TooFewViewsError
from binocal.rl.agent_kind import AgentKind
from binocal.rl.real_rig_batches import network_widths, rigs_from_calibration, tolerance_sigma
from binocal.rl.rig_batches import distance_sigma, remaining_sigma, sample_starts
from binocal.rl.task import KERNEL, initial, transition
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig
from binocal.solvers.loop import begin

BOARD = parse_board("chessboard:11x8:20mm")


@pytest.fixture(scope="module")
def calibration():
    rng, rig = np.random.default_rng(4), table2_rig()
    scene = StereoScene(rig, BOARD, sample_board_poses(rig, BOARD, 12, rng))
    detections = simulate_detections(scene, rng, noise_px=0.2, outlier_share=0.03, outlier_px=20.0)
    return binocal.calibrate(detections, calibrator="lm", model="brown4")


@pytest.fixture(scope="module")
def real(calibration):
    return rigs_from_calibration(calibration, 16, np.random.default_rng(0))


def test_near_the_optimum_the_remaining_distance_is_the_length_of_the_newton_step(real):
    at = begin(real.problem, real.optimum, KERNEL, real.lowest.scale_px)
    assert remaining_sigma(real, at).max() < 1e-3
    rng = np.random.default_rng(1)
    step = replace(
        at.newton,
        shared=1e-5 * rng.standard_normal(at.newton.shared.shape),
        views=1e-5 * rng.standard_normal(at.newton.views.shape),
    )
    moved = begin(real.problem, real.problem.retract(real.optimum, step), KERNEL, real.lowest.scale_px)
    np.testing.assert_allclose(remaining_sigma(real, moved), moved.decrement_sigma, rtol=0.02)


def test_a_narrow_kernel_is_not_nearer(real):
    # under a kernel so narrow that nearly all corners weigh nothing the Newton step is short; the way left is not
    start = sample_starts(real, np.random.default_rng(2))
    wide, narrow = (begin(real.problem, start, KERNEL, scale) for scale in (real.lowest.scale_px, 1e-3))
    np.testing.assert_allclose(remaining_sigma(real, wide), remaining_sigma(real, narrow), rtol=1e-9)
    assert remaining_sigma(real, narrow).min() > 10


def test_without_truth_plain_steps_arrive_where_they_arrive_with_it(real):
    state = initial(real.problem, sample_starts(real, np.random.default_rng(3)), AgentKind.DRL)
    for _ in range(8):
        state = transition(real.problem, state, np.zeros((real.n_rigs, 6)), AgentKind.DRL)
    near = remaining_sigma(real, state.loop) < tolerance_sigma(real.options.n_views)
    assert near.mean() > 0.8 and distance_sigma(real, state.loop.estimate)[near].max() < 0.3
    pick = np.array([3, 1])
    assert np.array_equal(real.select(pick).lowest.cost_px2, real.lowest.cost_px2[pick])


def test_too_few_views_are_refused_and_networks_grow_with_them(calibration):
    few = binocal.calibrate(calibration.evidence.detections.select(np.arange(5)), calibrator="lm", model="brown4")
    with pytest.raises(TooFewViewsError):
        rigs_from_calibration(few, 4, np.random.default_rng(0))
    assert [network_widths(n) for n in (12, 13, 49)] == [(16,), (32, 32), (64, 64)]
