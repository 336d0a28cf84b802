"""The compiled joint step against dense normal equations in NumPy."""

from dataclasses import replace

import numpy as np
import plain_step
import pytest

from binocal.cameras import CAMERA_MODELS, camera_model
from binocal.geometry import so3
from binocal.native import compose_poses, step_poses
from binocal.solvers.bundle import (
    BundleEstimate,
    BundleProblem,
    CameraObservations,
    linearize,
    shared_information,
    solve_step,
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
    rig_pose = (T.R, T.t + 1e-4) if n_cameras == 2 else (None, None)
    return problem, BundleEstimate(parameters, poses.R, poses.t + 1e-4, *rig_pose)


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
    n_views = len(estimate.t_left_board)
    seen = [i for i in range(n_views) if any(c.is_seen[i].any() for c in problem.cameras)]
    step = solve_step(problem, estimate, linearize(problem, estimate, np.asarray(0.5), "cauchy"), np.asarray(damping))
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
    result = shared_information(problem, estimate, linearize(problem, estimate, np.asarray(0.5), "hampel"))
    size = np.sqrt(np.outer(np.diag(H)[:s], np.diag(H)[:s]))
    assert np.abs((result - expected) / size).max() < 1e-12  # measured 2e-14


def test_one_degenerate_rig_of_a_batch_spoils_no_other():
    problem, estimate = make_problem("brown4", intrinsics=False)
    cameras = [
        replace(c, pixels=np.stack([c.pixels, c.pixels]), is_seen=np.stack([c.is_seen, c.is_seen & False]))
        for c in problem.cameras
    ]
    both = replace(problem, cameras=tuple(cameras))
    pair = [np.stack([a, a]) for a in (estimate.R_left_board, estimate.t_left_board, estimate.R_right_left)]
    batch = BundleEstimate(
        tuple(np.stack([p, p]) for p in estimate.parameters), *pair, np.stack([estimate.t_right_left] * 2)
    )
    step = solve_step(both, batch, linearize(both, batch, np.ones(2), "squared"), np.zeros(2))
    single = solve_step(problem, estimate, linearize(problem, estimate, np.ones(()), "squared"), np.zeros(()))
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
