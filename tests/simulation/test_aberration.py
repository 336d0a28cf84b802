"""Colour images through a lens with lateral chromatic aberration."""

from __future__ import annotations

import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.cameras import Camera
from binocal.detection import detect
from binocal.geometry import SE3
from binocal.simulation import RenderOptions
from binocal.simulation.aberration import colour_cameras, render_colour_image

BOARD = parse_board("chessboard:6x4:30mm")
CAMERA = Camera("brown4", (320, 240), np.array([300.0, 301, 160, 119, 0, -0.1, 0.02, 1e-3, -5e-4]))
POSE = SE3(np.eye(3), np.array([-0.075, -0.045, 0.26]))


def test_each_colour_lies_where_its_camera_sees_it():
    image = render_colour_image(CAMERA, POSE, BOARD, RenderOptions(noise_dn=1), 1.5, np.random.default_rng(0))
    assert image.shape == (240, 320, 3)
    for layer, seen in enumerate(colour_cameras(CAMERA, 1.5)):
        found = detect(image[..., layer].copy(), BOARD)
        truth = seen.project(POSE.apply(BOARD.object_points_m))
        assert np.abs(found.points_px - truth).max() < 0.05


def test_red_is_displaced_by_so_much_in_the_corner():
    ray = CAMERA.unproject(np.array([[0.0, 239.0]]))  # the corner farthest from the principal point
    _, green, red = (camera.project(ray) for camera in colour_cameras(CAMERA, 2.0))
    assert np.linalg.norm(red - green) == pytest.approx(2.0, rel=0.02)
    assert np.linalg.norm(red - [160, 119]) > np.linalg.norm(green - [160, 119])
