"""Corner weights: the algebra, and the misfit that the covariances do not know of."""

from dataclasses import replace

import numpy as np
import pytest

from binocal.evidence import Detections
from binocal.solvers.whitening import corner_weights, estimate_misfit_px, expected_lengths2, inverse_root


def covariances(rng, *shape):
    root = rng.normal(0, 0.05, (*shape, 2, 2)) + 0.05 * np.eye(2)
    return root @ root.swapaxes(-1, -2)


def detections_with(left, right, n_views=3, n=30, **cross):
    px = np.random.default_rng(0).uniform(0, 400, (2, n_views, n, 2))
    px[0, 1, :4] = np.nan
    points = np.column_stack([np.arange(n), np.arange(n) % 5, np.zeros(n)])
    plain = Detections.from_arrays(points, *px, (640, 480), left_covariance_px2=left, right_covariance_px2=right)
    return replace(plain, **cross)


def test_the_inverse_root_whitens():
    covariance = covariances(np.random.default_rng(1), 3, 30)
    a, b, c = np.moveaxis(inverse_root(covariance, 0.02), 1, 0)
    root = np.stack([np.stack([a, 0 * a], -1), np.stack([b, c], -1)], -2)
    widened = covariance + 0.02**2 * np.eye(2)
    assert np.allclose(root @ widened @ root.swapaxes(-1, -2), np.eye(2), atol=1e-12)


def test_without_covariances_all_corners_are_alike():
    unknown = np.full((3, 30, 2, 2), np.nan)
    assert corner_weights(detections_with(None, None)).is_uniform
    assert corner_weights(detections_with(unknown, None)).is_uniform


def test_equal_corners_weigh_one_and_a_corner_of_unknown_covariance_too():
    equal = np.broadcast_to(0.1**2 * np.eye(2), (3, 30, 2, 2)).copy()
    equal[0, 7] = np.nan
    weights = corner_weights(detections_with(equal, None))
    assert weights.unit_px == pytest.approx(0.1, rel=1e-4)  # the floor of 0.001 px stands beside it
    one = np.broadcast_to(np.array([1.0, 0.0, 1.0])[:, None], (3, 3, 30))
    assert np.allclose(weights.left, one) and np.allclose(weights.right, one)


def test_the_unit_is_the_noise_of_as_many_equal_corners_that_tell_as_much():
    rng = np.random.default_rng(2)
    detections = detections_with(covariances(rng, 3, 30), covariances(rng, 3, 30))
    weights = corner_weights(detections, 0.05)
    seen = np.concatenate([detections.left_is_seen, detections.right_is_seen])
    information = 0.5 * np.sum(np.concatenate([weights.left, weights.right]) ** 2, axis=1)[seen]
    assert information.mean() == pytest.approx(1)
    assert np.array_equal(weights.select(np.array([2, 0])).left, weights.left[[2, 0]])


@pytest.mark.parametrize("misfit_px", [0.0, 0.05, 0.5])
def test_a_misfit_is_found_from_the_residuals(misfit_px):
    # 3000 corners: the median is known to 1.5 %
    rng = np.random.default_rng(3)
    left, right = (np.exp(rng.normal(0, 0.7, (50, 30, 1, 1))) * 0.05**2 * np.eye(2) for _ in range(2))
    detections = detections_with(left, right, 50)
    r2 = [
        np.sum((c[..., 0, 0, None] + misfit_px**2) * rng.standard_normal((50, 30, 2)) ** 2, axis=-1)
        for c in (left, right)
    ]
    assert estimate_misfit_px(detections, tuple(r2)) == pytest.approx(misfit_px, rel=0.05, abs=0.015)


@pytest.mark.usefixtures("unchecked_types")
def test_what_is_no_covariance_is_refused():
    good = covariances(np.random.default_rng(1), 3, 30)
    bad = good.copy()
    bad[2, 5, 0, 0] = -1
    with pytest.raises(ValueError, match="right view 2, corner 5"):
        detections_with(good, bad)
    with pytest.raises(ValueError, match="left covariances must be"):
        detections_with(good[:2], good)


def test_views_are_selected_and_reordered_with_their_covariances():
    good = covariances(np.random.default_rng(1), 3, 30)
    detections = detections_with(good, None)
    assert np.array_equal(detections.select(np.array([2, 1])).left_covariance_px2, good[[2, 1]])
    turned = detections.reorder("left", {1: np.arange(30)[::-1]})
    assert np.array_equal(turned.left_covariance_px2[1], good[1, ::-1])
    assert np.array_equal(turned.left_px[1], detections.left_px[1, ::-1], equal_nan=True)
    assert np.array_equal(turned.left_px[0], detections.left_px[0]) and turned.right_px is not None


def test_no_misfit_is_added_where_the_covariances_are_large_enough():
    wide = np.broadcast_to(0.1**2 * np.eye(2), (3, 30, 2, 2)).copy()
    detections = detections_with(wide, wide)
    residuals = tuple(np.full((3, 30), 0.01**2) for _ in range(2))
    assert estimate_misfit_px(detections, residuals) == 0.0


def test_what_corners_have_in_common_counts_as_if_it_were_each_ones_own():
    rng = np.random.default_rng(4)
    own, cross = covariances(rng, 3, 30), covariances(rng, 3, 30)
    cross[0, 5] = np.nan  # not known: independent
    shared = detections_with(own, own, left_cross_covariance_px2=cross)
    known = np.nan_to_num(cross)
    total = detections_with(own + known, own)
    assert np.allclose(corner_weights(shared, 0.03).left, corner_weights(total, 0.03).left)
    expected, independent = expected_lengths2(shared, 0.03)
    misfit = 0.03**2 * np.eye(2)
    trace = np.trace(np.linalg.inv(own + known + misfit) @ (own + misfit), axis1=-2, axis2=-1)
    assert np.allclose(expected, trace) and expected[0, 5] == pytest.approx(2) and np.all(independent == 2)
    assert expected_lengths2(detections_with(own, own), 0.03) is None


@pytest.mark.usefixtures("unchecked_types")
def test_cross_covariances_go_with_their_corners():
    good = covariances(np.random.default_rng(1), 3, 30)
    detections = detections_with(good, None, left_cross_covariance_px2=2 * good)
    assert np.array_equal(detections.select(np.array([2, 1])).left_cross_covariance_px2, 2 * good[[2, 1]])
    turned = detections.reorder("left", {1: np.arange(30)[::-1]})
    assert np.array_equal(turned.left_cross_covariance_px2[1], 2 * good[1, ::-1])
    with pytest.raises(ValueError, match="left view 0, corner 0: not a covariance"):
        detections_with(good, None, left_cross_covariance_px2=-good)


def test_covariances_of_zero_leave_all_to_the_misfit():
    zero = np.zeros((3, 30, 2, 2))
    stated = detections_with(zero, zero)
    rng = np.random.default_rng(0)
    r2 = tuple(np.square(0.2 * rng.standard_normal((*zero.shape[:2], 2))).sum(axis=-1) for _ in range(2))
    assert estimate_misfit_px(stated, r2) == pytest.approx(0.2, rel=0.1)
