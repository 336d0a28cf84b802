"""Poses of a planar board from one camera's rays, all views at once, in closed form.

Each view's rays are first turned so that their mean is the z axis: pinhole and fisheye are then alike, rays beyond
90° included, and the planar two-fold ambiguity is a change of sign. The homography's sums (:func:`plane_moments`) are
kept as a quadratic form in the pose's nine numbers (r1, r2, t), so that refining a pose, or asking how well any other
pose fits, needs no corners.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.cameras import camera_model
from binocal.geometry import so3
from binocal.geometry.homography import (
    MIN_POINTS,
    PlaneFrame,
    fit_homographies,
    map_plane,
    plane_moments,
    plane_spread,
    solve_plane,
)
from binocal.shapes import Bool, Float, Int

_MIN_COSINE = 0.08  # a corner 85 deg from its own view's mean ray is left out


@dataclass(frozen=True, slots=True, eq=False)
class BoardPoses:
    """``T_camera_board`` of every view, NaN where not ``is_usable``.

    ``rms_px`` is the weighted RMS distance of a view's corners, pixels, from the quadratic form ``fit``: ``h' fit h``
    is the weighted sum of squared pixels for h = the rows of ``turn [s r1, s r2, R c + t]`` with the board frame's
    scale s and centre c. ``n_corners`` counts the weights.
    """

    R: Float[ndarray, "views 3 3"]
    t: Float[ndarray, "views 3"]
    is_usable: Bool[ndarray, "views"]
    rms_px: Float[ndarray, "views"]
    fit: Float[ndarray, "views 9 9"]
    turn: Float[ndarray, "views 3 3"]
    n_corners: Float[ndarray, "views"]
    frame: PlaneFrame


def estimate_poses(
    model: str,
    parameters: Float[ndarray, "p"],
    object_points: Float[ndarray, "n d"],
    pixels: Float[ndarray, "views n 2"],
    weights: Float[ndarray, "views n"] | None = None,
) -> BoardPoses:
    """Board poses of a calibrated camera; NaN pixels were not seen. The better of the two planar candidates.

    ``weights`` in [0, 1] default to the robust homography's. Object points lie in z = 0. A view that determines no
    homography is not usable.
    """
    pixels = np.asarray(pixels, dtype=float)
    if weights is None:
        weights = fit_homographies(object_points, pixels).weights
    rays = unproject_all(model, parameters, pixels)
    return poses_from_rays(PlaneFrame.of(object_points), rays, pixels, weights)


def estimate_pose_candidates(
    model: str,
    parameters: Float[ndarray, "p"],
    object_points: Float[ndarray, "n d"],
    pixels: Float[ndarray, "views n 2"],
    weights: Float[ndarray, "views n"] | None = None,
) -> tuple[BoardPoses, BoardPoses]:
    """Both planar candidates of every view, each refined, the better first: in far or weak views they fit almost alike.

    Source: Collins & Bartoli 2014, "Infinitesimal plane-based pose estimation", on the ambiguity; the second
    candidate here is the first with its tilt against the line of sight reversed, then refined.
    """
    pixels = np.asarray(pixels, dtype=float)
    if weights is None:
        weights = fit_homographies(object_points, pixels).weights
    first = poses_from_rays(PlaneFrame.of(object_points), unproject_all(model, parameters, pixels), pixels, weights)
    return first, _reversed_tilt(first, n_iterations=8)


def unproject_all(
    model: str, parameters: Float[ndarray, "p"], pixels: Float[ndarray, "views n 2"]
) -> tuple[Float[ndarray, "views n"], Float[ndarray, "views n"], Float[ndarray, "views n"]]:
    """Rays X, Y, Z of pixels; NaN where unseen or where the model has none."""
    is_seen = np.isfinite(pixels[..., 0])
    rays = np.full((3, *is_seen.shape), np.nan)
    X, Y, Z, _ = camera_model(model).unproject(
        np.asarray(parameters, dtype=float), pixels[is_seen, 0], pixels[is_seen, 1]
    )
    rays[:, is_seen] = X, Y, Z
    return rays[0], rays[1], rays[2]


def poses_from_rays(
    frame: PlaneFrame,
    rays: tuple[ndarray, ndarray, ndarray],
    pixels: Float[ndarray, "views n 2"],
    weights: Float[ndarray, "views n"],
    n_iterations: int = 2,
) -> BoardPoses:
    """Poses from rays (any length, any direction); pixels serve only to weigh the residuals in pixels."""
    direction = np.stack(rays, axis=-2)
    length2 = np.sum(direction * direction, axis=-2)
    w = np.where(np.isfinite(length2), weights, 0.0)
    direction = np.where((w > 0)[:, None], direction, 0.0) / np.sqrt(np.where(w > 0, length2, 1.0))[:, None]
    axis = np.sum(direction * w[:, None], axis=-1)
    norm = np.linalg.norm(axis, axis=-1, keepdims=True)
    axis = np.where(norm > 1e-9, axis / np.where(norm > 1e-9, norm, 1.0), np.array([0.0, 0.0, 1.0]))
    turn = so3.turn_to_z(axis)
    turned = turn @ direction
    z = turned[:, 2]
    w = np.where(z > _MIN_COSINE, w, 0.0)
    inverse_z = 1 / np.where(z > _MIN_COSINE, z, 1.0)
    a, b = turned[:, 0] * inverse_z, turned[:, 1] * inverse_z
    n_corners = w.sum(axis=-1)
    px_per_unit = plane_spread(
        np.where(w > 0, pixels[..., 0], 0.0), np.where(w > 0, pixels[..., 1], 0.0), w
    ) / plane_spread(a, b, w)
    with np.errstate(all="ignore"):
        px = w * (px_per_unit * px_per_unit)[:, None]
        rows = solve_plane(plane_moments(frame.basis, a, b, px)).rows
        is_usable = (np.count_nonzero(w > 0.05, axis=-1) >= MIN_POINTS) & np.all(np.isfinite(rows), axis=(-1, -2))
        rows = np.where(is_usable[:, None, None], rows, np.eye(3))
        R, t, size = decompose(rows, frame.scale)
        depth = map_plane(rows, frame.xy)[2] * (frame.scale / size)[:, None]
        moments = plane_moments(frame.basis, a, b, px / np.maximum(depth * depth, 1e-4 * t[:, 2:] ** 2))
    moments = np.where(is_usable[:, None, None, None], moments, np.eye(3))
    fit = np.zeros((len(w), 9, 9))
    fit[:, :3, :3] = fit[:, 3:6, 3:6] = moments[:, 0]
    fit[:, :3, 6:] = fit[:, 6:, :3] = -moments[:, 1]
    fit[:, 3:6, 6:] = fit[:, 6:, 3:6] = -moments[:, 2]
    fit[:, 6:, 6:] = moments[:, 3]
    poses = BoardPoses(R, t, is_usable, np.zeros(len(w)), fit, turn, np.maximum(n_corners, 1e-9), frame)
    poses = _refined(poses, R, t, n_iterations)
    # Weak perspective: where the tilt is small or the board far, the closed form may fall into the wrong valley. A
    # pose that fits nearly as well as a homography (two parameters more) is in the right one.
    h = (rows * (frame.scale / size)[:, None, None]).reshape(-1, 9)
    free_rms = np.sqrt(np.maximum(np.sum(h * (fit @ h[..., None])[..., 0], axis=-1), 0.0) / poses.n_corners)
    doubtful = np.flatnonzero(is_usable & (poses.rms_px > 1.3 * free_rms))
    if not len(doubtful):
        return poses
    part = select_poses(poses, doubtful)
    other = _reversed_tilt(part, n_iterations + 2)
    swap = doubtful[other.rms_px < part.rms_px]
    chosen = other.rms_px < part.rms_px
    R, t, rms = poses.R.copy(), poses.t.copy(), poses.rms_px.copy()
    R[swap], t[swap], rms[swap] = other.R[chosen], other.t[chosen], other.rms_px[chosen]
    return replace(poses, R=R, t=t, rms_px=rms)


def select_poses(poses: BoardPoses, views: Int[ndarray, "k"]) -> BoardPoses:
    """The poses of some views."""
    return replace(
        poses, R=poses.R[views], t=poses.t[views], is_usable=poses.is_usable[views], rms_px=poses.rms_px[views],
        fit=poses.fit[views], turn=poses.turn[views], n_corners=poses.n_corners[views],
    )  # fmt: skip


def decompose(rows: Float[ndarray, "*batch 3 3"], scale: float) -> tuple[ndarray, ndarray, ndarray]:
    """Rotation, position of the frame's centre, and length of the columns, by orthogonalising [h1 h2] symmetrically."""
    h1, h2 = rows[..., 0], rows[..., 1]
    a, b, c = np.vecdot(h1, h1), np.vecdot(h1, h2), np.vecdot(h2, h2)
    root_det = np.sqrt(np.maximum(a * c - b * b, 1e-300))
    trace = np.sqrt(a + c + 2 * root_det)
    # the inverse of the root of [[a, b], [b, c]] is [[c + root_det, -b], [-b, a + root_det]] / (root_det trace)
    p, q, r = ((x / (root_det * trace))[..., None] for x in (c + root_det, b, a + root_det))
    R = np.empty(rows.shape)
    x, y = R[..., 0], R[..., 1]
    x[...], y[...] = p * h1 - q * h2, r * h2 - q * h1
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        R[..., i, 2] = x[..., j] * y[..., k] - x[..., k] * y[..., j]
    size = trace / 2
    return R, rows[..., 2] * (scale / size)[..., None], size


def pose_vector(
    R: Float[ndarray, "*batch 3 3"], t_centre: Float[ndarray, "*batch 3"], scale: float
) -> Float[ndarray, "*batch 9"]:
    """Rows of [s r1, s r2, t], the vector that the quadratic form takes."""
    M = R.copy()
    M[..., :2] *= scale
    M[..., 2] = t_centre
    return M.reshape(*R.shape[:-2], 9)


def pose_jacobian(R: Float[ndarray, "*batch 3 3"], scale: float) -> Float[ndarray, "*batch 9 6"]:
    """Derivative of :func:`pose_vector` by a left rotation about the board's centre, and by its position."""
    J = np.zeros((*R.shape[:-2], 3, 3, 6))
    for column in range(2):
        J[..., :, column, :3] = -so3.hat(R[..., column] * scale)
    J[..., 0, 2, 3] = J[..., 1, 2, 4] = J[..., 2, 2, 5] = 1.0
    return J.reshape(*R.shape[:-2], 9, 6)


def _refined(poses: BoardPoses, R: ndarray, t_centre: ndarray, n_iterations: int) -> BoardPoses:
    """Gauss-Newton on the quadratic form, from turned-frame poses of the board's centre to the camera's frame."""
    scale = poses.frame.scale
    fit = poses.fit
    h = pose_vector(R, t_centre, scale)
    cost = np.sum(h * (fit @ h[..., None])[..., 0], axis=-1)
    for _ in range(n_iterations):
        J = pose_jacobian(R, scale)
        FJ = fit @ J
        N = J.swapaxes(-1, -2) @ FJ
        diagonal = np.einsum("...ii->...i", N)
        N = N + (1e-9 * diagonal + 1e-300)[..., None] * np.eye(6)
        g = FJ.swapaxes(-1, -2) @ h[..., None]
        step = -np.linalg.solve(N, g)[..., 0]
        angle = np.linalg.norm(step[..., :3], axis=-1, keepdims=True)
        step = step * np.minimum(1.0, 0.5 / np.maximum(angle, 1e-300))
        R_new, t_new = so3.exp(step[..., :3]) @ R, t_centre + step[..., 3:]
        h_new = pose_vector(R_new, t_new, scale)
        cost_new = np.sum(h_new * (fit @ h_new[..., None])[..., 0], axis=-1)
        better = (cost_new < cost) & (t_new[..., 2] > 0)
        R = np.where(better[..., None, None], R_new, R)
        t_centre = np.where(better[..., None], t_new, t_centre)
        h, cost = np.where(better[..., None], h_new, h), np.where(better, cost_new, cost)
    back = poses.turn.swapaxes(-1, -2)
    R_camera = back @ R
    t = (back @ t_centre[..., None])[..., 0] - R_camera[..., :2] @ poses.frame.centre
    bad = ~poses.is_usable
    R_camera = np.where(bad[..., None, None], np.nan, R_camera)
    return replace(
        poses, R=R_camera, t=np.where(bad[..., None], np.nan, t),
        rms_px=np.where(bad, np.nan, np.sqrt(np.maximum(cost, 0.0) / poses.n_corners)),
    )  # fmt: skip


def _reversed_tilt(poses: BoardPoses, n_iterations: int) -> BoardPoses:
    """The poses with their tilt against the line of sight to the board's centre reversed, then refined."""
    usable = poses.is_usable
    R = np.where(usable[:, None, None], poses.R, np.eye(3))
    t_centre = np.where(usable[:, None], poses.t, np.array([0.0, 0.0, 1.0])) + R[..., :2] @ poses.frame.centre
    line = t_centre / np.linalg.norm(t_centre, axis=-1, keepdims=True)
    to_line = so3.turn_to_z(line)
    sign = np.array([[1, 1, -1], [1, 1, -1], [-1, -1, 1]])
    R = poses.turn @ to_line.swapaxes(-1, -2) @ (sign * (to_line @ R))
    t_centre = (poses.turn @ t_centre[..., None])[..., 0]
    return _refined(poses, R, t_centre, n_iterations)
