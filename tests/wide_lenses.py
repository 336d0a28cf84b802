"""Exact images of boards through the lenses of :mod:`binocal.benchmark.wide_lenses`, for tests."""

from __future__ import annotations

import numpy as np

from binocal.benchmark.wide_lenses import place_board, wide_camera
from binocal.boards import parse_board


def see_board(
    degrees: int, spec: str, seed: int, size_wh: tuple[int, int] = (640, 480)
) -> tuple[np.ndarray, np.ndarray]:
    """A board's places (x, y), metres, and their exact image."""
    camera, board = wide_camera(degrees, size_wh), parse_board(spec)
    pose = place_board(camera, board, np.random.default_rng(seed))
    return board.object_points_m[:, :2].copy(), camera.project(pose.apply(board.object_points_m))
