"""Exact board views of a stereo rig, with noise: just enough simulation to test the start."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from binocal.cameras import camera_model
from binocal.evidence import Detections
from binocal.geometry import SE3, so3

TABLE2 = np.array([1600, 1600, 639.5, 479.5, 0, -0.1, 0.05, 0, 0])
T_RIGHT_LEFT = SE3(so3.exp(np.array([0.005, -0.02, 0.003])), np.array([-0.06, 0.001, 0.002]))


def grid(columns: int = 11, rows: int = 8, pitch_m: float = 0.02) -> np.ndarray:
    row, column = np.divmod(np.arange(columns * rows), columns)
    return np.stack([column * pitch_m, row * pitch_m, np.zeros(columns * rows)], axis=-1)


def project(model: str, parameters: np.ndarray, points: np.ndarray, T_camera_board: SE3) -> np.ndarray:
    X = T_camera_board.apply(points)
    return np.stack(camera_model(model).project(parameters, X[..., 0], X[..., 1], X[..., 2]), axis=-1)


@dataclass(frozen=True)
class Rig:
    points: np.ndarray
    left_px: np.ndarray
    right_px: np.ndarray
    T_left_board: SE3
    T_right_left: SE3
    size_wh: tuple[int, int]
    parameters: np.ndarray
    model: str
    rng: np.random.Generator

    def detections(self, left_px: np.ndarray | None = None, right_px: np.ndarray | None = None) -> Detections:
        left = self.left_px if left_px is None else left_px
        right = self.right_px if right_px is None else right_px
        return Detections.from_arrays(self.points, left, right, self.size_wh)


def simulate(
    seed: int,
    n_views: int = 20,
    *,
    noise_px: float = 0.2,
    model: str = "brown4",
    parameters: np.ndarray = TABLE2,
    size_wh: tuple[int, int] = (1280, 960),
    T_right_left: SE3 = T_RIGHT_LEFT,
    points: np.ndarray | None = None,
    tilt_deg: tuple[float, float] = (10, 45),
    distance_m: tuple[float, float] | None = None,
) -> Rig:
    """Boards at random places, tilted about random axes, wholly inside both images."""
    rng = np.random.default_rng(seed)
    points = grid() if points is None else points
    functions = camera_model(model)
    width, height = size_wh
    extent, centre = np.linalg.norm(np.ptp(points, axis=0)), points.mean(axis=0)
    rotations, positions = [], []
    while len(rotations) < n_views:
        about, tilt = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(*tilt_deg))
        R = so3.exp(tilt * np.array([np.cos(about), np.sin(about), 0])) @ so3.exp(
            np.array([0, 0, np.radians(rng.uniform(-20, 20))])
        )
        z = (
            rng.uniform(*distance_m)
            if distance_m
            else parameters[0] * extent / (rng.uniform(0.35, 0.75) * np.hypot(*size_wh))
        )
        at = np.array([rng.uniform(0.15, 0.85) * width]), np.array([rng.uniform(0.15, 0.85) * height])
        X, Y, Z, is_valid = functions.unproject(parameters, *at)
        if not is_valid[0]:
            continue
        ray = np.array([X[0], Y[0], Z[0]])
        if functions.sees_behind:
            ray = ray / np.linalg.norm(ray)
            R = so3.turn_to_z(ray).T @ R
        board = SE3(R, ray * z - R @ centre)
        for T in (SE3.identity(), T_right_left):
            px = project(model, parameters, points, T @ board)
            is_inside = np.all(px > 2) and np.all(px < np.array(size_wh) - 3)
            if not is_inside or (not functions.sees_behind and (T @ board).apply(points)[:, 2].min() < 0.05):
                break
        else:
            rotations.append(R)
            positions.append(board.t)
    poses = SE3(np.stack(rotations), np.stack(positions))
    left, right = project(model, parameters, points, poses), project(model, parameters, points, T_right_left @ poses)
    return Rig(
        points,
        left + rng.normal(0, noise_px, left.shape),
        right + rng.normal(0, noise_px, right.shape),
        poses,
        T_right_left,
        size_wh,
        parameters,
        model,
        rng,
    )


def rotation_error_deg(R: np.ndarray, R_true: np.ndarray) -> np.ndarray:
    return np.degrees(so3.angle_rad(np.swapaxes(R, -1, -2) @ R_true))


def with_outliers(
    px: np.ndarray, share: float, size_px: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    out = px.copy()
    chosen = rng.random(px.shape[:2]) < share
    out[chosen] += rng.uniform(-size_px, size_px, (int(chosen.sum()), 2))
    return out, chosen
