"""Template matching: known warps are found to a hundredth of a pixel, and what cannot be matched says so."""

from __future__ import annotations

import numpy as np
import pytest

from binocal.kernels.template_match import match_templates

H, W = 160, 200
CENTRES = np.array([[60.3, 70.8], [100.0, 80.0], [130.25, 90.5]])


def texture(x, y):
    """A smooth function of the place with detail down to five pixels."""
    rng = np.random.default_rng(0)
    value = np.zeros(np.broadcast(x, y).shape)
    for _ in range(60):
        k, phase = rng.normal(0, 0.35, 2), rng.uniform(0, 2 * np.pi)
        value += rng.normal() * np.cos(k[0] * x + k[1] * y + phase)
    return 128 + 12 * value


def images(A, shift, gain=1.0, offset=0.0):
    """An image, and one in which what lies at p appears at A (p - c) + c + shift."""
    y, x = np.mgrid[:H, :W].astype(float)
    centre = np.array([W / 2, H / 2])
    back = np.linalg.inv(A)
    q = (np.stack([x, y], axis=-1) - centre - shift) @ back.T + centre
    return texture(x, y).astype(np.float32), (gain * texture(q[..., 0], q[..., 1]) + offset).astype(np.float32)


@pytest.mark.parametrize("half", [5, 9])
@pytest.mark.parametrize(
    ("A", "shift", "gain", "offset"),
    [
        (np.eye(2), [0.37, -0.61], 1.0, 0.0),
        (np.array([[1.06, 0.05], [-0.04, 0.95]]), [3.2, -1.7], 0.8, 15.0),
        (np.array([[0.9, -0.1], [0.08, 1.1]]), [-5.5, 2.25], 1.3, -10.0),
    ],
)
def test_affine_warps_with_gain_and_offset_are_found(half, A, shift, gain, offset):
    first, second = images(A, shift, gain, offset)
    centre = np.array([W / 2, H / 2])
    truth = (CENTRES - centre) @ A.T + centre + shift
    found = match_templates(first, second, CENTRES, truth + [0.8, -0.6], half=half, max_iterations=30)
    assert found.is_converged.all() and (found.likeness > 0.999).all()
    np.testing.assert_allclose(found.points_px, truth, atol=0.02)
    np.testing.assert_allclose(found.warp, np.broadcast_to(A, (3, 2, 2)), atol=0.02)


def test_the_covariance_is_that_of_noise():
    """Measured over 60 draws; stated from the residuals of one image pair each, both images noisy."""
    rng = np.random.default_rng(1)
    first, second = images(np.eye(2), [0.4, 0.3])
    errors, stated = [], []
    for _ in range(60):
        noisy = [(image + rng.normal(0, 4, image.shape)).astype(np.float32) for image in (first, second)]
        found = match_templates(*noisy, CENTRES, CENTRES + [0.4, 0.3], half=7, max_iterations=30)
        errors.append(found.points_px - CENTRES - [0.4, 0.3])
        stated.append(found.covariance_px2[:, [0, 2]])
    ratio = np.sqrt(np.mean(np.square(errors)) / np.mean(stated))
    assert 0.5 < ratio < 2.0  # the windows' weights are no noise model: order of magnitude


def test_what_cannot_be_matched_is_not():
    first, second = images(np.eye(2), [0.0, 0.0])
    flat = np.full_like(first, 128.0)
    assert not match_templates(flat, second, CENTRES, CENTRES).is_converged.any()
    border = np.array([[2.0, 2.0], [W - 1.0, 50.0], [np.nan, 5.0]])
    found = match_templates(first, second, border, border)
    assert not found.is_converged.any() and np.isnan(found.points_px).all()
    other = np.random.default_rng(0).normal(128, 30, first.shape).astype(np.float32)
    found = match_templates(first, other, CENTRES, CENTRES)
    assert not (found.is_converged & (found.likeness > 0.9)).any()


@pytest.mark.parametrize("size", [(0, 0), (1, 5), (7, 8), (8, 8), (9, 40), (40, 41)])
def test_places_that_no_integer_holds_match_nothing(size):
    """NaN became the least of all integers, and three below that the greatest: memory far beyond the image was read."""
    image = np.random.default_rng(0).normal(128, 30, size).astype(np.float32)
    odd = [
        np.nan,
        np.inf,
        -np.inf,
        1e300,
        -1e300,
        2.0**63,
        -(2.0**63),
        9.3e18,
        2.0**31,
        -1.0,
        0.0,
        2.999,
        size[0] - 4.999,
    ]
    x, y = (values.ravel() for values in np.meshgrid([*odd, 20.0], [*odd, 20.0]))
    places = np.column_stack([x, y])
    inside = np.full_like(places, 20.0)
    for start, goal in ((places, inside), (inside, places)):
        found = match_templates(image, image, start, goal, half=2)
        is_same = found.is_converged & (np.abs(found.points_px - start) < 1).all(axis=1)
        assert is_same.sum() == (found.likeness > 0.999).sum() == (1 if min(size) == 40 else 0)
    warp = np.full((len(odd), 2, 2), np.array(odd)[:, None, None])
    found = match_templates(image, image, inside[: len(odd)], inside[: len(odd)], warp, half=2)
    assert not found.is_converged.any()


def test_wrong_arrays_are_refused():
    first, second = images(np.eye(2), [0.0, 0.0])
    with pytest.raises(ValueError, match="2 to 15"):
        match_templates(first, second, CENTRES, CENTRES, half=16)
