"""Two cameras that yaw and pitch, and a rectangle of unknown size: one pair at a time, each the prior of the next.

The unknowns of a pair are the four angles, which an attitude sensor tells roughly, and the rectangle's pose and size in the frame
of the initial rig. They are solved for together from the four corners in both images (Gauss-Newton on pixels, with the sensor's and
the rectangle's priors); what is then known of the rectangle, the angles marginalised, is the prior of the next pair that shows it
(an iterated extended Kalman filter; Bell & Cathey 1993). The cameras turn about their centres.

Steps of a rectangle: a rotation from the left about its own centre, its position, the logarithms of its width and height.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.cameras import Camera, StereoRig, camera_model
from binocal.geometry import SE3, so3
from binocal.geometry.homography import fit_homographies
from binocal.shapes import Float

LEAST_SIGMA_RAD = 1e-6  # of an angle that is known exactly; 0.002 px at f = 2000 px
MAX_STEPS = 40
SHORT = 1e-4  # of a standard deviation over all unknowns
DEPTHS = (3.0, 10.0, 30.0, 100.0)  # baselines, for a rectangle whose parallax the rough attitudes hide
PLANE_PX = 1000.0  # pixels of the plane at unit distance, for the homography's limits, which are in pixels
SIGNS = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])  # corners, clockwise on the screen
AXES = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])  # of yaw and of pitch


@dataclass(frozen=True, slots=True, eq=False)
class Rectangle:
    """A rectangle in the initial rig's frame, metres, and the information about its eight parameters."""

    T_base_rectangle: SE3
    size_m: Float[ndarray, "2"]
    information: Float[ndarray, "8 8"]

    def corners(self) -> Float[ndarray, "4 3"]:
        """Its corners in the initial rig's frame."""
        return self.T_base_rectangle.apply(np.c_[SIGNS * self.size_m, np.zeros(4)])


@dataclass(frozen=True, slots=True, eq=False)
class PairSolve:
    """A pair's angles (left, right; yaw, pitch), the rectangle after it, and what was left.

    ``covariance`` is of the four angles and the rectangle's eight parameters. ``chi2`` are all squared residuals in standard
    deviations, over ``freedom``; ``pixel_freedom`` is what the unknowns leave of the sixteen coordinates.
    """

    angles_rad: Float[ndarray, "2 2"]
    rectangle: Rectangle
    covariance: Float[ndarray, "12 12"]
    residuals_px: Float[ndarray, "2 4 2"]
    chi2: float
    freedom: int
    pixel_freedom: float


def turned(angles_rad: Float[ndarray, "2"]) -> Float[ndarray, "3 3"]:
    """Rotation from the frame of the initial pose to that of a camera that yawed about its y axis, then pitched about its new x axis."""
    yaw, pitch = angles_rad
    return so3.exp(-pitch * AXES[1]) @ so3.exp(-yaw * AXES[0])


def rig_at(rig: StereoRig, angles_rad: Float[ndarray, "2 2"]) -> SE3:
    """``T_right_left`` of the cameras once turned, from the initial rig."""
    left, right, T = turned(angles_rad[0]), turned(angles_rad[1]), rig.T_right_left
    return SE3(so3.project_to_rotation(right @ T.R @ left.T), right @ T.t)


def rig_by_angles(rig: StereoRig, angles_rad: Float[ndarray, "2 2"]) -> Float[ndarray, "6 4"]:
    """Derivative of :func:`rig_at` (rotation vector from the left, translation) by yaw and pitch of left, then right."""
    T = rig_at(rig, angles_rad)
    J = np.zeros((6, 4))
    for side in range(2):
        pitch = so3.exp(-angles_rad[side, 1] * AXES[1])
        # d turned = -hat(w) turned, with w the axes as the turned camera sees them
        axes = np.stack([pitch @ AXES[0], AXES[1]], axis=-1)
        if side == 0:  # R = right R0 leftᵀ: the left camera's turn acts from the other side
            J[:3, :2] = T.R @ axes
        else:
            J[:3, 2:] = -axes
            J[3:, 2:] = so3.hat(T.t) @ axes
    return J


def solve_pair(
    rig: StereoRig,
    px: Float[ndarray, "2 4 2"],
    attitude_rad: Float[ndarray, "2 2"],
    attitude_sigma_rad: float,
    noise_px: float,
    known: Rectangle | None = None,
    near: PairSolve | None = None,
) -> PairSolve | None:
    """The most probable angles and rectangle of a pair; None where no start leads to a minimum before both cameras.

    Corners stand in one turn around the rectangle, from one corner, in both images; ``known`` is what earlier pairs said of it, ``near``
    a solve of nearly the same pair to start from.
    """
    sigma = max(attitude_sigma_rad, LEAST_SIGMA_RAD)
    if near is not None:
        starts = [(near.angles_rad, near.rectangle)]
    elif known is not None:
        starts = [(attitude_rad, known)]
    else:
        starts = [(attitude_rad, rectangle) for rectangle in _starts(rig, px, attitude_rad)]
    best: PairSolve | None = None
    for angles_rad, rectangle in starts:
        found = _minimized(rig, px, attitude_rad, sigma, noise_px, (angles_rad, rectangle), known)
        if found is not None and (best is None or found.chi2 < best.chi2):
            best = found
    return best


def _starts(rig: StereoRig, px: Float[ndarray, "2 4 2"], attitude_rad: Float[ndarray, "2 2"]) -> list[Rectangle]:
    """The rectangle that the left image shows, at several distances: the one that both rays' meeting gives, and guesses.

    The homography of a rectangle of unknown size tells its directions, and its size over its distance (Zhang 2000, eqs 3 and 4, with the
    camera known).
    """
    rays = [camera.unproject(p) for camera, p in zip((rig.left, rig.right), px, strict=True)]
    plane = PLANE_PX * rays[0][:, :2] / rays[0][:, 2:]
    fit = fit_homographies(np.c_[SIGNS, np.zeros(4)], plane[None], is_robust=False)
    H = fit.H[0] if fit.is_valid[0] else np.full((3, 3), np.nan)
    if not np.isfinite(H).all():
        return []
    H = H * [[1 / PLANE_PX], [1 / PLANE_PX], [1.0]] / np.sign(H[2, 2])
    lengths = np.linalg.norm(H[:, :2], axis=0)
    x = H[:, 0] / lengths[0]
    z = np.cross(x, H[:, 1] / lengths[1])
    z = z / np.linalg.norm(z)
    R = np.stack([x, np.cross(z, x), z], axis=-1)
    base_left = turned(attitude_rad[0]).T
    base_right = rig.T_right_left.R.T @ turned(attitude_rad[1]).T
    centre_right = rig.T_right_left.inverse().t
    towards = [base_left @ rays[0].mean(axis=0), base_right @ rays[1].mean(axis=0)]
    A = np.stack([towards[0], -towards[1]], axis=-1)
    along = np.linalg.lstsq(A, centre_right, rcond=None)[0]
    distances = [d * rig.baseline_m for d in DEPTHS]
    if along[0] > 0 and along[1] > 0:
        distances.insert(0, float(along[0] * np.linalg.norm(towards[0])))
    centre = H[:, 2]
    starts = []
    for distance in distances:
        scale = distance / np.linalg.norm(centre)
        T = SE3(so3.project_to_rotation(base_left @ R), base_left @ centre * scale)
        starts.append(Rectangle(T, lengths * scale, np.zeros((8, 8))))
    return starts


def _minimized(
    rig: StereoRig,
    px: Float[ndarray, "2 4 2"],
    attitude_rad: Float[ndarray, "2 2"],
    sigma: float,
    noise_px: float,
    start: tuple[Float[ndarray, "2 2"], Rectangle],
    known: Rectangle | None,
) -> PairSolve | None:
    angles, rectangle = start
    found = _linearized(rig, px, attitude_rad, sigma, noise_px, angles, rectangle, known)
    if found is None:
        return None
    cost, H, g, residuals, pixel_information = found
    damping = 1e-4
    for _ in range(MAX_STEPS):
        step = np.linalg.solve(H + damping * np.diag(np.diag(H)), g)
        if float(step @ g) < SHORT**2 and damping < 1e-3:
            break
        tried = angles + step[:4].reshape(2, 2), _moved(rectangle, step[4:])
        found = _linearized(rig, px, attitude_rad, sigma, noise_px, *tried, known)
        if found is None or not found[0] < cost:
            damping *= 10
            if damping > 1e10:
                break
            continue
        (angles, rectangle), (cost, H, g, residuals, pixel_information) = tried, found
        damping = max(damping / 10, 1e-9)
    covariance = np.linalg.inv(H + 1e-12 * np.diag(np.diag(H)))
    information = np.linalg.inv(covariance[4:, 4:])
    after = Rectangle(rectangle.T_base_rectangle, rectangle.size_m, 0.5 * (information + information.T))
    freedom = 16 + 4 + (8 if known is not None else 0) - 12
    pixel_freedom = 16 - float(np.trace(covariance @ pixel_information))
    return PairSolve(angles, after, covariance, residuals, cost, freedom, pixel_freedom)


_Linearized = tuple[float, ndarray, ndarray, ndarray, ndarray]


def _linearized(
    rig: StereoRig,
    px: Float[ndarray, "2 4 2"],
    attitude_rad: Float[ndarray, "2 2"],
    sigma: float,
    noise_px: float,
    angles_rad: Float[ndarray, "2 2"],
    rectangle: Rectangle,
    known: Rectangle | None,
) -> _Linearized | None:
    """Squared residuals, normal equations, residuals in pixels and the pixels' own information; None if a corner is behind."""
    T, corners = rectangle.T_base_rectangle, rectangle.corners()
    local = np.c_[SIGNS * rectangle.size_m, np.zeros(4)]
    by_rectangle = np.concatenate(
        [
            -so3.hat(corners - T.t),
            np.broadcast_to(np.eye(3), (4, 3, 3)),
            np.stack([local[:, :1] * T.R[:, 0], local[:, 1:2] * T.R[:, 1]], axis=-1),
        ],
        axis=-1,
    )
    J, residuals = np.zeros((2, 4, 2, 12)), np.empty((2, 4, 2))
    for side, camera in enumerate((rig.left, rig.right)):
        C = turned(angles_rad[side])
        mount = SE3.identity() if side == 0 else rig.T_right_left
        seen = mount.apply(corners) @ C.T
        if not (np.isfinite(seen).all() and (seen[:, 2] > 0).all()):
            return None
        pixels, by_point = _pixels(camera, seen)
        if not np.isfinite(pixels).all():
            return None
        residuals[side] = px[side] - pixels
        pitch_axis = so3.exp(-angles_rad[side, 1] * AXES[1])
        for k, axis in enumerate((pitch_axis @ AXES[0], AXES[1])):
            J[side, :, :, 2 * side + k] = (by_point @ -np.cross(axis, seen)[..., None])[..., 0]
        J[side, :, :, 4:] = by_point @ (C @ mount.R) @ by_rectangle
    rows, flat = J.reshape(16, 12) / noise_px, residuals.ravel() / noise_px
    away = (attitude_rad - angles_rad).ravel() / sigma
    pixel_information = rows.T @ rows
    H, g = pixel_information.copy(), rows.T @ flat
    H[np.arange(4), np.arange(4)] += sigma**-2
    g[:4] += away / sigma
    cost = float(flat @ flat + away @ away)
    if known is not None:
        T0 = known.T_base_rectangle
        moved = np.r_[so3.log(T.R @ T0.R.T), T.t - T0.t, np.log(rectangle.size_m / known.size_m)]
        H[4:, 4:] += known.information
        g[4:] -= known.information @ moved
        cost += float(moved @ known.information @ moved)
    return cost, H, g, residuals, pixel_information


def _pixels(camera: Camera, points: Float[ndarray, "n 3"]) -> tuple[Float[ndarray, "n 2"], Float[ndarray, "n 2 3"]]:
    model = camera_model(camera.model)
    J = np.empty((model.n_parameters, 2, len(points)))
    u, v, *gradients = model.linearize(camera.parameters, *points.T, J)
    return np.stack([u, v], axis=-1), np.stack([np.stack(gradient, axis=-1) for gradient in gradients], axis=-2)


def _moved(rectangle: Rectangle, step: Float[ndarray, "8"]) -> Rectangle:
    T = rectangle.T_base_rectangle
    return Rectangle(
        SE3(so3.project_to_rotation(so3.exp(step[:3]) @ T.R), T.t + step[3:6]),
        rectangle.size_m * np.exp(np.clip(step[6:], -1.0, 1.0)),
        rectangle.information,
    )
