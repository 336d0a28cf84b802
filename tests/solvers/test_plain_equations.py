"""NumPy's equations are the compiled kernel's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from binocal.cameras import CAMERA_MODELS, CameraModel
from binocal.geometry import SE3
from binocal.solvers.board_views import BundleEstimate, BundleProblem, CameraObservations
from rigs import make_detections, make_poses, make_rig


@pytest.fixture(params=[(model, is_batch) for model in CAMERA_MODELS for is_batch in (False, True)])
def problems(request):
    """The same problem for the compiled kernel and for NumPy, and an estimate near its minimum."""
    model, is_batch = request.param
    rig, poses, rng = make_rig(model, skew=0.3), make_poses(4, np.random.default_rng(0)), np.random.default_rng(1)
    corners = make_detections(rig, poses, noise_px=0.3, rng=rng)
    left_px = corners.left_px.copy()
    left_px[1, :30] = np.nan
    left_px[2, 3] += 40
    whitening = np.stack(
        [rng.uniform(0.5, 2, (4, 88)), rng.uniform(-1, 1, (4, 88)), rng.uniform(0.5, 2, (4, 88))], axis=1
    )
    cameras = [
        CameraObservations.from_corners(CAMERA_MODELS[model], px, skew=True, whitening=w)
        for px, w in ((left_px, whitening), (corners.right_px, None))
    ]
    added = replace(CAMERA_MODELS[model], name="not compiled")
    if is_batch:
        cameras = [c.each_view_alone() for c in cameras]
    estimate = BundleEstimate.of_rig(rig, poses[:, None] if is_batch else poses)
    points = np.ascontiguousarray(corners.object_points_m.T)
    compiled = BundleProblem(points, tuple(cameras))
    plain = BundleProblem(points, tuple(replace(c, model=added) for c in cameras))
    assert not added.is_compiled and isinstance(added, CameraModel)
    return compiled, plain, estimate, np.full(4, 0.3) if is_batch else np.array(0.3)


@pytest.mark.parametrize("kernel", ["squared", "cauchy", "hampel"])
def test_equations(problems, kernel):
    compiled, plain, estimate, scale_px = problems
    one, other = (problem.linearize(estimate, scale_px, kernel) for problem in (compiled, plain))
    for a, b in zip(one.cameras, other.cameras, strict=True):
        size = np.abs(a.gram).max(axis=(-1, -2), keepdims=True)
        assert np.abs(a.gram - b.gram).max() < 1e-10 * size.max()
        np.testing.assert_allclose(b.r2_px2, a.r2_px2, rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(b.cost_px2, a.cost_px2, rtol=1e-8)
    for a, b in zip(compiled.residual_lengths2(estimate), plain.residual_lengths2(estimate), strict=True):
        np.testing.assert_allclose(b, a, rtol=1e-8, atol=1e-12)


def test_points_behind_the_camera_are_impossible(problems):
    compiled, plain, estimate, scale_px = problems
    T = estimate.T_left_board
    behind = replace(estimate, T_left_board=SE3(T.R, -T.t))
    for a, b in zip(*(p.linearize(behind, scale_px, "squared").cameras for p in (compiled, plain)), strict=True):
        assert np.array_equal(np.isinf(a.cost_px2), np.isinf(b.cost_px2))
        assert np.isinf(a.cost_px2).any() != compiled.cameras[0].model.sees_behind
