from __future__ import annotations

import numpy as np
import pytest

from binocal.detection.measuring.refinement import corner_covariance, estimate_noise_dn, refine_corners


def test_corners_come_back_from_a_rough_start(shoot):
    shot = shoot("chessboard:9x6:30mm")
    start = shot.corners_px + np.random.default_rng(0).uniform(-2, 2, shot.corners_px.shape)
    spacing = np.full(54, 40.0)
    refined = refine_corners(shot.image, start, spacing)
    assert np.abs(refined - shot.corners_px).max() < 0.15
    assert np.allclose(refine_corners(shot.image.astype(np.uint16) * 257, start, spacing), refined, atol=0.02)


def test_corners_at_the_border_and_unseen_ones_are_nan(shoot):
    image = shoot("chessboard:9x6:30mm").image
    points = np.array([[1.0, 1.0], [np.nan, np.nan], [639.0, 200.0]])
    assert np.isnan(refine_corners(image, points, np.array([30.0, 30.0, 30.0]))).all()
    assert np.isnan(corner_covariance(image, points[1:2], np.array([30.0]))).all()


@pytest.mark.parametrize("noise_dn", [1.0, 3.0, 8.0])
def test_noise_is_measured_beside_edges_and_shading(shoot, noise_dn):
    image = shoot("chessboard:9x6:30mm", noise_dn=noise_dn, clutter_dn=5.0, shading=(0.1, 0.1)).image
    assert estimate_noise_dn(image) == pytest.approx(noise_dn, rel=0.2)  # measured within 10 %


def test_less_noise_is_stated_as_less_variance(shoot):
    spacing = np.full(54, 40.0)
    variances = []
    for noise_dn in (1.0, 2.0, 6.0):
        shot = shoot("chessboard:9x6:30mm", noise_dn=noise_dn)
        covariance = corner_covariance(shot.image, shot.corners_px, spacing)
        assert np.allclose(covariance, covariance.transpose(0, 2, 1)) and (covariance[:, 0, 0] > 0).all()
        variances.append(covariance[:, 0, 0].mean())
    assert variances == sorted(variances)


def test_what_is_clipped_has_no_say_on_the_noise(shoot):
    shot = shoot("chessboard:9x6:30mm", noise_dn=3.0, white_dn=400.0, background_dn=400.0, clutter_dn=0.0, distance=2.5)
    assert np.mean(shot.image == 255) > 0.6
    assert estimate_noise_dn(shot.image) == pytest.approx(3.0, rel=0.3)  # 0.3 where the clipped counted
