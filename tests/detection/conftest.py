from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from binocal.boards import Board, parse_board
from binocal.cameras import Camera
from binocal.geometry import SE3
from binocal.geometry.so3 import exp
from binocal.simulation import RenderOptions, render_image


@dataclass(frozen=True)
class Shot:
    """A rendered image, its board and the true corners (NaN outside the image)."""

    image: np.ndarray
    board: Board
    corners_px: np.ndarray


@pytest.fixture(scope="session")
def shoot() -> Callable[..., Shot]:
    """Images of a board given by its SPEC, turned by a rotation vector, ``distance`` board widths away."""

    def shoot(spec, xi_rad=(0.25, -0.3, 0.1), distance=1.9, shift=(0.0, 0.0), size_wh=(640, 480), seed=0, **options):
        board = parse_board(spec)
        width, height = size_wh
        camera = Camera("brown4", size_wh, np.r_[1.1 * width, 1.1 * width, width / 2, height / 2, 0, -0.1, 0.02, 0, 0])
        points = board.object_points_m
        extent = float(np.ptp(points[:, :2], axis=0).max())
        R = exp(np.array(xi_rad, dtype=float))
        t = np.array([shift[0] * extent, shift[1] * extent, distance * extent * 1.1]) - R @ points.mean(axis=0)
        rendered = render_image(camera, SE3(R, t), board, RenderOptions(**options), np.random.default_rng(seed))
        return Shot(rendered.image, board, rendered.corners_px)

    return shoot
