"""The guards of the joint solve, each alone: second start, lower cost, proof of a clean set, too few views, exact corners."""

from dataclasses import replace

import numpy as np
import pytest

from binocal import acceptance
from binocal.boards import parse_board
from binocal.calibrators import CalibrationRequest, joint
from binocal.errors import DataError, TooFewViewsError
from binocal.evidence import Detections
from binocal.findings import finding
from binocal.geometry import SE3, so3
from binocal.simulation.noise import simulate_detections
from binocal.simulation.rigs import table2_rig
from binocal.simulation.scenes import StereoScene, sample_board_poses
from binocal.solvers import polish, robust
from binocal.solvers.board_views import BundleEstimate, BundleStep
from binocal.solvers.minimization import minimize
from binocal.solvers.polish import polish_exact

BOARD = parse_board("chessboard:8x6:30mm")
RIG = table2_rig()
REQUEST = CalibrationRequest(model="brown4")


def make_case(n_views=6, noise_px=0.2, seed=0):
    rng = np.random.default_rng(seed)
    scene = StereoScene(RIG, BOARD, sample_board_poses(RIG, BOARD, n_views, rng))
    detections = simulate_detections(scene, rng, noise_px=noise_px)
    return detections, joint.joint_problem(detections, REQUEST), BundleEstimate.of_rig(RIG, scene.T_left_board)


def moved(estimate, turn_rad):
    T = estimate.T_right_left
    return replace(estimate, T_right_left=SE3(so3.exp(np.array([0.0, turn_rad, 0.0])) @ T.R, T.t))


def stuck_minimizer(turn_rad, *, is_converged):
    """Ends beside the optimum, as a solve caught in a worse minimum does."""

    def solve(problem, start, options=None, *, scale_px=None):
        minimum = minimize(problem, start, options, scale_px=scale_px)
        away = moved(minimum.estimate, turn_rad)
        equations = problem.linearize(away, minimum.scale_px, minimum.kernel)
        return replace(minimum, estimate=away, equations=equations, is_converged=np.asarray(is_converged))

    return solve


@pytest.mark.parametrize("is_converged", [True, False])
def test_a_second_start_saves_a_solve_that_ended_in_a_worse_minimum(is_converged):
    _, problem, start = make_case()
    best, _ = joint.RobustSolver(stuck_minimizer(0.05, is_converged=is_converged)).solve(problem, start)
    expected = minimize(problem, start)
    assert bool(best.is_converged)
    np.testing.assert_allclose(best.estimate.T_right_left.R, expected.estimate.T_right_left.R, atol=1e-5)


def test_a_second_start_that_is_worse_changes_nothing(monkeypatch):
    _, problem, start = make_case()
    good = minimize(problem, start)
    monkeypatch.setattr(joint, "minimize", stuck_minimizer(0.05, is_converged=True))
    sole = replace(
        good, is_converged=np.asarray(True), scale_px=good.scale_px / 50
    )  # few corners carry weight: try again
    best, _ = joint.RobustSolver(lambda *args, **kwargs: sole).solve(problem, start)
    assert best is sole


def test_convergence_counts_before_cost():
    _, problem, start = make_case()
    good = minimize(problem, start)
    worse = stuck_minimizer(0.01, is_converged=True)(problem, start)
    assert joint._is_better(problem, good, worse) and not joint._is_better(problem, worse, good)
    unfinished = replace(good, is_converged=np.asarray(False))
    assert joint._is_better(problem, worse, unfinished) and not joint._is_better(problem, unfinished, worse)


def test_a_clean_set_must_converge_and_fit_evenly(monkeypatch):
    detections, _, _ = make_case(10)
    assert joint._calibrate_clean(detections, REQUEST, minimize) is not None
    with monkeypatch.context() as patched:
        patched.setattr(joint, "minimize", unfinished)
        assert joint._calibrate_clean(detections, REQUEST, unfinished) is None
    monkeypatch.setattr(acceptance, "fits_evenly", lambda *figures: False)
    assert joint._calibrate_clean(detections, REQUEST, minimize) is None


def unfinished(problem, start, options=None, *, scale_px=None):
    minimum = minimize(problem, start, options, scale_px=scale_px)
    return replace(minimum, is_converged=np.asarray(False))


def test_too_few_views_after_the_last_rejection_are_refused(monkeypatch):
    detections, _, _ = make_case(3)
    contradiction = finding("view-contradicts", camera="left", n_unused=30, n_seen=48, typical_px=5.0)
    monkeypatch.setattr(joint, "_calibrate_clean", lambda *arguments: None)
    monkeypatch.setattr(joint, "_contradicting", lambda *arguments: {0: contradiction})
    with pytest.raises(TooFewViewsError) as caught:
        joint.calibrate_jointly(detections, REQUEST)
    assert caught.value.found == 2 and detections.names[0] in caught.value.rejected


def test_noisy_corners_are_not_polished():
    _, problem, start = make_case()
    minimum = minimize(problem, start)
    assert polish_exact(problem, minimum) is minimum


def test_a_polished_step_that_raises_the_cost_is_not_kept(monkeypatch):
    _, problem, start = make_case(noise_px=1e-6)
    minimum = minimize(problem, moved(start, 1e-4))
    assert minimum.scale_px == robust.SCALE_FLOOR_PX  # exact corners are polished

    def bad_step(problem, estimate, damping):
        n = problem.n_shared
        return BundleStep(np.full(n, 1e-3), np.zeros((6, 6)), np.asarray(np.nan), np.zeros(n), np.asarray(1.0))

    monkeypatch.setattr(polish, "_orthogonal_step", bad_step)
    assert polish_exact(problem, minimum) is minimum


def test_half_a_corner_and_infinite_corners_are_refused():
    detections, _, _ = make_case(3)
    for value, words in (((np.nan, 5.0), "one coordinate is NaN"), ((np.inf, 5.0), "infinite")):
        px = detections.left_px.copy()
        px[1, 2] = value
        with pytest.raises(DataError, match=words):
            Detections.from_arrays(detections.object_points_m, px, detections.right_px, detections.left_size_wh)
