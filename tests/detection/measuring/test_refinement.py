from __future__ import annotations

import cv2
import numpy as np
import pytest

from binocal.detection.measuring.refinement import (
    corner_covariance,
    estimate_noise_dn,
    measure_corners,
    refine_corners,
)
from binocal.kernels.corner_fits import BoardPlaces


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


@pytest.mark.parametrize("aside_px", [(2, 2), (3, -1), (-3, 3)])
def test_a_single_corner_that_something_covers_in_part_is_left_out_beside_markers(shoot, aside_px):
    """cornerSubPix went to where the cover's edges cross the board's: off by 0.4 to 2.7 px, with a sigma of 0.02."""
    shot = shoot("charuco:8x6:30mm:22mm:DICT_5X5_50", size_wh=(800, 600), distance=1.3)
    image = shot.image.copy()
    x, y = np.rint(shot.corners_px[17]).astype(int) + aside_px
    image[y - 40 : y, x : x + 40] = 220
    places = BoardPlaces(shot.board.object_points_m[:, :2], shot.board.pitch_m)
    reach = np.full(len(shot.corners_px), 50.0)
    points, covariance, _ = measure_corners(image, shot.corners_px, places, reach, 0.13 * reach, per_reach=0.12)
    is_left_out = np.isnan(points[:, 0])
    assert np.nonzero(is_left_out)[0].tolist() == [17] and np.isnan(covariance[17]).all()


def test_no_corner_of_a_window_that_holds_markers_is_taken(shoot):
    """Squares of 13 px, blurred by 1.3 px: cornerSubPix's least window is larger than the margin, and was off by 1.4 px."""
    shot = shoot("charuco:8x6:30mm:22mm:DICT_5X5_50", distance=8.0, blur_px=1.3, noise_dn=2.0)
    places = BoardPlaces(shot.board.object_points_m[:, :2], shot.board.pitch_m)
    reach = np.full(len(shot.corners_px), 0.93 * np.linalg.norm(shot.corners_px[1] - shot.corners_px[0]))
    points, _, _ = measure_corners(shot.image, shot.corners_px + 0.3, places, reach, 0.133 * reach, per_reach=0.12)
    off = np.linalg.norm(points - shot.corners_px, axis=1)
    assert np.isfinite(off).sum() >= 25 and np.nanmax(off) < 0.1  # measured 28 corners, 0.04 px


def test_a_corner_that_the_border_cuts_is_not_taken_from_its_edge():
    """The last row lies 5 px from the border; from 15 px aside cornerSubPix ends on an edge, 25 px off."""
    x, y = np.meshgrid(np.arange(2560) / 4, np.arange(1920) / 4)
    light = np.where(np.sin(np.pi * (x - 37) / 80) * np.sin(np.pi * (y - 74) / 80) > 0, 210.0, 40.0)
    image = cv2.resize(cv2.GaussianBlur(light, (0, 0), 3.2), (640, 480), interpolation=cv2.INTER_AREA)
    image = np.clip(image + np.random.default_rng(0).normal(0, 2, image.shape), 0, 255).astype(np.uint8)
    place = np.stack(np.meshgrid(np.arange(7.0), np.arange(6.0)), axis=-1).reshape(-1, 2)
    corners, board = 80 * place + [117, 74], BoardPlaces(0.08 * place, 0.08)
    start = corners - np.where(np.arange(42) == 39, 15, 0)[:, None] * [0, 1]
    for may_be_cut in (False, True):
        found, _, _ = measure_corners(image, start, board, np.full(42, 80.0), may_be_cut=may_be_cut)
        off = np.linalg.norm(found - corners, axis=1)
        assert off[39] > 20 if not may_be_cut else np.isnan(off[39])
        assert np.delete(off, 39).max() < 1.0
