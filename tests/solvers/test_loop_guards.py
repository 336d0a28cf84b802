"""Each guard of the loop alone: what is kept, what is undone, when a solve has arrived, and when a controller is relieved."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from test_loop import PLAIN, make_case
from test_second_problem import TRUTH, Motion, MotionProblem, PlaneStep

from binocal.geometry import SE3, so3
from binocal.solvers import robust
from binocal.solvers.arrays import stack_rigs
from binocal.solvers.board_views import LONGEST_TURN_RAD
from binocal.solvers.controlled import MAX_CONTROLLED_ITERATIONS, MAX_REJECTIONS, FarPhase, minimize_controlled
from binocal.solvers.controllers import Marquardt
from binocal.solvers.loop import advance, begin, iterate
from binocal.solvers.loop_state import Action, LoopState, Observed
from binocal.solvers.minimization import MAX_DAMPING, Arrival, LoopOptions, minimize
from binocal.solvers.rules import FAR, NEAR, Near


@pytest.fixture
def motions():
    """A problem of two rigid motions, a state near their optimum, and the step that goes there."""
    rng = np.random.default_rng(3)
    points = rng.uniform(-50, 50, (30, 2))
    moved = MotionProblem(points, np.zeros((2, 30, 2)))._residuals(Motion(TRUTH))[0]
    problem = MotionProblem(points, moved + 0.1 * rng.standard_normal(moved.shape))
    state = begin(problem, Motion(TRUTH + 0.02), "hampel", rules=NEAR)
    return problem, state, problem.solve_step(state.estimate, state.equations, np.zeros(2))


def tried(motions, step, rules=NEAR, is_running=None):
    problem, state, _ = motions
    action = Action(np.zeros(2), 1.0)
    return iterate(problem, state, action, step, "hampel", rules, is_running)


def test_a_step_of_nothing_is_no_progress(motions):
    nothing = PlaneStep(np.zeros((2, 3)), np.zeros(2))
    assert tried(motions, motions[2]).is_kept.all() and not tried(motions, nothing).is_kept.any()


def test_what_the_rules_call_impossible_is_not_kept(motions):
    @dataclass(frozen=True)
    class Strict(Near):
        def is_possible(self, step, ahead_px):
            return np.array([True, False])

    assert tried(motions, motions[2], Strict()).is_kept.tolist() == [True, False]


def test_rigs_that_have_arrived_stay(motions):
    outcome = tried(motions, motions[2], is_running=np.array([False, True]))
    assert outcome.is_kept.tolist() == [False, True]
    assert np.array_equal(outcome.estimate.values[0], motions[1].estimate.values[0])


def test_a_rejected_rig_keeps_its_own_cost(motions):
    _, state, step = motions
    spoiled = PlaneStep(step.values + np.array([[5.0, 0, 0], [0, 0, 0]]), step.predicted_px2)
    outcome = tried(motions, spoiled)
    assert outcome.is_kept.tolist() == [False, True]
    assert outcome.cost_px2[0] == outcome.before_px2[0] and outcome.cost_px2[1] == outcome.trial_px2[1]
    assert outcome.cost_px2[0] <= state.cost_px2[0]


def test_a_rejected_candidate_leaves_a_wide_scale_as_it_was():
    problem, start = make_case()
    state = begin(problem, start, "hampel")
    away = np.array([0.0, np.pi / 2, 0.0, 0.0, 0.0, -5.0])
    after = advance(problem, state, Action(np.zeros(()), np.asarray(4.0), increment=away), "hampel")
    assert not after.is_kept and after.scale_px == state.scale_px and after.cost_px2 == state.cost_px2


def test_no_step_and_no_corner_in_front_are_impossible():
    def is_possible(predicted, ahead):
        return bool(FAR.is_possible(SimpleNamespace(predicted_px2=np.asarray(predicted)), np.asarray(ahead)))

    assert is_possible(1.0, 2.0) and not is_possible(np.nan, 2.0) and not is_possible(1.0, np.inf)


def view_moved(estimate, view, shift_m):
    t = estimate.T_left_board.t.copy()
    t[view, 0] += shift_m
    return replace(estimate, T_left_board=SE3(estimate.T_left_board.R, t))


def standing(problem, estimate, start, scale_px=0.3, kernel="hampel"):
    """A state at an estimate, as if the loop had begun at ``start`` and come there."""
    return replace(begin(problem, estimate, kernel, scale_px), start=start)


@pytest.mark.parametrize("kernel", ["hampel", "cauchy"])
def test_views_that_lost_all_weight_return_to_their_start(kernel):
    problem, start = make_case(turn_deg=0.0)
    state = standing(problem, view_moved(start, 3, 0.05), start, kernel=kernel)
    candidate = FAR.candidate(problem, state, replace(state.newton, shared=0 * state.newton.shared), kernel)
    is_back = np.allclose(candidate.T_left_board.t[3], start.T_left_board.t[3], atol=1e-12)
    assert is_back == (kernel == "hampel")
    assert not np.allclose(candidate.T_left_board.t[2], start.T_left_board.t[2], atol=1e-12)  # it took its step


def test_a_view_that_keeps_half_of_its_corners_is_not_lost():
    problem, start = make_case(turn_deg=0.0)
    pixels = problem.cameras[0].pixels.copy()
    pixels[3, :, ::2] += 50.0
    problem = replace(problem, cameras=(replace(problem.cameras[0], pixels=pixels), problem.cameras[1]))
    moved = view_moved(start, 3, 1e-4)
    state = standing(problem, start, start)
    kept = problem.with_lost_views_restored(moved, state.equations, start)
    assert np.array_equal(kept.T_left_board.t[3], moved.T_left_board.t[3])


def with_newton(state, **changed):
    seen = state.seen
    newton = replace(seen.newton, **changed)
    return replace(state, observed=Observed(newton, seen.gain, seen.previous_mad_px, seen.previous_newton))


def test_a_step_that_turns_the_rig_too_far_is_shortened():
    problem, start = make_case()
    state = begin(problem, start, "hampel")
    shared = state.newton.shared.copy()
    shared[-6:-3] = [0.0, 3.0, 0.0]
    step = FAR.propose(problem, with_newton(state, shared=shared), PLAIN, "hampel")
    assert np.linalg.norm(step.shared[-6:-3]) == pytest.approx(LONGEST_TURN_RAD)
    assert np.allclose(step.views, state.newton.views * LONGEST_TURN_RAD / 3.0)


def test_only_rigs_that_ask_for_it_get_a_corrected_step():
    singles = [make_case(seed) for seed in (5, 6)]
    problem, start = (stack_rigs(parts) for parts in zip(*singles, strict=True))
    state = begin(problem, start, "hampel")
    step = FAR.propose(problem, state, Action(np.zeros(2), np.ones(2), bend=np.array([0.0, 1.0])), "hampel")
    assert np.array_equal(step.shared[0], state.newton.shared[0])
    assert not np.allclose(step.shared[1], state.newton.shared[1])


def test_a_correction_longer_than_the_step_is_not_believed():
    problem, start = make_case()
    step = begin(problem, start, "hampel").newton
    long = replace(step, shared=1.1 * step.shared)
    assert np.array_equal(problem.corrected(step, long, np.asarray(True)).shared, step.shared)
    short = replace(step, shared=0.5 * step.shared)
    assert np.allclose(problem.corrected(step, short, np.asarray(True)).shared, 1.5 * step.shared)


def test_a_focal_length_below_zero_is_impossible():
    problem, start = make_case(intrinsics=True)
    negative = tuple(np.where(np.arange(len(p)) < 2, -p, p) for p in start.parameters)
    assert np.isfinite(problem.linearize(start, np.asarray(1.0), "hampel").cost_px2)
    assert np.isinf(problem.linearize(replace(start, parameters=negative), np.asarray(1.0), "hampel").cost_px2)


# --- arrival


def arrival_of(scale_px, is_settled=True, cost=1.0):
    scale = np.asarray(scale_px)
    state = LoopState(
        None, None, np.asarray(cost), scale, scale, np.asarray(True), None, np.asarray(is_settled), False, None
    )
    return Arrival(state, LoopOptions()), state


def of_length(sigma, scale_px):
    return SimpleNamespace(predicted_px2=np.asarray(0.5 * (sigma * scale_px) ** 2))


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("damping", "sigma", "is_settled", "arrives"),
    [(0.0, 0.01, True, True), (1e-3, 0.01, True, False), (0.0, 0.05, True, False), (0.0, 0.01, False, False)],
    ids=["short", "short by damping", "long", "scale not settled"],
)
def test_arrival(damping, sigma, is_settled, arrives):
    arrival, state = arrival_of(0.2, is_settled)
    assert arrival.ends_before(state, Action(np.asarray(damping), 1.0), of_length(sigma, 0.2)) == arrives
    assert bool(arrival.is_converged) == arrives


@pytest.mark.usefixtures("unchecked_types")
def test_exact_corners_need_a_far_shorter_step():
    scale = robust.SCALE_FLOOR_PX
    arrival, state = arrival_of(scale)
    for sigma, is_short in ((0.01, False), (1e-7, True)):
        arrival.ends_before(state, Action(np.asarray(0.0), 1.0), of_length(sigma, scale))
        assert bool(arrival._is_short) == is_short


@pytest.mark.usefixtures("unchecked_types")
def test_a_damping_that_runs_out_is_no_convergence():
    arrival, state = arrival_of(0.2)
    assert arrival.ends_before(state, Action(np.asarray(MAX_DAMPING), 1.0), of_length(1.0, 0.2))
    assert not arrival.is_converged and not arrival.is_running


@pytest.mark.usefixtures("unchecked_types")
def test_an_impossible_start_does_not_run():
    arrival, state = arrival_of(0.2, cost=np.inf)
    assert arrival.is_over(state) and not arrival.is_converged
    problem, start = make_case()
    behind = replace(start, T_left_board=SE3(start.T_left_board.R, -start.T_left_board.t))
    minimum = minimize(problem, behind)
    assert not minimum.is_converged and minimum.n_iterations == 0


@pytest.mark.usefixtures("unchecked_types")
def test_a_damping_of_nothing_can_be_raised():
    state = SimpleNamespace(is_kept=np.asarray(False))
    controller = Marquardt(0.0)
    memory = {"damping": np.asarray(0.0), "n_steps": np.asarray(1)}
    action, _ = controller.choose(None, state, memory)
    assert action.damping == controller.least_raised > 0


# --- the controlled phase


def passed_on(phase, kept):
    """The phase after iterations whose candidates were kept or not, each of which halves the distance."""
    for i, is_kept in enumerate(kept):
        phase._decrement = 1e6 * 0.5**i
        phase.record(SimpleNamespace(is_kept=np.asarray(is_kept)), SimpleNamespace(action=PLAIN))
    return phase


@pytest.mark.usefixtures("unchecked_types")
def test_three_rejections_in_a_row_end_the_phase():
    assert passed_on(FarPhase(), [False] * (MAX_REJECTIONS - 1)).fallback_reason == ""
    assert "rejected steps in a row" in passed_on(FarPhase(), [False] * MAX_REJECTIONS).fallback_reason
    assert passed_on(FarPhase(), [False, False, True, False, False]).fallback_reason == ""


@pytest.mark.usefixtures("unchecked_types")
def test_the_phase_ends_after_fifteen_iterations():
    problem, start = make_case(2, turn_deg=5.0)
    state = begin(problem, start, "hampel")
    assert not passed_on(FarPhase(), [True] * 3).is_over(with_newton(state, predicted_px2=np.asarray(1e6)))
    phase = passed_on(FarPhase(), [True] * MAX_CONTROLLED_ITERATIONS)
    assert phase.is_over(state) and "not near after 15 iterations" in phase.fallback_reason


def test_the_phase_ends_where_the_rigs_next_step_is_short():
    problem, start = make_case(2, turn_deg=5.0)
    state = begin(problem, start, "hampel", 30.0)
    assert not FarPhase().is_over(with_newton(state, predicted_px2=np.asarray(1e9)))
    shared = state.newton.shared.copy()
    shared[-6:] = 1e-5
    phase = FarPhase()
    assert phase.is_over(with_newton(state, predicted_px2=np.asarray(1e9), shared=shared))
    assert phase.fallback_reason == ""  # no guard: it is near


class NeverAsked:
    """A controller that must not be asked."""

    def start(self, batch):
        return {}

    def choose(self, problem, state, memory):
        raise AssertionError("the controller was asked")


def test_the_controller_is_not_asked_near_the_optimum_nor_where_part_of_the_rig_is_held():
    problem, start = make_case(turn_deg=0.2)
    near = minimize_controlled(problem, start, NeverAsked())
    assert near.controlled == () and near.fallback_reason == "" and near.minimum.is_converged
    problem, start = make_case(turn_deg=8.0)
    with pytest.raises(AssertionError, match="was asked"):
        minimize_controlled(problem, start, NeverAsked())
    for held in (replace(problem, held_part="translation"), replace(problem, is_rig_free=False)):
        assert minimize_controlled(held, start, NeverAsked()).controlled == ()


def test_the_true_rig_stays_where_it_is():
    """What all guards are for: from the truth of noise-free corners nothing moves."""
    problem, start = make_case(7, turn_deg=0.0)
    minimum = minimize(problem, start)
    assert minimum.is_converged
    assert so3.angle_rad(minimum.estimate.T_right_left.R @ start.T_right_left.R.T) < 1e-3


def far_state(mad_px=30.0, turn_rad=0.0, shift_share=0.0):
    """A state whose rig would take that step."""
    problem, start = make_case(2, turn_deg=5.0)
    state = begin(problem, start, "hampel", mad_px)
    shared = state.newton.shared.copy()
    shared[-6:] = [0.0, turn_rad, 0.0, shift_share * np.linalg.norm(start.T_right_left.t), 0.0, 0.0]
    return with_newton(state, shared=shared, predicted_px2=np.asarray(1e9))


@pytest.mark.parametrize(
    ("given", "is_over"),
    [
        ({"turn_rad": 0.011}, False),
        ({"turn_rad": 0.009}, True),
        ({"shift_share": 0.11}, False),
        ({"shift_share": 0.09}, True),
        ({"turn_rad": 0.5, "shift_share": 0.5, "mad_px": 21.0}, False),
        ({"turn_rad": 0.5, "shift_share": 0.5, "mad_px": 19.0}, True),
    ],
    ids=["turn", "short turn", "shift", "short shift", "bad fit", "good fit"],
)
def test_the_agent_is_asked_while_the_fit_is_bad_and_the_next_step_long(given, is_over):
    phase = FarPhase()
    assert phase.is_over(far_state(**given)) == is_over and phase.fallback_reason == ""


def test_singular_equations_and_an_impossible_start_end_the_phase():
    for spoiled in (
        with_newton(far_state(turn_rad=0.5), predicted_px2=np.asarray(np.nan)),
        replace(far_state(turn_rad=0.5), cost_px2=np.asarray(np.inf)),
    ):
        phase = FarPhase()
        assert phase.is_over(spoiled) and "singular or the start is impossible" in phase.fallback_reason


def test_a_start_within_twenty_pixels_costs_no_more_than_without_a_controller(monkeypatch):
    problem, start = make_case(turn_deg=8.0)

    def begun(*arguments, **options):
        raise AssertionError("the far phase was begun")

    monkeypatch.setattr("binocal.solvers.controlled.begin", begun)
    with pytest.raises(AssertionError, match="begun"):
        minimize_controlled(problem, start, NeverAsked(), scale_px=np.asarray(21.0))
    assert minimize_controlled(problem, start, NeverAsked(), scale_px=np.asarray(19.0)).controlled == ()
