"""The inner loop against a plain statement of the same formula, and its guards."""

import numpy as np
import pytest

from binocal.cameras import CAMERA_MODELS
from binocal.geometry import so3
from binocal.solvers import robust
from binocal.solvers.accumulate import accumulate

DISTORTIONS = {
    "brown4": [-0.2, 0.05, 1e-3, -2e-3],
    "brown5": [-0.2, 0.05, 1e-3, -2e-3, 0.01],
    "brown8": [-0.2, 0.05, 1e-3, -2e-3, 0.01, 0.1, 0.02, 0.003],
    "fisheye4": [0.01, -0.02, 0.003, -0.001],
}


def make_views(name, n_views=3, seed=0):
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(np.arange(5), np.arange(4)), -1).reshape(-1, 2) * 0.07
    points = np.zeros((3, len(grid)))
    points[:2] = grid.T
    parameters = np.r_[800, 820, 640, 480, 2.0, DISTORTIONS[name]]
    R = so3.exp(0.3 * rng.standard_normal((n_views, 3)))
    t = rng.normal(0, 0.02, (n_views, 3)) + [0, 0, 0.5]
    pixels = rng.uniform(0, 900, (n_views, 2, len(grid)))
    is_seen = rng.random((n_views, len(grid))) > 0.2
    return CAMERA_MODELS[name], parameters, R, t, points, pixels, is_seen


def plain_residuals(model, parameters, R, t, points, pixels):
    X = R @ points + t[:, None]
    return pixels - np.stack(model.project(parameters, *X))


@pytest.mark.parametrize("kernel", ["squared", "cauchy", "hampel"])
@pytest.mark.parametrize("name", list(CAMERA_MODELS))
def test_gram_equals_the_plain_formula(name, kernel):
    # central differences, step 1e-6 of the value (1e-4 for distortion): measured agreement 1e-7 of the entries' size,
    # bound 2e-6
    model, parameters, R, t, points, pixels, is_seen = make_views(name)
    scale = 60.0
    result = accumulate(model, parameters, R, t, points, pixels, is_seen, np.asarray(scale), kernel)
    for view in range(len(R)):
        columns = []
        for i in range(len(parameters)):
            h = 1e-6 * abs(parameters[i]) if i < 4 else 1e-4
            step = np.eye(len(parameters))[i] * h
            plus = plain_residuals(model, parameters + step, R[view], t[view], points, pixels[view])
            minus = plain_residuals(model, parameters - step, R[view], t[view], points, pixels[view])
            columns.append((minus - plus) / (2 * h))
        for i in range(6):
            moved = []
            for sign in (1, -1):
                xi = np.eye(6)[i] * 1e-6 * sign
                turn = so3.exp(xi[:3])
                moved.append(
                    plain_residuals(model, parameters, turn @ R[view], turn @ t[view] + xi[3:], points, pixels[view])
                )
            columns.append((moved[1] - moved[0]) / 2e-6)
        residual = plain_residuals(model, parameters, R[view], t[view], points, pixels[view])
        r2 = np.where(is_seen[view], (residual**2).sum(axis=0), 0.0)
        weight = robust.weights(r2, np.asarray(scale), kernel) * is_seen[view]
        J = np.array([*columns, residual])
        expected = np.einsum("acn,n,bcn->ab", J, weight, J)
        size = np.sqrt(np.outer(np.diag(expected), np.diag(expected))) + 1e-12
        assert np.abs((result.gram[view] - expected) / size).max() < 2e-6
        assert np.allclose(result.r2_px2[view], r2, rtol=1e-12)
        assert result.cost_px2[view] == pytest.approx(robust.costs(r2, np.asarray(scale), kernel).sum(), rel=1e-12)


def test_a_batch_of_rigs_equals_its_members():
    model, parameters, R, t, points, pixels, is_seen = make_views("brown5", 6)
    stacked = np.stack([parameters, parameters * 1.01])
    shape = (2, 3)
    batch = accumulate(
        model,
        stacked,
        R.reshape(*shape, 3, 3),
        t.reshape(*shape, 3),
        points,
        pixels.reshape(*shape, *pixels.shape[1:]),
        is_seen.reshape(*shape, -1),
        np.array([1.0, 2.0]),
        "hampel",
    )
    for rig in range(2):
        views = slice(3 * rig, 3 * rig + 3)
        single = accumulate(
            model,
            stacked[rig],
            R[views],
            t[views],
            points,
            pixels[views],
            is_seen[views],
            np.asarray([1.0, 2.0][rig]),
            "hampel",
        )
        assert np.allclose(batch.gram[rig], single.gram, rtol=1e-12)
        assert np.array_equal(batch.cost_px2[rig], single.cost_px2)


def test_a_corner_behind_the_camera_costs_infinity():
    model, parameters, R, t, points, pixels, is_seen = make_views("brown4")
    behind = t * [1, 1, -1]
    cost = accumulate(model, parameters, R, behind, points, pixels, is_seen, np.asarray(1.0), "squared").cost_px2
    assert np.all(np.isinf(cost))


@pytest.mark.parametrize("kernel", ["cauchy", "hampel"])
def test_weights_are_the_slope_of_the_cost(kernel):
    r = np.linspace(0.01, 12, 400)
    scale = np.asarray(1.3)
    slope = (robust.costs((r + 1e-6) ** 2, scale, kernel) - robust.costs((r - 1e-6) ** 2, scale, kernel)) / 2e-6
    assert np.abs(slope - robust.weights(r * r, scale, kernel) * r).max() < 1e-5


def test_the_median_scale_is_unbiased_and_floored():
    r2 = (np.random.default_rng(0).normal(0, 0.3, (2, 20000)) ** 2).sum(axis=0)
    seen = np.ones(20000, dtype=bool)
    assert robust.scale_from_median(r2, seen) == pytest.approx(0.3, rel=0.02)
    seen[::3] = False
    assert robust.scale_from_median(np.where(seen, r2, 0), seen) == pytest.approx(0.3, rel=0.02)
    assert robust.scale_from_median(np.zeros(10), np.ones(10, dtype=bool)) == robust.SCALE_FLOOR_PX
