from __future__ import annotations

import numpy as np
import pytest

from binocal import detect
from binocal.boards import parse_board
from binocal.cameras import Camera
from binocal.geometry import SE3
from binocal.geometry.so3 import exp
from binocal.simulation import RenderOptions, render_image

TURNS = [(0.25, -0.3, 0.1), (-0.4, 0.35, 0.5), (0.5, 0.5, -0.3)]


@pytest.mark.parametrize("xi_rad", TURNS)
@pytest.mark.parametrize("spec", ["circles:8x6:30mm", "acircles:4x9:20mm"])
def test_centres_are_those_of_the_circles_and_not_of_their_images(shoot, spec, xi_rad):
    shot = shoot(spec, xi_rad)
    found = detect(shot.image, shot.board)
    assert found.is_found and found.is_seen.all(), found.reason
    error = found.points_px - shot.corners_px
    assert np.sqrt(np.mean(error**2)) < 0.03  # measured 0.012 to 0.02 px per axis; uncorrected centroids: 0.05 to 0.1
    assert np.abs(error.mean(axis=0)).max() < 0.01


@pytest.mark.parametrize("spec", ["circles:7x5:30mm", "acircles:4x11:20mm"])
def test_centres_through_a_lens_of_180_degrees(spec):
    board, f = parse_board(spec), 640 / np.pi
    camera = Camera("fisheye4", (640, 480), np.r_[f, f, 320, 240, np.zeros(5)])
    R, points = exp(np.array([0.1, -0.3, 0.2])), board.object_points_m
    T_camera_board = SE3(R, np.array([0.0, 0.0, 0.1]) - R @ points.mean(axis=0))
    shot = render_image(camera, T_camera_board, board, RenderOptions(), np.random.default_rng(0))
    found = detect(shot.image, board)
    assert found.is_found and found.is_seen.all(), found.reason
    error = found.points_px - shot.corners_px
    if spec == "circles:7x5:30mm" and error[0, 0] ** 2 > 1:  # the same grid turned by half
        error = found.points_px - shot.corners_px[::-1]
    assert np.sqrt(np.mean(error**2)) < 0.05  # measured 0.01 to 0.02; with a polynomial for the lens 0.2 to 0.35


@pytest.mark.parametrize("xi_rad", TURNS)
def test_no_shift_is_left_on_exact_images(shoot, xi_rad):
    shot = shoot("circles:8x6:30mm", xi_rad, size_wh=(1280, 960), noise_dn=0.0)
    error = detect(shot.image, shot.board).points_px - shot.corners_px
    assert np.sqrt(np.mean(error**2)) < 0.005  # measured 0.0015 to 0.003; uncorrected 0.14


def test_staggered_grids_with_odd_rows_have_one_orientation(shoot):
    for angle in (0.3, 1.8, 3.0, -1.5):
        shot = shoot("acircles:4x9:20mm", (0.2, 0.1, angle), distance=2.0)
        found = detect(shot.image, shot.board)
        assert found.is_found, found.reason
        assert np.abs(found.points_px - shot.corners_px).max() < 0.2


def test_bright_dots_on_dark(shoot):
    shot = shoot("circles:8x6:30mm")
    found = detect(255 - shot.image, shot.board)
    assert found.is_found and np.abs(found.points_px - shot.corners_px).max() < 0.2


def test_a_covered_circle_is_missing(shoot):
    shot = shoot("circles:8x6:30mm")
    image = shot.image.copy()
    x, y = shot.corners_px[20].astype(int)
    image[y - 14 : y + 15, x - 14 : x + 15] = 210
    found = detect(image, shot.board)
    assert found.is_found and not found.is_seen[20] and found.is_seen.sum() == 47 and "47 of 48" in found.note


def test_a_wrong_size_is_refused_with_the_right_one(shoot):
    found = detect(shoot("circles:8x6:30mm").image, parse_board("circles:7x6:30mm"))
    assert not found.is_found and "circles:8x6" in found.reason and found.size_seen == (8, 6)
    found = detect(shoot("acircles:4x9:20mm").image, parse_board("acircles:4x11:20mm"))
    assert not found.is_found and "only 36 of the 44" in found.reason


def test_a_chessboard_is_no_circle_grid(shoot):
    assert "no circle grid" in detect(shoot("chessboard:9x6:30mm").image, parse_board("circles:8x5:30mm")).reason


@pytest.mark.parametrize("spec", ["circles:7x5:30mm", "acircles:4x7:20mm", "squares:4x3:30mm:30mm"])
def test_two_equal_grids_are_said_to_be_two(shoot, spec):
    """One of them was taken, and in the other camera's image perhaps the other one."""
    image = shoot(spec, size_wh=(640, 480), distance=2.0).image
    found = detect(np.hstack([image, image]), parse_board(spec))
    assert found.is_among_several and found.reason.startswith("more than one board in the image")


def test_a_chessboards_squares_are_no_circles(shoot, monkeypatch):
    image, board = shoot("chessboard:8x6:30mm", (0.1, -0.2, 0.1)).image, parse_board("acircles:3x5:30mm")
    found = detect(image, board)
    assert not found.is_found and "no equal circles" in found.reason
    monkeypatch.setattr("binocal.detection.circles.are_equal_circles", lambda *_: True)
    assert detect(image, board).is_found  # nothing else tells them apart
