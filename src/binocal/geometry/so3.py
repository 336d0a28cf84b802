"""Rotations: exponential, logarithm, angle, the paper's Euler angles. Batched over leading dimensions."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.shapes import Float


def hat(v: Float[ndarray, "*batch 3"]) -> Float[ndarray, "*batch 3 3"]:
    """Cross-product matrix: ``hat(v) @ x == cross(v, x)``."""
    v = np.asarray(v, dtype=float)
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out


def exp(rotation_vector_rad: Float[ndarray, "*batch 3"]) -> Float[ndarray, "*batch 3 3"]:
    """Rotation matrix of a rotation vector, radians. Source: Rodrigues' formula; Taylor series below 1e-4 rad."""
    w = np.asarray(rotation_vector_rad, dtype=float)
    theta2 = np.sum(w * w, axis=-1)
    theta = np.sqrt(theta2)
    is_small = theta < 1e-4  # the series' next term, theta^4 / 120, is below 1e-18 there
    safe = np.where(is_small, 1.0, theta)
    a = np.where(is_small, 1 - theta2 / 6, np.sin(safe) / safe)
    b = np.where(is_small, 0.5 - theta2 / 24, (1 - np.cos(safe)) / (safe * safe))
    W = hat(w)
    return np.eye(3) + a[..., None, None] * W + b[..., None, None] * (W @ W)


def log(R: Float[ndarray, "*batch 3 3"]) -> Float[ndarray, "*batch 3"]:
    """Rotation vector of a rotation matrix, radians, length in [0, pi].

    Through the unit quaternion, so exact near 0 and near pi alike. NOT checked: that ``R`` is a rotation.
    Source: Markley 2008, "Unit quaternion from rotation matrix" (the largest of four candidate rows).
    """
    R = np.asarray(R, dtype=float)
    trace = R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2]
    candidates = np.empty((*R.shape[:-2], 4, 4))  # rows: 4 * (component i) * q, q = (w, x, y, z)
    candidates[..., 0, 0] = 1 + trace
    off = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1)
    candidates[..., 0, 1:] = off
    for i in range(3):
        candidates[..., i + 1, 0] = off[..., i]
        for j in range(3):
            candidates[..., i + 1, j + 1] = 1 + 2 * R[..., i, i] - trace if i == j else R[..., i, j] + R[..., j, i]
    best = np.argmax(np.sum(candidates**2, axis=-1), axis=-1)
    q = np.take_along_axis(candidates, best[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    q = np.where(q[..., :1] < 0, -q, q)
    sine = np.linalg.norm(q[..., 1:], axis=-1)
    angle = 2 * np.arctan2(sine, q[..., 0])
    is_small = sine < 1e-9
    scale = np.where(is_small, 2.0, angle / np.where(is_small, 1.0, sine))
    return q[..., 1:] * scale[..., None]


def left_jacobian(rotation_vector_rad: Float[ndarray, "*batch 3"]) -> Float[ndarray, "*batch 3 3"]:
    """J_l with exp(v + dv) = exp(J_l dv) exp(v) to first order.

    Source: Barfoot 2017, State Estimation for Robotics, eq. 7.83.
    """
    v = np.asarray(rotation_vector_rad, dtype=float)
    K, angle2 = hat(v), np.sum(v * v, axis=-1)[..., None, None]
    angle = np.sqrt(angle2)
    is_small = angle < 1e-3  # the series is exact to 1e-13 there
    safe = np.where(is_small, 1.0, angle)
    first = np.where(is_small, 0.5 - angle2 / 24, (1 - np.cos(safe)) / safe**2)
    second = np.where(is_small, 1 / 6 - angle2 / 120, (safe - np.sin(safe)) / safe**3)
    return np.eye(3) + first * K + second * (K @ K)


def inverse_left_jacobian(rotation_vector_rad: Float[ndarray, "*batch 3"]) -> Float[ndarray, "*batch 3 3"]:
    """How a rotation vector changes where its rotation is turned from the left: d log(exp(d) exp(w)) / dd at d = 0.

    Source: Solà et al. 2018, "A micro Lie theory", eq. 146; a Taylor series below 0.01 rad. Not defined at 2 pi.
    """
    w = np.asarray(rotation_vector_rad, dtype=float)
    theta2 = np.sum(w * w, axis=-1)
    is_small = theta2 < 1e-4  # the series' next term, theta^4 / 30240, is below 1e-12 there
    safe = np.sqrt(np.where(is_small, 1.0, theta2))
    b = np.where(is_small, 1 / 12 + theta2 / 720, 1 / safe**2 - 0.5 / (safe * np.tan(0.5 * safe)))
    W = hat(w)
    return np.eye(3) - 0.5 * W + b[..., None, None] * (W @ W)


def angle_rad(R: Float[ndarray, "*batch 3 3"]) -> Float[ndarray, "*batch"]:
    """Rotation angle in [0, pi], exact near both ends."""
    return np.linalg.norm(log(R), axis=-1)


def project_to_rotation(M: Float[ndarray, "*batch 3 3"]) -> Float[ndarray, "*batch 3 3"]:
    """Nearest rotation in the Frobenius norm. Source: Kabsch 1976; near rotations Newton's iteration (Higham 1986)."""
    excess = M.swapaxes(-1, -2) @ M - np.eye(3)
    if np.abs(excess).max(initial=0) < 0.1 and np.all(np.linalg.det(M) > 0):
        while np.abs(excess).max(initial=0) > 1e-8:  # a few steps: each squares the error
            M = M - 0.5 * M @ excess
            excess = M.swapaxes(-1, -2) @ M - np.eye(3)
        return M - 0.5 * M @ excess
    U, _, Vt = np.linalg.svd(M)
    U = U.copy()
    U[..., :, 2] *= np.where(np.linalg.det(U @ Vt) < 0, -1.0, 1.0)[..., None]
    return U @ Vt


def turn_to_z(axis: Float[ndarray, "*batch 3"]) -> Float[ndarray, "*batch 3 3"]:
    """Rotation that takes a unit vector to (0, 0, 1) by the shortest way, as two reflections; exact below 179°."""
    half = axis + np.array([0.0, 0.0, 1.0])
    half = half / np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-12)
    R = 2 * half[..., :, None] * half[..., None, :] - np.eye(3)
    return np.diag([-1.0, -1.0, 1.0]) @ R


def mean(R: Float[ndarray, "n 3 3"]) -> Float[ndarray, "3 3"]:
    """Chordal mean of rotations. Source: Hartley et al. 2013, "Rotation averaging", section 5.3."""
    return project_to_rotation(np.sum(R, axis=0))


def from_paper_angles(gamma_rad: float, lambda_rad: float, mu_rad: float) -> Float[ndarray, "3 3"]:
    """``R = R_Z(mu) R_Y(lambda) R_X(gamma)`` in the paper's passive convention (eqs 3-5)."""
    cg, sg = np.cos(gamma_rad), np.sin(gamma_rad)
    cl, sl = np.cos(lambda_rad), np.sin(lambda_rad)
    cm, sm = np.cos(mu_rad), np.sin(mu_rad)
    R_x = np.array([[1, 0, 0], [0, cg, sg], [0, -sg, cg]])
    R_y = np.array([[cl, 0, -sl], [0, 1, 0], [sl, 0, cl]])
    R_z = np.array([[cm, sm, 0], [-sm, cm, 0], [0, 0, 1]])
    return R_z @ R_y @ R_x


def to_paper_angles(R: Float[ndarray, "3 3"]) -> tuple[float, float, float]:
    """(gamma, lambda, mu) in radians, the inverse of :func:`from_paper_angles`; lambda in [-pi/2, pi/2].

    At lambda = ±pi/2 only gamma ∓ mu is determined; mu is then 0.
    """
    sin_lambda = R[2, 0]
    lambda_rad = float(np.arctan2(sin_lambda, np.hypot(R[0, 0], R[1, 0])))
    if np.hypot(R[0, 0], R[1, 0]) < 1e-12:
        return float(np.arctan2(R[1, 2], R[1, 1])), lambda_rad, 0.0
    return float(np.arctan2(-R[2, 1], R[2, 2])), lambda_rad, float(np.arctan2(-R[1, 0], R[0, 0]))
