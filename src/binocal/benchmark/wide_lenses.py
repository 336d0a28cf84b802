"""Lenses from 60 to 200 degrees, and boards anywhere in their field."""

from __future__ import annotations

import numpy as np

from binocal.boards import Board
from binocal.cameras import Camera
from binocal.errors import SceneError
from binocal.geometry import SE3
from binocal.geometry.so3 import exp

# Model, focal length at a width of 640 px, distortion. The rational one is nearly stereographic: 110 degrees across.
LENSES = {
    60: ("brown4", 554.0, (-0.1, 0.05, 2e-4, -3e-4)),
    110: ("brown8", 344.0, (0.8072, 0.1166, 1e-4, -1e-4, 0.0015, 1.0771, 0.2646, 0.0114)),
    150: ("fisheye4", 244.0, (0.01, -0.003, 0.001, 0.0)),
    180: ("fisheye4", 200.0, (0.01, -0.005, 0.001, 0.0)),
    200: ("fisheye4", 184.0, (0.01, -0.004, 0.001, 0.0)),
}


def wide_camera(degrees: int, size_wh: tuple[int, int] = (640, 480)) -> Camera:
    """A camera of so many degrees across, its principal point some pixels off the middle."""
    model, f, distortion = LENSES[degrees]
    width, height = size_wh
    scale = width / 640
    middle = (width / 2 + 3 * scale, height / 2 - 4 * scale)
    return Camera(model, size_wh, np.r_[f * scale, 1.002 * f * scale, middle, 0.0, distortion])


def place_board(camera: Camera, board: Board, rng: np.random.Generator) -> SE3:
    """A pose of the board anywhere in the image: whole, tilted up to 45 degrees, 0.35 to 0.75 of the image's height.

    Raises:
        SceneError: It fits nowhere.
    """
    size = np.array(camera.size_wh)
    points = board.object_points_m
    middle, extent = points.mean(axis=0), float(np.ptp(points[:, :2], axis=0).max())
    margin = 12 * size[0] / 640
    for _ in range(10_000):
        ray = camera.unproject(rng.uniform(0.1, 0.9, 2) * size)
        ray = ray / np.linalg.norm(ray)
        distance = extent * rng.uniform(0.5, 2.0)
        tilt, way, roll = np.radians(rng.uniform(0, 45)), rng.uniform(0, 2 * np.pi), rng.uniform(-0.6, 0.6)
        axis = np.cross([0.0, 0.0, 1.0], ray)
        turn = exp(axis / max(np.linalg.norm(axis), 1e-12) * np.arctan2(np.linalg.norm(axis), ray[2]))
        R = turn @ exp(tilt * np.array([np.cos(way), np.sin(way), 0.0])) @ exp(np.array([0.0, 0.0, roll]))
        pose = SE3(R, ray * distance - R @ middle)
        seen = camera.project(pose.apply(points))
        if not np.isfinite(seen).all() or (seen < margin).any() or (seen > size - 1 - margin).any():
            continue
        if 0.35 < np.ptp(seen, axis=0).max() / size[1] < 0.75:
            return pose
    raise SceneError("the board fits nowhere in the image", 0, 1)
