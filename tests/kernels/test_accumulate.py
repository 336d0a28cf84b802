"""The compiled inner loop against central differences and against a plain NumPy statement, and its guards."""

import numpy as np
import plain_accumulate
import pytest

from binocal.cameras import CAMERA_MODELS
from binocal.geometry import so3
from binocal.kernels import accumulate, linearization, squared_lengths, unweighted_columns
from binocal.solvers import robust

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
    result = accumulate(model.name, parameters, R, t, points, pixels, is_seen, np.asarray(scale), kernel)
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


@pytest.mark.parametrize("kernel", ["squared", "cauchy", "hampel"])
@pytest.mark.parametrize("name", list(CAMERA_MODELS))
@pytest.mark.parametrize("n", [1, 4, 7, 20, 88])
def test_the_kernel_equals_the_numpy_statement(name, kernel, n):
    # measured agreement 2e-12 of the entries' size: both sum some hundred rounded products
    model, parameters, R, t, points, pixels, is_seen = make_views(name, 5)
    points = np.resize(points, (3, n)) if n > 20 else points[:, :n]
    pixels, is_seen = np.resize(pixels, (5, 2, n)), np.resize(is_seen, (5, n))
    is_seen[0] = True
    for scale in (400.0, 60.0, 1.0):
        expected_gram, r2, cost = plain_accumulate.accumulate(
            model, parameters, R, t, points, pixels, is_seen, scale, kernel
        )
        result = accumulate(name, parameters, R, t, points, pixels, is_seen, np.asarray(scale), kernel)
        diagonal = np.einsum("vii->vi", expected_gram)
        size = np.sqrt(diagonal[:, :, None] * diagonal[:, None]) + 1e-9
        assert np.abs((result.gram - expected_gram) / size).max() < 1e-10
        assert np.allclose(result.r2_px2, r2, rtol=1e-12)
        assert np.allclose(result.cost_px2, cost, rtol=1e-12)


@pytest.mark.parametrize("name", list(CAMERA_MODELS))
def test_columns_and_lengths_equal_the_numpy_statement(name):
    model, parameters, R, t, points, pixels, is_seen = make_views(name)
    expected, _ = plain_accumulate.unweighted_columns(model, parameters, R, t, points, pixels, is_seen)
    columns = unweighted_columns(name, parameters, R, t, points, pixels, is_seen)
    assert np.allclose(columns, expected.reshape(columns.shape), rtol=1e-11, atol=1e-9)
    lengths2 = squared_lengths(name, parameters, R, t, points, pixels, is_seen)
    assert np.allclose(lengths2, np.sum(expected[:, -1] ** 2, axis=1), rtol=1e-11)


@pytest.mark.parametrize("kernel", ["squared", "cauchy", "hampel"])
@pytest.mark.parametrize("name", list(CAMERA_MODELS))
def test_whitened_equations_equal_the_numpy_statement(name, kernel):
    model, parameters, R, t, points, pixels, is_seen = make_views(name)
    whitening = np.random.default_rng(1).uniform(0.2, 2.0, (len(R), 3, is_seen.shape[1]))
    expected_gram, r2, cost = plain_accumulate.accumulate(
        model, parameters, R, t, points, pixels, is_seen, 60.0, kernel, whitening
    )
    views = (name, parameters, R, t, points, pixels, is_seen)
    result = accumulate(*views, np.asarray(60.0), kernel, whitening=whitening)
    diagonal = np.einsum("vii->vi", expected_gram)
    size = np.sqrt(diagonal[:, :, None] * diagonal[:, None]) + 1e-9
    assert np.abs((result.gram - expected_gram) / size).max() < 1e-10  # measured 1e-12
    assert np.allclose(result.r2_px2, r2, rtol=1e-12) and np.allclose(result.cost_px2, cost, rtol=1e-12)
    assert np.allclose(squared_lengths(*views, whitening), r2, rtol=1e-11)


@pytest.mark.parametrize("name", list(CAMERA_MODELS))
def test_unit_whitening_changes_nothing(name):
    _, *views = make_views(name)
    one = np.broadcast_to(np.array([1.0, 0.0, 1.0])[:, None], (3, 3, views[-1].shape[1]))
    plain = accumulate(name, *views, np.asarray(60.0), "hampel")
    whitened = accumulate(name, *views, np.asarray(60.0), "hampel", whitening=one)
    assert np.allclose(whitened.gram, plain.gram, rtol=1e-13) and np.allclose(whitened.r2_px2, plain.r2_px2, rtol=1e-13)


@pytest.mark.parametrize("free", [(), (0,), (0, 1, 2, 3, 5, 6, 7, 8)])
def test_held_parameters_get_no_columns(free):
    model, parameters, R, t, points, pixels, is_seen = make_views("brown8")
    is_free = np.isin(np.arange(model.n_parameters), free)
    whole = accumulate("brown8", parameters, R, t, points, pixels, is_seen, np.asarray(60.0), "hampel")
    part = accumulate("brown8", parameters, R, t, points, pixels, is_seen, np.asarray(60.0), "hampel", is_free)
    keep = np.r_[is_free, np.ones(7, dtype=bool)]
    assert np.allclose(part.gram, whole.gram[:, keep][:, :, keep], rtol=1e-12)
    assert np.array_equal(part.cost_px2, whole.cost_px2)


def test_the_number_of_threads_changes_nothing(monkeypatch):
    views = make_views("brown5", 401)
    one = accumulate(views[0].name, *views[1:], np.asarray(60.0), "cauchy")
    monkeypatch.setattr(linearization, "threads_for", lambda n_corners: 3)
    three = accumulate(views[0].name, *views[1:], np.asarray(60.0), "cauchy")
    assert np.array_equal(one.gram, three.gram) and np.array_equal(one.cost_px2, three.cost_px2)


@pytest.mark.parametrize("name", ["brown5", "fisheye4"])
def test_a_corner_in_the_camera_centre_costs_infinity_and_spoils_no_other_view(name):
    model, parameters, R, t, points, pixels, is_seen = make_views(name)
    t = t.copy()
    t[1] = -R[1] @ points[:, 3]
    is_seen[1, 3] = True
    result = accumulate(name, parameters, R, t, points, pixels, is_seen, np.asarray(60.0), "hampel")
    if not model.sees_behind:
        assert np.isinf(result.cost_px2[1]) and np.isinf(
            squared_lengths(name, parameters, R, t, points, pixels, is_seen)[1, 3]
        )
    assert np.isfinite(result.cost_px2[[0, 2]]).all() and np.isfinite(result.gram[[0, 2]]).all()


@pytest.mark.usefixtures("unchecked_types")
def test_wrong_shapes_are_refused():
    _, parameters, R, t, points, pixels, is_seen = make_views("brown5")
    with pytest.raises(ValueError, match="number of parameters"):
        accumulate("brown5", parameters[:-1], R, t, points, pixels, is_seen, np.asarray(1.0), "hampel")
    with pytest.raises(ValueError, match="views, 2, n"):
        accumulate("brown5", parameters, R, t, points, pixels[:-1], is_seen, np.asarray(1.0), "hampel")
    with pytest.raises(ValueError, match="views, 3, n"):
        squared_lengths("brown5", parameters, R, t, points, pixels, is_seen, np.ones((2, 3, 20)))
    with pytest.raises(ValueError, match="camera model"):
        accumulate("pinhole", parameters, R, t, points, pixels, is_seen, np.asarray(1.0), "hampel")


def test_a_batch_of_rigs_equals_its_members():
    model, parameters, R, t, points, pixels, is_seen = make_views("brown5", 6)
    stacked = np.stack([parameters, parameters * 1.01])
    shape = (2, 3)
    batch = accumulate(
        model.name,
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
            model.name,
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
    cost = accumulate(model.name, parameters, R, behind, points, pixels, is_seen, np.asarray(1.0), "squared").cost_px2
    assert np.all(np.isinf(cost))


@pytest.mark.parametrize("depth_m", [0.5, 3.0])
@pytest.mark.parametrize("off_axis", [0.0, 1e-160, 1e-12, 1e-5])
def test_a_fisheye_is_smooth_across_its_axis(depth_m, off_axis):
    # there x = X / Z to third order, whatever the coefficients: columns have a limit, though radius and angle are 0 / 0
    parameters, f = np.r_[800.0, 820, 640, 480, 2.0, DISTORTIONS["fisheye4"]], np.array([800.0, 820])
    t = np.array([[off_axis, -off_axis, depth_m]])
    views = parameters, np.eye(3)[None], t, np.zeros((3, 1)), np.zeros((1, 2, 1)), np.ones((1, 1), bool)
    columns = unweighted_columns("fisheye4", *views)[0]
    expected = [[f[0] / depth_m, 0], [2.0 / depth_m, f[1] / depth_m]]
    assert np.allclose(columns[12:14], expected, rtol=1e-8, atol=1e-5)
    assert np.allclose(columns[5:9], 0, atol=1e-10) and np.allclose(columns[14], -t[0, :2] * f / depth_m**2, atol=0.01)
    assert np.allclose(columns[15], -parameters[2:4], atol=0.02)
    assert np.isfinite(accumulate("fisheye4", *views, np.asarray(1.0), "hampel").gram).all()


def test_a_fisheye_sees_to_the_side_and_behind():
    angles = np.concatenate([np.linspace(0.01, 3.1, 200), [np.pi / 2, np.pi / 4, 3 * np.pi / 4]])
    points = np.stack([np.sin(angles), np.zeros_like(angles), np.cos(angles)])
    parameters, n = np.r_[1.0, 1, 0, 0, np.zeros(5)], len(angles)
    views = np.eye(3)[None], np.zeros((1, 3)), points, np.zeros((1, 2, n)), np.ones((1, n), bool)
    lengths = np.sqrt(squared_lengths("fisheye4", parameters, *views)[0])
    assert np.allclose(lengths, angles, rtol=1e-15, atol=1e-15)  # without distortion the image is the angle itself
