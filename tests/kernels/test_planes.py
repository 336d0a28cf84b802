"""Compiled homographies against the plain statement of the same formulas in binocal.geometry.homography."""

import numpy as np
import pytest

from binocal.geometry.homography import PlaneFrame, map_plane, plane_moments, solve_plane
from binocal.kernels import fit_planes, transforms


def make_views(n, n_views=5, seed=0):
    rng = np.random.default_rng(seed)
    points = np.zeros((n, 3))
    points[:, :2] = rng.uniform(0, 0.3, (n, 2))
    frame = PlaneFrame.of(points)
    rows = np.eye(3) + rng.uniform(-0.15, 0.15, (n_views, 3, 3))
    rows[:, 2, 2] = 1.0
    u, v, _ = map_plane(rows, frame.xy)
    w = rng.uniform(0.2, 2.0, u.shape) * (rng.random(u.shape) > 0.1 * (n > 10))
    return frame, u + 1e-3 * rng.standard_normal(u.shape), v + 1e-3 * rng.standard_normal(u.shape), w


@pytest.mark.parametrize("n", [6, 8, 13, 88])
@pytest.mark.parametrize("n_passes", [1, 2, 3])
def test_the_kernel_equals_the_numpy_statement(n, n_passes):
    frame, u, v, w = make_views(n)
    weights = w
    for _ in range(n_passes):
        expected = solve_plane(plane_moments(frame.basis, u, v, weights))
        u_fit, v_fit, depth = map_plane(expected.rows, frame.xy)
        weights = w / np.maximum(depth * depth, 1e-2)
    rows, S_inverse, P, D_inverse, du, dv = fit_planes(frame.xy, u, v, w, n_passes)
    # six points leave D nearly singular: rounding grows to 1e-10 there; else 1e-13 is measured
    for got, wanted in ((rows, expected.rows), (S_inverse, expected.S_inverse), (P, expected.P)):
        assert np.allclose(got, wanted, rtol=1e-8, atol=1e-9)
    assert np.allclose(D_inverse, expected.D_inverse, rtol=1e-6)
    assert np.allclose(du, u - u_fit, atol=1e-9) and np.allclose(dv, v - v_fit, atol=1e-9)


def test_leading_dimensions_and_threads_change_nothing(monkeypatch):
    frame, u, v, w = make_views(20, 6)
    one = fit_planes(frame.xy, u, v, w, 2)
    monkeypatch.setattr(transforms, "threads_for", lambda n_corners: 3)
    folded = fit_planes(frame.xy, *(a.reshape(2, 3, 20) for a in (u, v, w)), 2)
    assert folded[2].shape == (2, 3, 3, 6)
    assert all(np.array_equal(a, b.reshape(a.shape)) for a, b in zip(one, folded, strict=True))


def test_a_view_without_corners_is_nan_and_spoils_no_other():
    frame, u, v, w = make_views(10)
    expected = fit_planes(frame.xy, u, v, w, 2)[0]
    w[2] = 0
    rows = fit_planes(frame.xy, u, v, w, 2)[0]
    others = np.arange(len(w)) != 2
    assert not np.isfinite(rows[2, :2]).any() and np.array_equal(rows[others], expected[others])


@pytest.mark.usefixtures("unchecked_types")
def test_wrong_shapes_are_refused():
    frame, u, v, w = make_views(10)
    with pytest.raises(ValueError, match="views, n"):
        fit_planes(frame.xy, u, v[:-1], w, 1)
