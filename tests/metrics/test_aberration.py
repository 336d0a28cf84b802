"""Lateral chromatic aberration from corners in two colours."""

from __future__ import annotations

import numpy as np
import pytest

from binocal.metrics.aberration import chromatic_aberration

SIZE = (640, 480)
MIDDLE = (np.array(SIZE) - 1) / 2
CORNER = float(np.hypot(320, 240))


def draw(rng, a, b, shift=(0.0, 0.0), noise_px=0.02, n_views=8, reach=0.7):
    """Corners in green, and in another colour a radial a r + b r³ (px in the image's corner) and a shift away."""
    at = rng.uniform(-reach, reach, (n_views, 40, 2)) * MIDDLE
    radius = np.hypot(*np.moveaxis(at, -1, 0))[..., None] / CORNER
    moved = at + at / CORNER * (a + b * radius**2) + shift
    noise = rng.normal(0, noise_px, (2, *at.shape))
    return MIDDLE + at + noise[0], MIDDLE + moved + noise[1]


def test_a_known_aberration_comes_back_within_its_stated_deviation():
    z = []
    for seed in range(60):
        green, red = draw(np.random.default_rng(seed), 0.3, 0.2, shift=(0.1, -0.05))
        fit = chromatic_aberration(green, red, SIZE)
        z.append([(fit.at_corner_px - 0.5) / fit.at_corner_sigma_px, (fit.shift_px[0] - 0.1) / (0.028 / np.sqrt(320))])
        assert fit.is_seen and fit.rms_px == pytest.approx(0.028, rel=0.15)
    assert np.abs(np.mean(z, axis=0)).max() < 0.4
    assert np.all((np.std(z, axis=0) > 0.75) & (np.std(z, axis=0) < 1.35))


def test_none_is_proven_where_there_is_none():
    seen = [chromatic_aberration(*draw(np.random.default_rng(s), 0, 0), SIZE).is_seen for s in range(60)]
    assert sum(seen) <= 3


def test_wrong_corners_are_left_out():
    rng = np.random.default_rng(1)
    green, red = draw(rng, 0.4, 0.0)
    red[:, ::13] += rng.uniform(2, 9, red[:, ::13].shape)
    fit = chromatic_aberration(green, red, SIZE)
    assert fit.at_edge_px == pytest.approx(0.4 * fit.edge_px / CORNER, abs=4 * fit.at_edge_sigma_px)
    assert fit.n_corners <= 40 * 8 - 8 * 4


def test_too_few_common_corners_give_nothing():
    green, red = draw(np.random.default_rng(2), 0.4, 0.0)
    red[2:] = np.nan
    assert chromatic_aberration(green, red, SIZE) is None
