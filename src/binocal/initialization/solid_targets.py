"""Targets that are no plane: cameras and poses in closed form from points in space whose places are known, or roughly known.

One image of six points that do not lie in one plane determines the camera's whole projection (direct linear transform), so that no
tilts are needed; where an image shows points of one plane only, as of a cube's face, it gives a pose once the camera is known from
others. The start is plain least squares over each image, for the joint solver to finish.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.cameras import camera_model
from binocal.geometry import SE3, so3
from binocal.initialization.model_start import fit_intrinsics
from binocal.initialization.poses import estimate_poses, unproject_all
from binocal.shapes import Bool, Float

SOLID_SHARE = 0.02  # least over largest extent of the points: boards that bow reach 0.01
MIN_POINTS = 6  # not in one plane: 11 unknowns of a projection, two equations a point
MIN_PLANE_POINTS = 4
MIN_SPACE_POINTS = 5  # beside any plane, before a known camera: ten equations for the pose's six unknowns
FEW_POINTS = 8  # fewer determine a projection poorly: orientations are tried,
N_REFINED = 6  # and the best of them refined
_ROUNDS = 3  # of lens and poses in turn
_REFINEMENTS = 8
_MIN_COSINE = 0.08  # of a ray from the mean of its view's, as for boards


@dataclass(frozen=True, slots=True, eq=False)
class SolidPoses:
    """``T_camera_board`` of every view, NaN where not ``is_usable``; ``rms_px`` is what it leaves."""

    R: Float[ndarray, "views 3 3"]
    t: Float[ndarray, "views 3"]
    is_usable: Bool[ndarray, "views"]
    rms_px: Float[ndarray, "views"]


@dataclass(frozen=True, slots=True, eq=False)
class SolidCamera:
    """A camera to start the joint solver from, as :class:`binocal.initialization.intrinsics.InitialCamera` is from planes.

    ``n_solid`` counts the views from whose points the camera itself follows.
    """

    model: str
    size_wh: tuple[int, int]
    parameters: Float[ndarray, "p"]
    poses: SolidPoses
    n_solid: int
    weights: Float[ndarray, "views n"]
    notes: tuple[str, ...] = ()

    @property
    def is_usable(self) -> Bool[ndarray, "views"]:
        """Views with a pose."""
        return self.poses.is_usable


def is_solid(points: Float[ndarray, "n 3"]) -> bool:
    """Whether points lie clearly beside every plane."""
    return len(points) >= MIN_POINTS and _is_beside_planes(points)


def _is_beside_planes(points: Float[ndarray, "n 3"]) -> bool:
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return len(spread) == 3 and bool(spread[2] > SOLID_SHARE * spread[0])


def estimate_solid_camera(
    points: Float[ndarray, "n 3"], px: Float[ndarray, "views n 2"], size_wh: tuple[int, int], model: str
) -> SolidCamera | None:
    """Camera and poses of one camera's views; NaN = not seen.

    None where no view shows six points beside one plane, or those that do are no image of the points.
    """
    width, height = size_wh
    centre, unit = np.array([(width - 1) / 2, (height - 1) / 2]), float(np.hypot(width, height)) / 2
    focals = []
    for corners in px:
        seen = np.isfinite(corners[:, 0])
        if is_solid(points[seen]) and (P := _projection(points[seen], (corners[seen] - centre) / unit)) is not None:
            S = P[:, :3] @ P[:, :3].T
            squares = np.diagonal(S)[:2] / S[2, 2] - np.square(S[:2, 2] / S[2, 2])
            if (squares > 0).all():
                focals.append(np.sqrt(squares) * unit)
    if not focals:
        return None
    functions = camera_model(model)
    parameters = np.zeros(functions.n_parameters)
    parameters[:4] = [*np.median(focals, axis=0), *centre]
    poses = solid_poses(model, parameters, points, px)
    for _ in range(_ROUNDS):
        placed = poses.is_usable
        if not placed.any():
            return None
        in_camera = SE3(poses.R[placed], poses.t[placed]).apply(points).reshape(-1, 3)
        fitted = fit_intrinsics(functions, parameters, in_camera, px[placed].reshape(-1, 2))
        if fitted is None or not (fitted[:2] > 0).all():
            break
        again = solid_poses(model, fitted, points, px)
        if not _rms(again) < _rms(poses):
            break
        parameters, poses = fitted, again
    weights = np.where(np.isfinite(px[..., 0]) & poses.is_usable[:, None], 1.0, 0.0)
    return SolidCamera(model, size_wh, parameters, poses, len(focals), weights)


def solid_poses(
    model: str, parameters: Float[ndarray, "p"], points: Float[ndarray, "n 3"], px: Float[ndarray, "views n 2"]
) -> SolidPoses:
    """Poses before a known camera; a view that shows too few points has none."""
    rays = np.stack(unproject_all(model, parameters, px), axis=-1)
    R, t = np.full((len(px), 3, 3), np.nan), np.full((len(px), 3), np.nan)
    rms = np.full(len(px), np.nan)
    project = camera_model(model).project
    for view, of_view in enumerate(rays):
        seen = np.isfinite(of_view).all(axis=1)
        if not _is_beside_planes(points[seen]):
            pose = _pose_of_plane(model, parameters, points[seen], px[view, seen])
        elif seen.sum() >= MIN_SPACE_POINTS:
            pose = _pose_of_solid(points[seen], of_view[seen])
        else:
            pose = None
        if pose is None:
            continue
        with np.errstate(all="ignore"):
            u, v = project(parameters, *pose.apply(points[seen]).T)
        off2 = np.square(u - px[view, seen, 0]) + np.square(v - px[view, seen, 1])
        if np.isfinite(off2).all():
            R[view], t[view], rms[view] = pose.R, pose.t, np.sqrt(off2.mean())
    return SolidPoses(R, t, np.isfinite(rms), rms)


def _rms(poses: SolidPoses) -> float:
    return float(np.sqrt(np.nanmean(np.square(poses.rms_px)))) if poses.is_usable.any() else np.inf


def _projection(points: Float[ndarray, "n 3"], uv: Float[ndarray, "n 2"]) -> Float[ndarray, "3 4"] | None:
    """The projection matrix of least algebraic error; None where the points do not determine one.

    Source: Hartley & Zisserman 2004, algorithm 7.1, with both sides normalised.
    """
    middle, size = points.mean(axis=0), float(points.std()) or 1.0
    X = np.column_stack([(points - middle) / size, np.ones(len(points))])
    rows = np.zeros((2, len(X), 3, 4))
    rows[0, :, 0] = rows[1, :, 1] = X
    rows[:, :, 2] = -uv.T[..., None] * X
    _, spread, V = np.linalg.svd(rows.reshape(-1, 12))
    if not spread[-2] > 1e-9 * spread[0]:
        return None
    P = V[-1].reshape(3, 4)
    P = np.column_stack([P[:, :3] / size, P[:, 3] - P[:, :3] @ middle / size])
    depth = P[2, :3] @ points.T + P[2, 3]
    return P * np.sign(depth.sum())


def _pose_of_solid(points: Float[ndarray, "n 3"], rays: Float[ndarray, "n 3"]) -> SE3 | None:
    """The pose whose points lie along the rays; None where no such pose is in front."""
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    turn = so3.turn_to_z(rays.mean(axis=0) / np.linalg.norm(rays.mean(axis=0)))
    turned = rays @ turn.T
    if not (turned[:, 2] > _MIN_COSINE).all():
        return None
    uv = turned[:, :2] / turned[:, 2:]
    P = _projection(points, uv) if len(points) >= MIN_POINTS else None
    starts = []
    if P is not None and np.linalg.det(P[:, :3]) > 0:
        scale = np.cbrt(np.linalg.det(P[:, :3]))
        starts.append((so3.project_to_rotation(P[:, :3] / scale), P[:, 3] / scale))

    def off2(R: Float[ndarray, "3 3"], t: Float[ndarray, "3"]) -> float:
        x, y, z = R @ points.T + t[:, None]
        off = np.square(x / z - uv[:, 0]) + np.square(y / z - uv[:, 1])
        return float(off.sum()) if (z > 0).all() else np.inf

    if len(points) < FEW_POINTS:
        rough = [(R, _nearest_translation(R @ points.T, uv)) for R in _ORIENTATIONS]
        starts += sorted(rough, key=lambda pose: off2(*pose))[:N_REFINED]
    found = [pose for R, t in starts if (pose := _refined(points, uv, R, t, turn)) is not None]
    return min(found, key=lambda pose: off2(turn @ pose.R, turn @ pose.t), default=None)


def _nearest_translation(turned: Float[ndarray, "3 n"], uv: Float[ndarray, "n 2"]) -> Float[ndarray, "3"]:
    """That puts turned points nearest to their rays, by the linear equations of the image plane."""
    rows = np.zeros((2, turned.shape[1], 3))
    rows[0, :, 0] = rows[1, :, 1] = 1.0
    rows[:, :, 2] = -uv.T
    right = uv.T * turned[2] - turned[:2]
    return np.linalg.lstsq(rows.reshape(-1, 3), right.ravel(), rcond=None)[0]


def _orientations() -> Float[ndarray, "24 3 3"]:
    """The turns of a cube: no other turn is farther than 63 degrees from one of them."""
    signs = np.stack(np.meshgrid([1, -1], [1, -1], [1, -1]), axis=-1).reshape(-1, 3)
    swaps = [np.eye(3)[list(order)] for order in ((0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (1, 0, 2), (2, 1, 0))]
    turns = [sign[:, None] * swap for sign in signs for swap in swaps]
    return np.array([R for R in turns if np.linalg.det(R) > 0])


_ORIENTATIONS = _orientations()


def _pose_of_plane(
    model: str, parameters: Float[ndarray, "p"], points: Float[ndarray, "n 3"], px: Float[ndarray, "n 2"]
) -> SE3 | None:
    """The pose from points that lie in some plane of the target's."""
    if len(points) < MIN_PLANE_POINTS:
        return None
    middle = points.mean(axis=0)
    axes = np.linalg.svd(points - middle)[2]
    axes *= [[1.0], [1.0], [float(np.linalg.det(axes))]]
    in_plane = (points - middle) @ axes.T
    in_plane[:, 2] = 0.0
    found = estimate_poses(model, parameters, in_plane, px[None])
    if not found.is_usable[0]:
        return None
    return SE3(found.R[0], found.t[0]) @ SE3(axes, -axes @ middle)


def _refined(
    points: Float[ndarray, "n 3"],
    uv: Float[ndarray, "n 2"],
    R: Float[ndarray, "3 3"],
    t: Float[ndarray, "3"],
    turn: Float[ndarray, "3 3"],
) -> SE3 | None:
    """Gauss-Newton on the image plane about the points; back in the camera's frame."""
    for _ in range(_REFINEMENTS):
        x, y, z = points @ R.T[:, 0] + t[0], points @ R.T[:, 1] + t[1], points @ R.T[:, 2] + t[2]
        if not (z > 0).all():
            return None
        zero = np.zeros_like(z)
        J_point = np.stack([np.stack([1 / z, zero, -x / z**2], -1), np.stack([zero, 1 / z, -y / z**2], -1)], axis=1)
        turned = points @ R.T
        J = np.concatenate([-J_point @ so3.hat(turned), J_point], axis=-1).reshape(-1, 6)
        residual = (uv - np.stack([x / z, y / z], axis=-1)).ravel()
        step = np.linalg.lstsq(J, residual, rcond=None)[0]
        R, t = so3.exp(step[:3]) @ R, t + step[3:]
    if not (points @ R.T[:, 2] + t[2] > 0).all():
        return None
    return SE3(so3.project_to_rotation(turn.T @ R), turn.T @ t)
