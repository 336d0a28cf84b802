"""Board poses before a rig: what a careful person shows the cameras, and the named ways of doing it wrong."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.cameras import StereoRig
from binocal.errors import SceneError
from binocal.geometry import SE3, so3
from binocal.shapes import Bool, Float
from binocal.simulation.layout import printed_extent_m
from binocal.simulation.visibility import field_angle_rad, visible_px

_MAX_ROUNDS = 24
_SHRINKS = np.linspace(1.0, 0.0, 9)  # a candidate at each step from its wanted place in the image to the middle


@dataclass(frozen=True, slots=True, eq=False)
class StereoScene:
    """A board shown to a rig in ``n_views`` poses; rig and board share one unit of length (metres if metric)."""

    rig: StereoRig
    board: Board
    T_left_board: SE3

    def __post_init__(self) -> None:
        if self.T_left_board.t.ndim != 2:
            raise ValueError(f"T_left_board must be a batch of views, t (views, 3); got {self.T_left_board.t.shape}")
        if self.rig.is_metric != self.board.is_metric:
            raise ValueError("rig and board must both be metric, or both count in board pitches")

    @property
    def n_views(self) -> int:
        """Number of board poses."""
        return len(self.T_left_board.t)

    @property
    def T_right_board(self) -> SE3:
        """Board poses in the right camera's frame."""
        return self.rig.T_right_left @ self.T_left_board

    def project(self) -> tuple[Float[ndarray, "views n 2"], Float[ndarray, "views n 2"]]:
        """Exact pixels of the board's points in the left and the right camera; NaN where not seen."""
        points = self.board.object_points_m
        return (
            visible_px(self.rig.left, self.T_left_board.apply(points)),
            visible_px(self.rig.right, self.T_right_board.apply(points)),
        )


@dataclass(frozen=True, slots=True)
class PoseOptions:
    """How the board is held. Lengths in pixels, angles in degrees as people state them."""

    fill: tuple[float, float] = (0.3, 0.8)
    """Share of the image's width or height, the larger one, that the print would fill if it faced the camera.
    The far end is not always reached: a close board is seen by both cameras only where their fields overlap."""
    tilt_deg: tuple[float, float] = (10.0, 45.0)
    """Angle between board and image plane (fisheye: the plane across the line of sight), in all directions."""
    roll_deg: float = 15.0
    """Largest turn within the board's own plane."""
    min_visible_share: float = 1.0
    """Share of the board's points that each camera must see; at 1 the whole printed pattern is inside both images."""
    margin_px: float = 4.0
    """Least distance from the edge of the image."""
    max_slant_deg: float = 70.0
    """Largest angle between the board's normal and the line of sight, at any place of the board."""

    def __post_init__(self) -> None:
        if not 0 < self.fill[0] <= self.fill[1]:
            raise ValueError(f"fill must be a range of positive shares; got {self.fill}")
        if not 0 <= self.tilt_deg[0] <= self.tilt_deg[1] < 90:
            raise ValueError(f"tilt_deg must be a range within 0-90; got {self.tilt_deg}")
        if not 0 < self.min_visible_share <= 1:
            raise ValueError(f"min_visible_share must be in (0, 1]; got {self.min_visible_share}")


def sample_board_poses(
    rig: StereoRig, board: Board, n_views: int, rng: np.random.Generator, options: PoseOptions | None = None
) -> SE3:
    """``T_left_board`` of ``n_views`` poses that both cameras see.

    Places are spread over the image by a low-discrepancy sequence and pushed outwards as far as both cameras
    still see the board; tilt, its direction and the distance are stratified over the views. Rejection sampling with
    at most 24 rounds.

    Raises:
        ValueError: Rig and board differ in their unit of length, or ``n_views`` is negative.
        SceneError: Some views could not be placed; it says how many could.
    """
    options = options or PoseOptions()
    if n_views < 0:
        raise ValueError(f"n_views must not be negative; got {n_views}")
    if rig.is_metric != board.is_metric:
        raise ValueError("rig and board must both be metric, or both count in board pitches")
    sampler = _Sampler(rig, board, options)
    places = _spread_places(n_views, rng)
    azimuth = 2 * np.pi * ((np.arange(n_views) * 0.6180339887 + rng.random()) % 1)
    tilt_share, fill_share = _strata(n_views, rng), _strata(n_views, rng)
    R, t, is_placed = np.zeros((n_views, 3, 3)), np.zeros((n_views, 3)), np.zeros(n_views, dtype=bool)
    for attempt in range(_MAX_ROUNDS):
        todo = np.flatnonzero(~is_placed)
        if not todo.size:
            return SE3(R, t)
        if attempt:
            tilt_share[todo], fill_share[todo] = rng.random(todo.size), rng.random(todo.size)
            azimuth[todo] = rng.uniform(0, 2 * np.pi, todo.size)
        reach = 1 - attempt / _MAX_ROUNDS  # later rounds hold the board farther away, where it fits more easily
        roll = np.radians(options.roll_deg) * rng.uniform(-1, 1, todo.size)
        candidates_R, candidates_t = sampler.poses(
            places[todo], fill_share[todo] * reach, tilt_share[todo], azimuth[todo], roll
        )
        is_good = sampler.accepts(candidates_R, candidates_t)
        first, found = np.argmax(is_good, axis=1), is_good.any(axis=1)
        R[todo[found]] = candidates_R[found, first[found]]
        t[todo[found]] = candidates_t[found, first[found]]
        is_placed[todo[found]] = True
    if is_placed.all():
        return SE3(R, t)
    x0, y0, x1, y1 = printed_extent_m(board)
    raise SceneError(
        f"a pattern of {x1 - x0:.3g} x {y1 - y0:.3g} does not fit both images at fill {options.fill} "
        f"and tilt {options.tilt_deg} deg with a baseline of {rig.baseline_m:.3g}; "
        "allow a smaller fill or a smaller min_visible_share.",
        int(is_placed.sum()),
        n_views,
    )


def sample_scene(
    rig: StereoRig, board: Board, n_views: int, rng: np.random.Generator, options: PoseOptions | None = None
) -> StereoScene:
    """Scene of :func:`sample_board_poses`."""
    return StereoScene(rig, board, sample_board_poses(rig, board, n_views, rng, options))


def fronto_parallel(
    rig: StereoRig, board: Board, n_views: int, rng: np.random.Generator, options: PoseOptions | None = None
) -> SE3:
    """Poses parallel to the left image plane: focal lengths and distances cannot be separated (degenerate)."""
    return sample_board_poses(rig, board, n_views, rng, replace(options or PoseOptions(), tilt_deg=(0.0, 0.0)))


def same_pose(
    rig: StereoRig, board: Board, n_views: int, rng: np.random.Generator, options: PoseOptions | None = None
) -> SE3:
    """One pose, ``n_views`` times: a single view in disguise (degenerate)."""
    pose = sample_board_poses(rig, board, 1, rng, options)
    return SE3(np.repeat(pose.R, n_views, axis=0), np.repeat(pose.t, n_views, axis=0))


class _Sampler:
    """What stays the same over the rounds of one call: candidate poses, and the test that they must pass."""

    def __init__(self, rig: StereoRig, board: Board, options: PoseOptions) -> None:
        self.rig, self.options = rig, options
        self.T_right_left = rig.T_right_left
        self.fields = (field_angle_rad(rig.left), field_angle_rad(rig.right))
        x0, y0, x1, y1 = printed_extent_m(board)
        s = np.linspace(0, 1, 7)[:-1]
        z, o = np.zeros_like(s), np.ones_like(s)
        ring = np.concatenate(
            [np.stack([s, z], 1), np.stack([o, s], 1), np.stack([1 - s, o], 1), np.stack([z, 1 - s], 1)]
        )
        self.outline = np.c_[[x0, y0] + ring * [x1 - x0, y1 - y0], np.zeros(len(ring))]
        self.points = board.object_points_m
        self.centre = np.array([(x0 + x1) / 2, (y0 + y1) / 2, 0.0])
        width, height = rig.left.size_wh
        self.extent = max(x1 - x0, (y1 - y0) * width / height)

    def poses(
        self, places: ndarray, fill_share: ndarray, tilt_share: ndarray, azimuth_rad: ndarray, roll_rad: ndarray
    ) -> tuple[Float[ndarray, "k c 3 3"], Float[ndarray, "k c 3"]]:
        """Candidates (views, shrinks) seen from the point midway between the cameras; NaN where a camera has no ray."""
        low, high = self.options.fill
        distance = self._distance(low + (high - low) * fill_share)
        rays = self._cyclopean_rays(places[:, None] * _SHRINKS[:, None])
        is_fisheye = self.rig.left.model == "fisheye4"
        along = rays if is_fisheye else rays / rays[..., 2:]
        midpoint = -0.5 * (self.T_right_left.R.T @ self.T_right_left.t)
        middle = midpoint + along * distance[:, None, None]
        low, high = np.radians(self.options.tilt_deg)
        axis = np.stack([np.cos(azimuth_rad), np.sin(azimuth_rad), np.zeros_like(azimuth_rad)], axis=-1)
        in_plane = np.stack([np.zeros_like(roll_rad), np.zeros_like(roll_rad), roll_rad], axis=-1)
        R = (so3.exp(axis * (low + (high - low) * tilt_share)[:, None]) @ so3.exp(in_plane))[:, None]
        R = _facing(rays) @ R if is_fisheye and self.options.tilt_deg[1] > 0 else np.broadcast_to(R, (*rays.shape, 3))
        return R, middle - (R @ self.centre)

    def _distance(self, fill: Float[ndarray, "k"]) -> Float[ndarray, "k"]:
        """Distance at which the pattern, facing the left camera, fills that share of the image."""
        width, height = self.rig.left.size_wh
        u = (width - 1) / 2 + np.stack([-fill, fill]) * width / 2
        rays = self.rig.left.unproject(np.stack([u, np.full_like(u, (height - 1) / 2)], axis=-1))
        angle = np.arccos(np.clip(np.sum(rays[0] * rays[1], axis=-1), -1, 1))
        return self.extent / 2 / np.tan(np.minimum(angle, np.radians(130)) / 2)  # a plane never fills more than 180 deg

    def _cyclopean_rays(self, places: Float[ndarray, "k c 2"]) -> Float[ndarray, "k c 3"]:
        """Mean direction, left frame, of both cameras' rays through a place; places span [-1, 1] over the image."""
        rays = []
        for camera in (self.rig.left, self.rig.right):
            half = (np.array(camera.size_wh) - 1) / 2
            rays.append(camera.unproject(half * (1 + places)))
        mean = rays[0] + rays[1] @ self.T_right_left.R
        return mean / np.linalg.norm(mean, axis=-1, keepdims=True)

    def accepts(self, R: Float[ndarray, "k c 3 3"], t: Float[ndarray, "k c 3"]) -> Bool[ndarray, "k c"]:
        """Whether both cameras see enough of the board, from its front and not too obliquely."""
        is_good = np.ones(t.shape[:-1], dtype=bool)
        is_whole = self.options.min_visible_share >= 1
        cameras = ((self.rig.left, SE3.identity()), (self.rig.right, self.T_right_left))
        for (camera, T), field in zip(cameras, self.fields, strict=True):
            R_camera, t_camera = T.R @ R, t @ T.R.T + T.t
            outline = self.outline @ R_camera.swapaxes(-1, -2) + t_camera[..., None, :]
            points = outline if is_whole else self.points @ R_camera.swapaxes(-1, -2) + t_camera[..., None, :]
            pixels = visible_px(camera, points, margin_px=self.options.margin_px, field_rad=field)
            share = np.isfinite(pixels[..., 0]).mean(axis=-1)
            is_good &= share >= self.options.min_visible_share
            facing = (outline @ R_camera[..., :, 2:])[..., 0] / np.linalg.norm(outline, axis=-1)
            is_good &= facing.min(axis=-1) > np.cos(np.radians(self.options.max_slant_deg))
        return is_good


def _facing(rays: Float[ndarray, "*batch 3"]) -> Float[ndarray, "*batch 3 3"]:
    """Smallest rotation that turns the z axis into each unit ray."""
    axis = np.stack([-rays[..., 1], rays[..., 0], np.zeros_like(rays[..., 0])], axis=-1)
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    angle = np.arctan2(sine, rays[..., 2:])
    return so3.exp(axis * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 1.0))


def _spread_places(n: int, rng: np.random.Generator) -> Float[ndarray, "n 2"]:
    """Points that cover [-1, 1]² evenly at any count. Source: Roberts 2018, the R2 sequence of the plastic number."""
    plastic = 1.3247179572447460
    places = (np.arange(n)[:, None] * [1 / plastic, 1 / plastic**2] + rng.random(2)) % 1
    return 2 * places - 1


def _strata(n: int, rng: np.random.Generator) -> Float[ndarray, "n"]:
    """Uniform shares in [0, 1), one in each of n equal strata, in random order."""
    return (rng.permutation(n) + rng.random(n)) / max(n, 1)
