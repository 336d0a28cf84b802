"""Rooms full of boards, as calibration rooms are: one shot shows all of them, each at a pose of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.boards import Board, BoardSet
from binocal.cameras import Camera, StereoRig
from binocal.errors import SceneError
from binocal.geometry import SE3, so3
from binocal.shapes import UInt
from binocal.simulation.imaging import read_out
from binocal.simulation.layout import printed_extent_m, sheet_margin
from binocal.simulation.renderer import RenderOptions, render_lights

MOST_TILT_RAD = np.radians(45.0)
MOST_ROLL_RAD = np.radians(20.0)
FILLED = (0.55, 0.8)  # of a part of the image, by the board that hangs there
_MAX_TRIES = 400
_GAP_PX = 6.0


@dataclass(frozen=True, slots=True, eq=False)
class Room:
    """A rig before boards: ``kind[k]`` is the SPEC of the k-th among ``boards``, ``T_left_board`` its pose."""

    rig: StereoRig
    boards: BoardSet
    kind: tuple[int, ...]
    T_left_board: SE3

    def seen_by(self, side: str) -> list[tuple[Board, SE3]]:
        """The boards with their ``T_camera_board`` of the left or right camera."""
        T = self.T_left_board if side == "left" else self.rig.T_right_left @ self.T_left_board
        return [(self.boards.boards[kind], SE3(T.R[k], T.t[k])) for k, kind in enumerate(self.kind)]


def draw_room(rig: StereoRig, boards: BoardSet, rng: np.random.Generator, *, columns: int = 4, rows: int = 3) -> Room:
    """A board in each of ``columns`` x ``rows`` parts of the left image, whole in both images and beside the others.

    Raises:
        SceneError: No such room was found; the parts are too small, or the cameras too far apart.
    """
    size = np.array(rig.left.size_wh, dtype=float)
    part = size / [columns, rows]
    kinds: list[int] = []
    poses: list[SE3] = []
    taken: dict[str, list[tuple[ndarray, ndarray]]] = {"left": [], "right": []}
    for row, column in np.ndindex(rows, columns):
        for _ in range(_MAX_TRIES):
            kind = int(rng.integers(len(boards.boards)))
            board = boards.boards[kind]
            middle = part * ([column, row] + rng.uniform(0.4, 0.6, 2))
            T = _draw_pose(rig.left, board, middle, part, rng)
            boxes = {
                "left": _box_px(rig.left, T, board),
                "right": _box_px(rig.right, rig.T_right_left @ T, board),
            }
            cameras = {"left": rig.left, "right": rig.right}
            if all(_is_free(boxes[side], taken[side], cameras[side].size_wh) for side in boxes):
                kinds.append(kind)
                poses.append(T)
                for side, box in boxes.items():
                    taken[side].append(box)
                break
        else:
            if not 0 < column < columns - 1:
                continue  # what stands at the rim of one image is often beyond the other's
            problem = f"none fits into part ({column}, {row}) of the image beside the others"
            raise SceneError(problem, len(poses), columns * rows)
    T_left_board = SE3(np.array([T.R for T in poses]), np.array([T.t for T in poses]))
    return Room(rig, boards, tuple(kinds), T_left_board)


def render_room(
    room: Room, options: RenderOptions, rng: np.random.Generator
) -> tuple[UInt[ndarray, "h w"], UInt[ndarray, "h2 w2"]]:
    """The left and the right image."""
    images = []
    for side, camera in (("left", room.rig.left), ("right", room.rig.right)):
        light = render_lights(camera, room.seen_by(side), options, rng)
        images.append(read_out(light, rng, noise_dn=options.noise_dn, gamma=options.gamma, bit_depth=options.bit_depth))
    return images[0], images[1]


def _draw_pose(camera: Camera, board: Board, middle_px: ndarray, part_px: ndarray, rng: np.random.Generator) -> SE3:
    """A pose whose image is about the middle and fills the part of the image as far as the board's shape allows."""
    x0, y0, x1, y1 = printed_extent_m(board)
    way = rng.uniform(0, 2 * np.pi)
    tilt = rng.uniform(0.15, 1.0) * MOST_TILT_RAD
    R = so3.exp(tilt * np.array([np.cos(way), np.sin(way), 0.0])) @ so3.exp(
        np.array([0.0, 0.0, rng.uniform(-1, 1) * MOST_ROLL_RAD])
    )
    ray = camera.unproject(middle_px[None])[0]
    size_px = rng.uniform(*FILLED) * part_px
    depth = camera.parameters[0] * max((x1 - x0) / size_px[0], (y1 - y0) / size_px[1])
    centre = np.array([(x0 + x1) / 2, (y0 + y1) / 2, 0.0])
    return SE3(R, ray / ray[2] * depth - R @ centre)


def _box_px(camera: Camera, T: SE3, board: Board) -> tuple[ndarray, ndarray]:
    """Left top and right bottom of a sheet's image; NaN where the camera looks at its back or does not see it."""
    margin = sheet_margin(board) * board.pitch_m
    x0, y0, x1, y1 = np.array(printed_extent_m(board)) + margin * np.array([-1, -1, 1, 1])
    corners = np.array([[x0, y0, 0], [x1, y0, 0], [x1, y1, 0], [x0, y1, 0]])
    px = camera.project(T.apply(corners))
    if not T.inverse().t[2] < 0:
        px = np.full_like(px, np.nan)
    return px.min(axis=0) - _GAP_PX, px.max(axis=0) + _GAP_PX


def _is_free(box: tuple[ndarray, ndarray], taken: list[tuple[ndarray, ndarray]], size_wh: tuple[int, int]) -> bool:
    """Whether a sheet is within the image and beside those that are there."""
    low, high = box
    if not ((low > 0).all() and (high < np.array(size_wh) - 1).all()):
        return False
    return all((high < other[0]).any() or (low > other[1]).any() for other in taken)
