from __future__ import annotations

import numpy as np
import pytest

from binocal.cameras.epipolar_projection import PROJECTIONS, EpipolarProjection

RNG = np.random.default_rng(3)


def make(kind, is_vertical):
    return EpipolarProjection(kind, np.array([300.0, 310.0]), np.array([321.0, 235.0]), is_vertical)


@pytest.mark.parametrize("is_vertical", [False, True])
@pytest.mark.parametrize("kind", PROJECTIONS)
def test_pixels_and_rays_are_inverse(kind, is_vertical):
    projection = make(kind, is_vertical)
    pixels = RNG.uniform([100, 50], [500, 400], (200, 2))
    np.testing.assert_allclose(projection.project(projection.unproject(pixels)), pixels, atol=1e-9)
    rows, columns = projection.pixel_rays((640, 480))
    np.testing.assert_allclose(
        rows[[100, 350]] + columns[[90, 600]], projection.unproject(np.array([[90.0, 100], [600, 350]])), atol=1e-12
    )


@pytest.mark.parametrize("is_vertical", [False, True])
@pytest.mark.parametrize("kind", PROJECTIONS)
def test_a_plane_through_the_baseline_is_a_row(kind, is_vertical):
    """What makes disparities: moved along the baseline, a point stays on its row (column, if vertical)."""
    projection = make(kind, is_vertical)
    points = RNG.uniform([-1, -1, 0.5], [1, 1, 3], (100, 3))
    moved = points.copy()
    moved[:, projection.along] -= 0.3
    across = 1 - projection.along
    before, after = projection.project(points), projection.project(moved)
    np.testing.assert_allclose(after[:, across], before[:, across], atol=1e-9)
    assert np.all(after[:, projection.along] < before[:, projection.along])


def test_curved_projections_show_what_lies_beside_and_behind_a_pinhole():
    beside = np.array([[0.0, 1.0, -0.2], [1.0, 0.1, 0.0]])
    assert np.isnan(make("pinhole", False).project(beside)).all()
    for kind in ("cylindrical", "equirectangular"):
        assert np.isfinite(make(kind, False).project(beside)).all()
    assert np.isnan(make("equirectangular", False).unproject(np.array([321 + 300 * 1.6, 235.0]))[0])
