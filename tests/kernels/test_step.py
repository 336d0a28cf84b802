"""The compiled joint step against dense normal equations in NumPy."""

from dataclasses import replace

import numpy as np
import plain_step
import pytest

from binocal.cameras import CAMERA_MODELS, camera_model
from binocal.geometry import SE3, so3
from binocal.kernels import compose_poses, step_poses
from binocal.solvers.arrays import stack_rigs
from binocal.solvers.board_views import (
    BundleEstimate,
    BundleProblem,
    CameraObservations,
)
from rigs import make_detections, make_poses, make_rig


def make_problem(model, *, skew=False, intrinsics=True, is_rig_free=True, n_views=5, n_cameras=2, seed=0):
    rng = np.random.default_rng(seed)
    rig, poses = make_rig(model, skew=0.5 if skew else 0.0), make_poses(n_views, rng)
    detections = make_detections(rig, poses, noise_px=0.3, rng=rng)
    corners = [px.copy() for px in (detections.left_px, detections.right_px)]
    corners[1][1, ::3] = np.nan
    corners[0][2] = np.nan
    cameras = [
        CameraObservations.from_corners(camera_model(model), px, skew=skew, intrinsics=intrinsics) for px in corners
    ]
    points = np.ascontiguousarray(detections.object_points_m.T)
    problem = BundleProblem(points, tuple(cameras[:n_cameras]), is_rig_free)
    T = rig.T_right_left
    parameters = (rig.left.parameters * 1.001, rig.right.parameters * 0.999)[:n_cameras]
    T_right_left = SE3(T.R, T.t + 1e-4)
    return problem, BundleEstimate(parameters, SE3(poses.R, poses.t + 1e-4), T_right_left)


CASES = [
    *({"model": name} for name in CAMERA_MODELS),
    {"model": "brown8", "skew": True},
    {"model": "brown4", "intrinsics": False},
    {"model": "brown4", "is_rig_free": False},
    {"model": "brown5", "n_cameras": 1},
]


@pytest.mark.parametrize("damping", [1e-3, 10.0])
@pytest.mark.parametrize("case", CASES, ids=str)
def test_the_step_equals_the_dense_one(case, damping):
    # measured: 1e-8 of the step's length in sigmas (brown8, condition 1e10), 1e-12 for the other models
    problem, estimate = make_problem(**case)
    n_views = len(estimate.T_left_board.t)
    seen = [i for i in range(n_views) if any(c.is_seen[i].any() for c in problem.cameras)]
    step = problem.solve_step(estimate, problem.linearize(estimate, np.asarray(0.5), "cauchy"), np.asarray(damping))
    H, g = plain_step.normal_equations(problem, estimate, 0.5, "cauchy")
    s = problem.n_shared
    keep = np.r_[np.arange(s), *(s + 6 * i + np.arange(6) for i in seen)]
    H, g = H[np.ix_(keep, keep)], g[keep]
    expected, predicted = plain_step.solve(H, g, damping)
    difference = np.r_[step.shared, step.views[seen].ravel()] - expected
    assert difference @ H @ difference < 1e-12 * (expected @ H @ expected)
    assert step.predicted_px2 == pytest.approx(predicted, rel=1e-9)
    assert not np.any(np.delete(step.views, seen, axis=0))


def test_the_shared_information_is_the_schur_complement():
    problem, estimate = make_problem("brown5")
    H, _ = plain_step.normal_equations(problem, estimate, 0.5, "hampel")
    s = problem.n_shared
    expected = H[:s, :s] - H[:s, s:] @ np.linalg.solve(H[s:, s:], H[s:, :s])
    result = problem.shared_information(estimate, problem.linearize(estimate, np.asarray(0.5), "hampel"))
    size = np.sqrt(np.outer(np.diag(H)[:s], np.diag(H)[:s]))
    assert np.abs((result - expected) / size).max() < 1e-12  # measured 2e-14


def test_one_degenerate_rig_of_a_batch_spoils_no_other():
    problem, estimate = make_problem("brown4", intrinsics=False)
    cameras = [
        replace(c, pixels=np.stack([c.pixels, c.pixels]), is_seen=np.stack([c.is_seen, c.is_seen & False]))
        for c in problem.cameras
    ]
    both = replace(problem, cameras=tuple(cameras))
    batch = stack_rigs([estimate, estimate])
    step = both.solve_step(batch, both.linearize(batch, np.ones(2), "squared"), np.zeros(2))
    single = problem.solve_step(estimate, problem.linearize(estimate, np.ones(()), "squared"), np.zeros(()))
    assert np.isnan(step.predicted_px2[1]) and np.isnan(step.shared[1]).all()
    assert np.array_equal(step.shared[0], single.shared) and np.array_equal(step.views[0], single.views)


@pytest.mark.parametrize("angle_rad", [0.0, 1e-9, 0.99e-4, 1.01e-4, 0.3, 3.0])
def test_poses_step_and_compose_like_their_matrices(angle_rad):
    rng = np.random.default_rng(3)
    R, t = so3.exp(rng.standard_normal((2, 4, 3))), rng.standard_normal((2, 4, 3))
    axis = rng.standard_normal((2, 4, 3))
    omega = angle_rad * axis / np.linalg.norm(axis, axis=-1, keepdims=True)
    xi = np.concatenate([omega, rng.standard_normal((2, 4, 3))], axis=-1)
    R_new, t_new = step_poses(R, t, xi)
    turn = so3.exp(omega)
    assert np.allclose(R_new, turn @ R, atol=1e-15) and np.allclose(
        t_new, (turn @ t[..., None])[..., 0] + xi[..., 3:], atol=1e-14
    )
    R_both, t_both = compose_poses(R[:, 0], t[:, 0], R, t)
    assert np.allclose(R_both, R[:, :1] @ R, atol=1e-15)
    assert np.allclose(t_both, (R[:, :1] @ t[..., None])[..., 0] + t[:, :1], atol=1e-14)


@pytest.mark.parametrize("intrinsics", [False, True])
def test_an_altered_step_lets_the_views_take_their_best(intrinsics):
    # the altered shared step is given; the views then solve their own dense equations, and the fall is the dense quadratic's
    problem, estimate = make_problem("brown4", intrinsics=intrinsics)
    equations, s = problem.linearize(estimate, np.asarray(0.5), "cauchy"), problem.n_shared
    H, g = plain_step.normal_equations(problem, estimate, 0.5, "cauchy")
    plain = problem.solve_step(estimate, equations, np.zeros(()))
    stretched = problem.solve_step(estimate, equations, np.zeros(()), np.array([1.3, 0.8]))
    given = np.array([1e-3, -2e-3, 5e-4, 1e-4, 2e-4, -3e-4])
    shifted = problem.solve_step(estimate, equations, np.zeros(()), increment=given)
    assert np.allclose(stretched.shared[-6:], plain.shared[-6:] * np.repeat([1.3, 0.8], 3), rtol=1e-12)
    assert np.allclose(stretched.shared[:-6], plain.shared[:-6], rtol=1e-12)
    assert np.allclose(shifted.shared[-6:], given, rtol=1e-9)
    for step in (stretched, shifted):
        views = np.linalg.solve(H[s:, s:], g[s:] - H[s:, :s] @ step.shared)
        assert np.allclose(step.views.ravel(), views, rtol=1e-6, atol=1e-12)
        whole = np.r_[step.shared, views]
        assert step.predicted_px2 == pytest.approx(whole @ g - 0.5 * whole @ H @ whole, rel=1e-7)


def test_pose_damping_holds_the_boards_and_not_the_rig():
    problem, estimate = make_problem("brown4", intrinsics=False)
    equations, s = problem.linearize(estimate, np.asarray(0.5), "cauchy"), problem.n_shared
    H, g = plain_step.normal_equations(problem, estimate, 0.5, "cauchy")
    step = problem.solve_step(estimate, equations, np.asarray(0.1), pose_damping=np.asarray(50.0))
    damped = H.copy()
    diagonal = np.diag(H)
    damped[np.diag_indices_from(damped)] = diagonal * np.r_[np.full(s, 1.1), np.full(len(H) - s, 51.0)]
    expected = np.linalg.solve(damped, g)
    assert np.allclose(np.r_[step.shared, step.views.ravel()], expected, rtol=1e-8, atol=1e-13)
    assert step.predicted_px2 == pytest.approx(expected @ g - 0.5 * expected @ H @ expected, rel=1e-9)


def test_a_view_that_its_corners_do_not_determine_spoils_no_other():
    # two corners leave a pose loose: the step of everything else is as if the view were not there
    problem, estimate = make_problem("brown4", intrinsics=False)
    few = [c.is_seen.copy() for c in problem.cameras]
    for is_seen in few:
        is_seen[3] = False
    few[0][3, :2] = True
    loose = replace(problem, cameras=tuple(replace(c, is_seen=f) for c, f in zip(problem.cameras, few, strict=True)))
    few[0][3] = False
    without = replace(problem, cameras=tuple(replace(c, is_seen=f) for c, f in zip(problem.cameras, few, strict=True)))
    steps = [
        p.solve_step(estimate, p.linearize(estimate, np.asarray(0.5), "cauchy"), np.zeros(())) for p in (loose, without)
    ]
    assert np.isfinite(steps[0].predicted_px2)
    assert np.allclose(steps[0].shared, steps[1].shared, rtol=1e-9)
    assert not np.any(steps[0].views[3])


def test_gradient_and_least_pivot_describe_the_reduced_equations():
    problem, estimate = make_problem("brown4", intrinsics=False)
    H, g = plain_step.normal_equations(problem, estimate, 0.5, "cauchy")
    s = problem.n_shared
    eliminate = H[:s, s:] @ np.linalg.inv(H[s:, s:])
    step = problem.solve_step(estimate, problem.linearize(estimate, np.asarray(0.5), "cauchy"), np.zeros(()))
    assert np.allclose(step.gradient_px2, g[:s] - eliminate @ g[s:], rtol=1e-8)
    assert 0 < step.least_pivot <= 1
