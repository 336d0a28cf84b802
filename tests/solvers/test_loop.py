"""One guarded iteration: what is kept, what each part of an action does, and what no controller can spoil."""

from dataclasses import replace

import numpy as np
import pytest
from test_board_views import make_problem, truth_of

from binocal.boards import parse_board
from binocal.geometry import SE3, so3
from binocal.simulation.noise import simulate_detections
from binocal.simulation.rigs import table2_rig
from binocal.simulation.scenes import StereoScene, sample_board_poses
from binocal.solvers.arrays import stack_rigs
from binocal.solvers.board_views import CameraObservations
from binocal.solvers.controlled import MAX_CONTROLLED_ITERATIONS, minimize_controlled
from binocal.solvers.controllers import Marquardt, Nielsen, Schedule
from binocal.solvers.loop import advance, begin, listening
from binocal.solvers.loop_state import Action
from binocal.solvers.minimization import minimize

BOARD = parse_board("chessboard:11x8:20mm")
PLAIN = Action(np.zeros(()), np.ones(()))
CORRECTED = replace(PLAIN, bend=np.ones(()))


def make_case(seed=0, *, outlier_share=0.0, intrinsics=False, turn_deg=10.0):
    rng = np.random.default_rng(seed)
    rig = table2_rig()
    scene = StereoScene(rig, BOARD, sample_board_poses(rig, BOARD, 10, rng))
    detections = simulate_detections(scene, rng, noise_px=0.2, outlier_share=outlier_share, outlier_px=20.0)
    problem = make_problem(rig, detections)
    if not intrinsics:
        cameras = tuple(
            CameraObservations.from_corners(c.model, px, intrinsics=False)
            for c, px in zip(problem.cameras, (detections.left_px, detections.right_px), strict=True)
        )
        problem = replace(problem, cameras=cameras)
    truth = truth_of(scene)
    axis = rng.standard_normal(3)
    turn = so3.exp(np.radians(turn_deg) * axis / np.linalg.norm(axis))
    T = truth.T_right_left
    start = replace(truth, T_right_left=SE3(turn @ T.R, T.t * 1.1))
    return problem, start


def angle_deg(a, b):
    return np.degrees(so3.angle_rad(a.T_right_left.R @ b.T_right_left.R.T))


def test_zero_action_is_robust_gauss_newton():
    problem, start = make_case()
    state = begin(problem, start, "hampel")
    after = advance(problem, state, PLAIN, "hampel")
    by_hand = problem.retract(start, state.newton)
    assert after.is_kept and np.array_equal(after.estimate.T_right_left.R, by_hand.T_right_left.R)


def test_a_corrected_step_comes_nearer_from_far():
    # 10 degrees off, 10 rigs: the correction leaves a sixth of what the plain step leaves, and never more
    left = []
    for seed in range(10):
        problem, start = make_case(seed)
        state, goal = begin(problem, start, "hampel"), minimize(problem, start).estimate
        errors = [angle_deg(advance(problem, state, a, "hampel").estimate, goal) for a in (PLAIN, CORRECTED)]
        left.append(errors[1] / errors[0])
    assert np.median(left) < 0.4 and max(left) < 1.0  # measured: median 0.17


def test_a_correction_gives_outliers_no_weight_that_only_the_step_reveals():
    gains = []
    for seed in range(6):
        problem, start = make_case(seed, outlier_share=0.1, turn_deg=3.0)
        goal = minimize(problem, start).estimate
        states = [begin(problem, start, "hampel")] * 2
        for _ in range(2):
            states = [advance(problem, s, a, "hampel") for s, a in zip(states, (PLAIN, CORRECTED), strict=True)]
        gains.append(angle_deg(states[1].estimate, goal) / max(angle_deg(states[0].estimate, goal), 1e-12))
    assert np.median(gains) < 0.3


@pytest.mark.parametrize("action", [PLAIN, CORRECTED, replace(CORRECTED, damping=np.asarray(0.1))])
def test_the_robust_cost_never_rises(action):
    problem, start = make_case(3, outlier_share=0.1, turn_deg=30.0)
    state = begin(problem, start, "hampel")
    for _ in range(8):
        after = advance(problem, state, action, "hampel")
        scale = after.scale_px
        assert after.equations.cost_under(scale, "hampel") <= state.equations.cost_under(scale, "hampel")
        state = after


def test_a_step_behind_the_camera_is_rejected_and_changes_nothing():
    problem, start = make_case()
    state = begin(problem, start, "hampel")
    away = np.array([0.0, np.pi / 2, 0.0, 0.0, 0.0, -5.0])
    after = advance(problem, state, replace(PLAIN, increment=away), "hampel")
    assert not after.is_kept and after.seen.gain == -1
    assert np.array_equal(after.estimate.T_right_left.R, start.T_right_left.R)
    assert after.scale_px == state.scale_px and after.mad_px == state.mad_px


def test_the_given_state_is_not_altered():
    problem, start = make_case()
    state = begin(problem, start, "hampel")
    before = [state.estimate.T_left_board.R.copy(), state.equations.cameras[0].gram.copy(), state.newton.views.copy()]
    advance(problem, state, CORRECTED, "hampel")
    after = [state.estimate.T_left_board.R, state.equations.cameras[0].gram, state.newton.views]
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))


@pytest.mark.parametrize(
    "controller",
    [
        Marquardt(),
        Marquardt(0.0),
        Marquardt(1.0, schedule=Schedule((8.0, 4.0, 1.0))),
        Nielsen(1e-3),
        Marquardt(1e-3, schedule=Schedule(bend=1.0)),
    ],
)
@pytest.mark.parametrize("intrinsics", [False, True])
def test_every_controller_ends_at_the_classical_minimum(controller, intrinsics):
    problem, start = make_case(1, outlier_share=0.05, intrinsics=intrinsics, turn_deg=5.0)
    classical, solve = minimize(problem, start), minimize_controlled(problem, start, controller)
    assert classical.is_converged and solve.minimum.is_converged
    # the rotation's sigma is 4e-2 degrees with free intrinsics, 1e-3 with held ones; the stop rule leaves 0.01 of it
    assert angle_deg(solve.minimum.estimate, classical.estimate) < (4e-4 if intrinsics else 1e-5)
    difference = solve.minimum.estimate.T_right_left.t - classical.estimate.T_right_left.t
    assert np.abs(difference).max() < 1e-6


class Lost:
    """A controller that asks for nonsense."""

    def __init__(self, damping):
        self.damping = damping

    def start(self, batch):
        return {}

    def choose(self, problem, state, memory):
        return Action(np.full(state.mad_px.shape, self.damping), np.ones(state.mad_px.shape)), memory


@pytest.mark.parametrize(
    ("damping", "reason"), [(np.nan, "not finite"), (np.inf, "not finite"), (1e9, "did not halve")]
)
def test_a_useless_controller_gives_way_to_the_classical_one(damping, reason):
    problem, start = make_case(2, turn_deg=5.0)
    solve, classical = minimize_controlled(problem, start, Lost(damping)), minimize(problem, start)
    assert reason in solve.fallback_reason and len(solve.controlled) <= MAX_CONTROLLED_ITERATIONS
    assert angle_deg(solve.minimum.estimate, classical.estimate) < 1e-5


def test_the_remaining_distance_is_in_sigmas():
    problem, start = make_case(4, turn_deg=5.0)
    solve = minimize_controlled(problem, start, Marquardt(1e-4))
    assert 0 < solve.remaining_sigma < 1e4 and len(solve.controlled) >= 1
    goal = solve.minimum.estimate
    state = begin(problem, start, "hampel")
    for iteration in solve.controlled:
        action = Action(np.asarray(iteration.damping), np.asarray(iteration.scale_factor))
        state = advance(problem, state, action, "hampel")
    sigma = np.sqrt(np.diag(np.linalg.inv(problem.shared_information(goal, solve.minimum.equations)))[:3])
    turn = so3.log(state.estimate.T_right_left.R @ goal.T_right_left.R.T)
    # six unknowns together are at least as far as the farthest of them alone
    assert solve.remaining_sigma >= np.max(np.abs(turn) / sigma) / solve.minimum.scale_px - 1e-6
    assert minimize_controlled(problem, start, Lost(np.nan)).remaining_sigma == 0


def test_a_batch_takes_the_steps_of_its_single_rigs():
    singles = [make_case(seed) for seed in (5, 6)]
    stacked, both = (stack_rigs(parts) for parts in zip(*singles, strict=True))
    ones = np.ones(2)
    batch = advance(stacked, begin(stacked, both, "hampel"), Action(0 * ones, ones, bend=ones), "hampel")
    for index, (problem, start) in enumerate(singles):
        single = advance(problem, begin(problem, start, "hampel"), CORRECTED, "hampel")
        assert np.allclose(batch.estimate.T_right_left.R[index], single.estimate.T_right_left.R, atol=1e-12)
        assert batch.mad_px[index] == pytest.approx(single.mad_px, rel=1e-12)


def test_a_listener_is_told_of_the_start_and_of_every_iteration_and_changes_nothing():
    problem, start = make_case(1)
    told = []
    with listening(lambda of, state, n_done: told.append((of is problem, n_done, float(state.cost_px2)))):
        heard = minimize(problem, start)
    alone = minimize(problem, start)  # nobody listens any more
    assert [n for _, n, _ in told] == list(range(len(told))) and len(told) == int(heard.n_iterations) + 1
    assert all(is_it for is_it, _, _ in told) and told[-1][2] < 0.1 * told[0][2]
    assert np.array_equal(heard.estimate.T_right_left.t, alone.estimate.T_right_left.t)
