"""Covariance of a rig that is found in stages: each camera alone, then the pose between them with the cameras held.

Such an estimate is a smooth function of the corners, and not the most probable one: the inverse of one set of normal equations
is not its covariance. To first order every corner's error moves the first stage, and the second stage both directly and by way of
the first; summed over all corners that is the covariance of what the method does (stacked estimating equations; Newey & McFadden
1994, "Large sample estimation and hypothesis testing", section 6; Stefanski & Boos 2002, "The calculus of M-estimation").

Components: ``m`` = 2 n coordinates of a view's corners in one camera, x and y in turn; poses step from the left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.cameras import CameraModel
from binocal.findings import finding, refusal
from binocal.geometry import SE3, so3
from binocal.shapes import Bool, Float
from binocal.solvers.board_views import adjoint
from binocal.solvers.covariance import SINGULAR_CONDITION
from binocal.solvers.jackknife import say_of_views, widening


@dataclass(frozen=True, slots=True, eq=False)
class CameraStage:
    """One camera calibrated alone by least squares over the corners that ``is_used``, its residuals 0 elsewhere."""

    model: CameraModel
    parameters: Float[ndarray, "p"]
    is_free: Bool[ndarray, "p"]
    T_camera_board: SE3
    is_used: Bool[ndarray, "views n"]
    residuals_px: Float[ndarray, "views n 2"]
    noise_px: float


@dataclass(frozen=True, slots=True, eq=False)
class PoseStage:
    """The second stage, linearised: all ``information`` times the step of ``T_right_left`` is the sum of the views' scores.

    ``by_corners`` of each camera is the derivative of a view's score by its corners, ``by_cameras`` minus that by the camera's
    free parameters; ``scores`` are what the views leave at the estimate, which sum to 0.
    """

    information: Float[ndarray, "views 6 6"]
    by_corners: tuple[Float[ndarray, "views 6 m"], Float[ndarray, "views 6 m"]]
    by_cameras: tuple[Float[ndarray, "views 6 f"], Float[ndarray, "views 6 g"]]
    scores: Float[ndarray, "views 6"]


def derivatives(
    model: CameraModel, parameters: Float[ndarray, "p"], T_camera_board: SE3, points: Float[ndarray, "n 3"]
) -> tuple[Float[ndarray, "views n 2"], Float[ndarray, "views m p"], Float[ndarray, "views m 6"]]:
    """Pixels of the board's points, and their derivatives by the parameters and by left steps of the poses."""
    seen = T_camera_board.apply(points)
    n_views, n = seen.shape[:2]
    J = np.empty((n_views, model.n_parameters, 2, n))
    u, v, *gradients = model.linearize(np.asarray(parameters), *np.moveaxis(seen, -1, 0), J)
    by_point = np.stack([np.stack(gradient, axis=-1) for gradient in gradients], axis=-2)  # (views, n, 2, 3)
    by_pose = np.concatenate([-by_point @ so3.hat(seen), by_point], axis=-1)
    by_parameters = J.transpose(0, 3, 2, 1)
    return (
        np.stack([u, v], axis=-1),
        by_parameters.reshape(n_views, 2 * n, -1),
        by_pose.reshape(n_views, 2 * n, 6),
    )


def influence_of_corners(
    stage: CameraStage, points: Float[ndarray, "n 3"]
) -> tuple[Float[ndarray, "views f m"], Float[ndarray, "views m f"], Float[ndarray, "views 6 m"]]:
    """Derivative of the free parameters by every corner; of the pixels by them; of each view's pose by its corners, cameras held.

    Raises:
        DegenerateGeometryError: The views leave parameters undetermined.
    """
    _, by_parameters, by_pose = derivatives(stage.model, stage.parameters, stage.T_camera_board, points)
    mask = np.repeat(stage.is_used, 2, axis=1)[..., None]
    by_parameters, by_pose = by_parameters[..., stage.is_free] * mask, by_pose * mask
    to_pose = _left_inverse(by_pose)
    own = by_parameters - by_pose @ (to_pose @ by_parameters)
    prior = np.diag(np.asarray(stage.model.prior_precision)[stage.is_free]) * stage.noise_px**2
    information = np.einsum("vmi,vmj->ij", own, own) + prior
    scale = 1 / np.sqrt(np.maximum(np.diagonal(information), 1e-300))
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    if not values[0] > values[-1] / SINGULAR_CONDITION:
        names = [name for name, free in zip(stage.model.parameter_names, stage.is_free, strict=True) if free]
        weakest = ", ".join(names[i] for i in np.argsort(-np.abs(vectors[:, 0]))[:3])
        raise refusal(finding("parameters-undetermined", parameters=weakest))
    inverse = (vectors / values) @ vectors.T * np.outer(scale, scale)
    return inverse @ own.swapaxes(-1, -2), by_parameters, to_pose


def pose_stage_of_pixels(
    cameras: tuple[CameraStage, CameraStage],
    points: Float[ndarray, "n 3"],
    T_left_board: SE3,
    T_right_left: SE3,
    pixels: tuple[Float[ndarray, "views n 2"], Float[ndarray, "views n 2"]],
    is_used: Bool[ndarray, "views n"],
) -> PoseStage:
    """The stage that minimises squared pixels over ``T_right_left`` and one pose per view; corners used in both cameras."""
    left, right = cameras
    mask = np.repeat(is_used, 2, axis=1)[..., None]
    T_right_board = T_right_left @ T_left_board
    parts = []
    for camera, T, px in ((left, T_left_board, pixels[0]), (right, T_right_board, pixels[1])):
        predicted, by_parameters, by_pose = derivatives(camera.model, camera.parameters, T, points)
        residuals = np.where(is_used[..., None], np.nan_to_num(px) - predicted, 0.0).reshape(len(px), -1)
        parts.append((by_parameters[..., camera.is_free] * mask, by_pose * mask, residuals))
    (left_parameters, left_pose, left_px), (right_parameters, right_step, right_px) = parts
    right_pose = right_step @ adjoint(T_right_left.R, T_right_left.t)
    by_pose = np.concatenate([left_pose, right_pose], axis=1)
    by_step = np.concatenate([np.zeros(left_pose.shape), right_step], axis=1)
    own = by_step - by_pose @ (_left_inverse(by_pose) @ by_step)
    m = left_pose.shape[1]
    by_corners = (own[:, :m].swapaxes(-1, -2), own[:, m:].swapaxes(-1, -2))
    scores = (by_corners[0] @ left_px[..., None] + by_corners[1] @ right_px[..., None])[..., 0]
    return PoseStage(
        own.swapaxes(-1, -2) @ own,
        by_corners,
        (by_corners[0] @ left_parameters, by_corners[1] @ right_parameters),
        scores,
    )


def pose_stage_of_points(
    cameras: tuple[CameraStage, CameraStage],
    points: Float[ndarray, "n 3"],
    T_right_left: SE3,
    weights: Float[ndarray, "views n"],
) -> PoseStage:
    """The stage that minimises weighted squared distances between the points that each camera reconstructs alone."""
    in_left, in_right = (camera.T_camera_board.apply(points) for camera in cameras)
    moved = T_right_left.apply(in_left)
    G, G_left, G_right = (_by_step(p) for p in (moved, in_left, in_right))
    weighed = G * np.sqrt(weights)[..., None, None]
    information = np.einsum("vnci,vncj->vij", weighed, weighed)
    scores = np.einsum("vn,vnci,vnc->vi", weights, G, in_right - moved)
    by_poses = (
        -np.einsum("vn,vnci,vncj->vij", weights, G, T_right_left.R @ G_left),
        np.einsum("vn,vnci,vncj->vij", weights, G, G_right),
    )
    by_corners, by_cameras = [], []
    for camera, by_pose in zip(cameras, by_poses, strict=True):
        _, by_parameters, to_pose = influence_of_corners(camera, points)
        by_corners.append(by_pose @ to_pose)
        by_cameras.append(by_corners[-1] @ by_parameters)
    return PoseStage(information, (by_corners[0], by_corners[1]), (by_cameras[0], by_cameras[1]), scores)


def staged_covariance(
    cameras: tuple[CameraStage, CameraStage], points: Float[ndarray, "n 3"], second: PoseStage, T_right_left: SE3
) -> tuple[tuple[str, ...], Float[ndarray, "s s"], float]:
    """Names, covariance of what the stages estimate, and the typical factor by which views that disagree widened it.

    Corner noise is each camera's own. Where the views' scores scatter by more than that explains, the covariance is widened by
    them, as that of the joint solve is (:mod:`binocal.solvers.jackknife`).

    Raises:
        DegenerateGeometryError: The views leave parameters undetermined.
    """
    n_views, s = len(second.scores), sum(int(c.is_free.sum()) for c in cameras) + 6
    inverse = np.linalg.inv(second.information.sum(axis=0))
    own = np.zeros((n_views, s, s))  # each view's part of the covariance
    shares = np.zeros((n_views, s, s))  # by how much of the estimate's step each view's shift falls
    shifts = np.zeros((n_views, s))
    shifts[:, -6:] = second.scores
    shares[:, -6:, -6:] = second.information
    first = 0
    for camera, by_corners, by_camera in zip(cameras, second.by_corners, second.by_cameras, strict=True):
        to_parameters, by_parameters, _ = influence_of_corners(camera, points)
        total = by_camera.sum(axis=0)
        place = slice(first, first + to_parameters.shape[1])
        first = place.stop
        D = np.zeros((n_views, s, to_parameters.shape[2]))
        D[:, place] = to_parameters
        D[:, -6:] = inverse @ (by_corners - total @ to_parameters)
        own += camera.noise_px**2 * (D @ D.swapaxes(-1, -2))
        moved = (to_parameters @ camera.residuals_px.reshape(n_views, -1, 1))[..., 0]
        shifts[:, place] += moved
        shifts[:, -6:] -= moved @ total.T
        shares[:, place, place] = to_parameters @ by_parameters
        shares[:, -6:, place] = by_camera - total @ shares[:, place, place]
    shifts[:, -6:] = shifts[:, -6:] @ inverse.T
    shares[:, -6:] = inverse @ shares[:, -6:]
    covariance, factor = _widened(own, shifts, shares)
    to_additive = np.eye(s)
    to_additive[-3:, -6:-3] = -so3.hat(T_right_left.t)
    covariance = to_additive @ covariance @ to_additive.T
    names = [
        f"{side}.{name}"
        for side, camera in zip(("left", "right"), cameras, strict=True)
        for name, free in zip(camera.model.parameter_names, camera.is_free, strict=True)
        if free
    ]
    names += [f"{part}.{axis}" for part in ("rotation", "translation") for axis in "xyz"]
    return tuple(names), 0.5 * (covariance + covariance.T), factor


def _widened(
    own: Float[ndarray, "views s s"], shifts: Float[ndarray, "views s"], shares: Float[ndarray, "views s s"]
) -> tuple[Float[ndarray, "s s"], float]:
    """The covariance of independent noise, wider where leaving views out says so, and by what factor.

    A view's shift at the estimate is what its own corners' errors make of it less its share of the error of all. Without the
    view the estimate moves by -(1 - share)⁻¹ shift.
    """
    covariance = own.sum(axis=0)
    n_views, s = shifts.shape
    scale = np.sqrt(np.diagonal(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    L = scale[:, None] * vectors * np.sqrt(np.maximum(values, 1e-300))
    if n_views < 3:
        return covariance, 1.0
    inverse = np.linalg.inv(L)
    own, shares, shifts = inverse @ own @ inverse.T, inverse @ shares @ L, shifts @ inverse.T
    crossed = shares @ own
    expected = own - crossed - crossed.swapaxes(-1, -2) + shares @ shares.swapaxes(-1, -2)
    mean = float(np.einsum("vii->", expected))
    excess, sigma = float(np.sum(shifts**2)) / mean, float(np.sqrt(2 * np.sum(expected**2))) / mean
    weight = say_of_views(excess, sigma)
    if weight == 0:
        return covariance, 1.0
    without = np.linalg.solve(np.eye(s) - shares, shifts[..., None])[..., 0]
    without = without - without.mean(axis=0)
    W = widening((n_views - 1) / n_views * (without.T @ without), n_views, weight)
    return L @ W @ L.T, float(np.sqrt(np.trace(W) / s))


def _by_step(points: Float[ndarray, "views n 3"]) -> Float[ndarray, "views n 3 6"]:
    """Derivative of points by a left step of the transform that brought them there."""
    return np.concatenate([-so3.hat(points), np.broadcast_to(np.eye(3), (*points.shape, 3))], axis=-1)


def _left_inverse(J: Float[ndarray, "views m 6"]) -> Float[ndarray, "views 6 m"]:
    """(JᵀJ)⁻¹ Jᵀ; 0 for views without corners, which have no pose."""
    N = J.swapaxes(-1, -2) @ J
    scale = np.sqrt(np.maximum(np.einsum("vii->vi", N), 1e-300))
    is_seen = np.abs(J).max(axis=(1, 2)) > 0
    equilibrated = np.where(is_seen[:, None, None], N / (scale[:, :, None] * scale[:, None]), np.eye(6))
    return np.linalg.solve(equilibrated, J.swapaxes(-1, -2) / scale[..., None]) / scale[..., None]
