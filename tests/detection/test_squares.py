from __future__ import annotations

import numpy as np
import pytest

from binocal import detect
from binocal.boards import parse_board
from binocal.cameras import Camera
from binocal.geometry import SE3
from binocal.geometry.so3 import exp
from binocal.initialization.symmetries import board_symmetries
from binocal.simulation import RenderOptions, render_image

TURNS = [(0.25, -0.3, 0.1), (-0.4, 0.35, 0.5), (0.5, 0.5, -0.3)]


def error_px(points, corners, board) -> np.ndarray:
    """Errors in that one of the board's own orders that fits best."""
    orders = board_symmetries(board.object_points_m).order
    return min((points - corners[order] for order in orders), key=lambda error: np.nansum(error**2))


@pytest.mark.parametrize("xi_rad", TURNS)
@pytest.mark.parametrize("spec", ["squares:4x3:30mm:30mm", "squares:5x4:30mm:15mm"])
def test_corners_are_as_exact_as_stated(shoot, spec, xi_rad):
    shot = shoot(spec, xi_rad)
    found = detect(shot.image, shot.board)
    assert found.is_found and found.is_seen.all() and not found.note, found.reason
    error = found.points_px - shot.corners_px
    assert np.sqrt(np.mean(error**2)) < 0.02  # measured 0.005 to 0.01
    whitened = np.linalg.solve(np.linalg.cholesky(found.covariance_px2), error[..., None])
    assert 0.7 < np.sqrt(np.mean(whitened**2)) < 1.35


@pytest.mark.parametrize("angle", [0.3, 1.8, 3.0, -1.5])
def test_the_rows_run_to_the_lower_right_whichever_way_up_the_board_is(shoot, angle):
    shot = shoot("squares:4x3:30mm:20mm", (0.2, 0.1, angle), distance=1.6)
    found = detect(shot.image, shot.board)
    assert found.is_seen.all(), found.reason
    assert np.abs(error_px(found.points_px, shot.corners_px, shot.board)).max() < 0.1
    assert (found.points_px[7] - found.points_px[0]).sum() > 0


def test_a_lens_of_180_degrees_bends_the_edges():
    board, f = parse_board("squares:5x4:30mm:25mm"), 640 / np.pi
    camera = Camera("fisheye4", (640, 480), np.r_[f, f, 320, 240, np.zeros(5)])
    R, points = exp(np.array([0.1, -0.3, 0.2])), board.object_points_m
    T_camera_board = SE3(R, np.array([0.0, 0.0, 0.1]) - R @ points.mean(axis=0))
    shot = render_image(camera, T_camera_board, board, RenderOptions(), np.random.default_rng(0))
    found = detect(shot.image, board)
    assert found.is_found and found.is_seen.all(), found.reason
    error = error_px(found.points_px, shot.corners_px, board)
    assert np.sqrt(np.mean(error**2)) < 0.03


def test_a_tone_curve_widens_no_square(shoot):
    shot = shoot("squares:4x3:30mm:20mm", gamma=2.2)
    error = detect(shot.image, shot.board).points_px - shot.corners_px
    assert np.sqrt(np.mean(error**2)) < 0.02  # measured 0.007; 0.3 if the squares are not compared with the gaps


def test_squares_of_another_gap_are_noted(shoot):
    shot = shoot("squares:5x4:30mm:20mm")
    found = detect(shot.image, parse_board("squares:5x4:30mm:24mm"))
    assert found.is_found and "px wider than the SPEC says" in found.note


def test_bright_squares_on_dark(shoot):
    shot = shoot("squares:4x3:30mm:30mm")
    found = detect(255 - shot.image, shot.board)
    assert found.is_found and np.abs(found.points_px - shot.corners_px).max() < 0.1


def test_a_mirrored_image_is_its_own_grid(shoot):
    shot = shoot("squares:4x3:30mm:30mm")
    found = detect(np.ascontiguousarray(shot.image[:, ::-1]), shot.board)
    mirrored = shot.corners_px * [-1, 1] + [shot.image.shape[1] - 1, 0]
    assert found.is_found and np.abs(error_px(found.points_px, mirrored, shot.board)).max() < 0.1


def test_a_covered_corner_takes_its_square_away(shoot):
    shot = shoot("squares:4x3:30mm:30mm")
    image = shot.image.copy()
    x, y = shot.corners_px[20].astype(int)
    image[y - 9 : y + 10, x - 9 : x + 10] = 210
    found = detect(image, shot.board)
    assert found.is_found and not found.is_seen[20] and found.is_seen.sum() == 44 and "44 of 48" in found.note


def test_a_wrong_size_or_gap_is_refused_with_the_right_one(shoot):
    image = shoot("squares:5x4:30mm:20mm").image
    found = detect(image, parse_board("squares:4x3:30mm:20mm"))
    assert not found.is_found and "squares:5x4" in found.reason and found.size_seen == (5, 4)
    assert "only 20 of the 30" in detect(image, parse_board("squares:6x5:30mm:20mm")).reason
    assert "gap" in detect(image, parse_board("squares:5x4:30mm:60mm")).reason


@pytest.mark.parametrize("shown", ["chessboard:9x6:30mm", "circles:4x3:30mm"])
def test_other_boards_are_no_squares(shoot, shown):
    assert not detect(shoot(shown).image, parse_board("squares:4x3:30mm:30mm")).is_found


def test_nothing_is_found_without_a_board(shoot):
    image = shoot("squares:4x3:30mm:30mm", shift=(2.5, 0.0)).image
    assert "no grid of squares found" in detect(image, parse_board("squares:4x3:30mm:30mm")).reason
