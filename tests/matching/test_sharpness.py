"""The spread of edges: of one image to the blur that made it, of two images whatever their gain, noise and other textures."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from binocal.matching.sharpness import MIN_SHARED, edge_spreads_px, pair_spreads_px

SIZE = (300, 240)
POINTS = np.stack(np.meshgrid(np.arange(30.0, 140, 22), np.arange(30.0, 215, 22)), axis=-1).reshape(-1, 2)


def texture(rng, size_px):
    """Blotches of one size and smaller, as an eight-bit camera's light."""
    width, height = SIZE
    coarse = rng.normal(size=(int(height / size_px) + 2, int(width / size_px) + 2)).astype(np.float32)
    return 120 + 30 * cv2.resize(coarse, SIZE, interpolation=cv2.INTER_NEAREST)


def seen(light, rng, *, blur_px=0.8, gain=1.0, noise=1.0):
    return (
        np.clip(gain * cv2.GaussianBlur(light, (0, 0), blur_px) + rng.normal(0, noise, light.shape), 0, 255)
        .round()
        .astype(np.uint8)
    )


@pytest.mark.parametrize(("gain", "noise"), [(1.0, 1.0), (0.25, 1.0), (0.5, 3.0), (1.0, 8.0), (1.5, 1.0)])
@pytest.mark.parametrize(("blur_px", "ratio"), [(0.8, 1.0), (1.7, 1.41)])
def test_two_images_are_compared_whatever_their_gain_and_noise(gain, noise, blur_px, ratio):
    rng = np.random.default_rng(0)
    light = texture(rng, 12.0)
    left, right = seen(light, rng), seen(light, rng, gain=gain, noise=noise, blur_px=blur_px)
    a, b = pair_spreads_px((left, right), (POINTS, POINTS), (POINTS, POINTS))
    assert b / a == pytest.approx(ratio, rel=0.05)


def test_other_textures_beside_do_not_count():
    """What one camera sees alone, fine leaves or a smooth wall, has other edges; things that both see have the same."""
    rng = np.random.default_rng(1)
    light = texture(rng, 12.0)
    leaves = light.copy()
    leaves[:, 160:] = texture(rng, 2.0)[:, 160:]
    left, right = seen(light, rng), seen(leaves, rng)
    beyond = POINTS + [140.0, 0.0]
    features = np.concatenate([POINTS, beyond, beyond])
    a, b = pair_spreads_px((left, right), (features, features), (POINTS, POINTS))
    assert b / a == pytest.approx(1.0, abs=0.03)
    few = POINTS[: MIN_SHARED - 1]
    a, b = pair_spreads_px((left, right), (features, features), (few, few))
    assert b / a < 0.9  # too few to compare: each at its own features
    assert np.isnan(pair_spreads_px((left, right), (POINTS[:0], POINTS[:0]), (few[:0], few[:0]))).all()


def test_a_flat_image_has_no_width():
    flat = np.full(SIZE[::-1], 90, np.uint8)
    assert (edge_spreads_px(flat, POINTS) == 0).all()
