"""Kannala-Brandt fisheye: image radius is an odd polynomial of the angle from the axis, four coefficients.

Source: Kannala & Brandt 2006, "A generic camera model and calibration method", eq. 6, normalised as OpenCV's
``fisheye``: theta_d = theta (1 + k1 theta² + k2 theta⁴ + k3 theta⁶ + k4 theta⁸). Angles beyond 90° are allowed (Z <=
0). Component-first arrays as in :mod:`binocal.cameras.brown_conrady`.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy import ndarray

from binocal.shapes import Bool, Float


def _split(parameters: ndarray) -> list[ndarray]:
    return [parameters[..., i, None] for i in range(parameters.shape[-1])]


def _polynomial(
    theta2: Float[ndarray, "*batch"], k: list[Float[ndarray, "..."]]
) -> tuple[Float[ndarray, "..."], Float[ndarray, "..."]]:
    """theta_d / theta and d theta_d / d theta."""
    ratio = 1 + theta2 * (k[0] + theta2 * (k[1] + theta2 * (k[2] + theta2 * k[3])))
    slope = 1 + theta2 * (3 * k[0] + theta2 * (5 * k[1] + theta2 * (7 * k[2] + 9 * theta2 * k[3])))
    return ratio, slope


def _direction(
    X: Float[ndarray, "*batch"], Y: Float[ndarray, "*batch"]
) -> tuple[Float[ndarray, "*batch"], Float[ndarray, "*batch"], Float[ndarray, "*batch"]]:
    """Distance from the axis, and the unit direction away from it; on the axis itself the direction is x."""
    r = np.hypot(X, Y)
    is_axis = r < 1e-15
    safe = np.where(is_axis, 1.0, r)
    return r, np.where(is_axis, 1.0, X / safe), np.where(is_axis, 0.0, Y / safe)


def project(parameters: ndarray, X: ndarray, Y: ndarray, Z: ndarray) -> tuple[ndarray, ndarray]:
    """Pixels of points in the camera frame, up to 180° from the axis.

    NOT checked: that the polynomial is monotone there.
    """
    fx, fy, cx, cy, skew = _split(parameters[..., :5])
    r, m, n = _direction(X, Y)
    theta = np.arctan2(r, Z)
    theta_d = theta * _polynomial(theta * theta, _split(parameters[..., 5:]))[0]
    xd, yd = m * theta_d, n * theta_d
    return fx * xd + skew * yd + cx, fy * yd + cy


def linearize(
    parameters: ndarray, X: ndarray, Y: ndarray, Z: ndarray, out_parameters: ndarray
) -> tuple[ndarray, ndarray, tuple[ndarray, ndarray, ndarray], tuple[ndarray, ndarray, ndarray]]:
    """Pixels u, v, their gradients by (X, Y, Z), and, into ``out_parameters`` (..., P, 2, n), by the parameters."""
    fx, fy, cx, cy, skew = _split(parameters[..., :5])
    r, m, n = _direction(X, Y)
    theta = np.arctan2(r, Z)
    theta2 = theta * theta
    ratio, slope = _polynomial(theta2, _split(parameters[..., 5:]))
    theta_d = theta * ratio
    xd, yd = m * theta_d, n * theta_d
    rho2 = r * r + Z * Z
    along = slope * Z / rho2
    across = np.where(r < 1e-15, along, theta_d / np.where(r < 1e-15, 1.0, r))
    xd_x = m * m * along + n * n * across
    xd_y = m * n * (along - across)
    yd_y = n * n * along + m * m * across
    depth = -slope * r / rho2
    xd_z, yd_z = m * depth, n * depth
    grad_u = (fx * xd_x + skew * xd_y, fx * xd_y + skew * yd_y, fx * xd_z + skew * yd_z)
    grad_v = (fy * xd_y, fy * yd_y, fy * yd_z)

    J = out_parameters
    J[..., 0, 0, :], J[..., 0, 1, :] = xd, 0
    J[..., 1, 0, :], J[..., 1, 1, :] = 0, yd
    J[..., 2, 0, :], J[..., 2, 1, :] = 1, 0
    J[..., 3, 0, :], J[..., 3, 1, :] = 0, 1
    J[..., 4, 0, :], J[..., 4, 1, :] = yd, 0
    power = theta * theta2
    for k in range(4):
        J[..., 5 + k, 0, :] = (fx * m + skew * n) * power
        J[..., 5 + k, 1, :] = fy * n * power
        power = power * theta2
    return fx * xd + skew * yd + cx, fy * yd + cy, grad_u, grad_v


def unproject(
    parameters: Float[ndarray, "p"], u: Float[ndarray, "*n"], v: Float[ndarray, "*n"], max_iterations: int = 50
) -> tuple[Float[ndarray, "*n"], Float[ndarray, "*n"], Float[ndarray, "*n"], Bool[ndarray, "*n"]]:
    """Unit rays of pixels, and where they exist.

    Where the angle is below pi and below the polynomial's first turning point.
    """
    fx, fy, cx, cy, skew = parameters[:5]
    k = [np.asarray(c) for c in parameters[5:]]
    yd = (v - cy) / fy
    xd = (u - cx - skew * yd) / fx
    theta_d, m, n = _direction(xd, yd)
    limit = farthest_angle(parameters)
    theta = np.minimum(theta_d, limit)
    step = np.full(np.shape(theta), np.inf)
    with np.errstate(all="ignore"):
        for _ in range(max_iterations):
            ratio, slope = _polynomial(theta * theta, k)
            step = (theta * ratio - theta_d) / slope
            theta = np.clip(theta - np.clip(step, -0.3, 0.3), 0, limit)
            if not np.nanmax(np.abs(step), initial=0) > 1e-15:
                break
        ratio, _ = _polynomial(theta * theta, k)
        is_valid = (np.abs(theta * ratio - theta_d) < 1e-12 * (1 + theta_d)) & (theta < limit)
    sine = np.where(is_valid, np.sin(theta), np.nan)
    return sine * m, sine * n, np.where(is_valid, np.cos(theta), np.nan), is_valid


def farthest_angle(parameters: Float[ndarray, "p"]) -> float:
    """The angle from the axis, radians, at which the polynomial first turns back; 180° if it never does."""
    return _farthest_angle_of(tuple(parameters[5:].tolist()))


@lru_cache(maxsize=64)  # as Brown's models
def _farthest_angle_of(distortion: tuple[float, ...]) -> float:
    grid = np.linspace(0, np.pi, 4001)
    is_turned = _polynomial(grid * grid, [np.asarray(c) for c in distortion])[1] <= 1e-6
    return float(grid[np.argmax(is_turned)]) if is_turned.any() else np.pi
