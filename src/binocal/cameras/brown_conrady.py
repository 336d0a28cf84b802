"""Brown-Conrady distortion with 4, 5 or 8 coefficients, in OpenCV's order k1 k2 p1 p2 k3 k4 k5 k6.

Source: Brown 1966, "Decentering distortion of lenses"; the 8-coefficient rational form is OpenCV's.
Component-first arrays: coordinates are separate arrays of shape (..., n); ``parameters`` is (..., P) with leading
dimensions that broadcast against theirs, in the order fx, fy, cx, cy, skew, distortion.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy import ndarray

from binocal.shapes import Bool, Float

STRONG_K1 = 1.5  # ordinary lenses stay below 0.7; longer ones than three image widths with 5 % of distortion have more
LARGEST_RESCALING = 0.3  # of a focal length by a step of the principal point; more is no second order


def _split(parameters: ndarray) -> list[ndarray]:
    return [parameters[..., i, None] for i in range(parameters.shape[-1])]


def _radial(
    r2: Float[ndarray, "*batch"], d: list[Float[ndarray, "..."]]
) -> tuple[Float[ndarray, "..."], Float[ndarray, "..."], Float[ndarray, "..."] | None]:
    """Radial factor, its derivative by r², and the denominator (None where the model has none)."""
    if len(d) == 4:
        return 1 + r2 * (d[0] + r2 * d[1]), d[0] + (2 * d[1]) * r2, None
    numerator = 1 + r2 * (d[0] + r2 * (d[1] + r2 * d[4]))
    slope = d[0] + r2 * (2 * d[1] + (3 * d[4]) * r2)
    if len(d) == 5:
        return numerator, slope, None
    denominator = 1 + r2 * (d[5] + r2 * (d[6] + r2 * d[7]))
    factor = numerator / denominator
    return factor, (slope - factor * (d[5] + r2 * (2 * d[6] + (3 * d[7]) * r2))) / denominator, denominator


def distort(
    distortion: Float[ndarray, "*#batch d"], a: Float[ndarray, "*batch n"], b: Float[ndarray, "*batch n"]
) -> tuple[Float[ndarray, "*batch n"], Float[ndarray, "*batch n"]]:
    """Distorted normalised coordinates of undistorted ones."""
    d = _split(distortion)
    a2, b2, ab = a * a, b * b, a * b
    r2 = a2 + b2
    factor = _radial(r2, d)[0]
    return a * factor + 2 * d[2] * ab + d[3] * (r2 + 2 * a2), b * factor + d[2] * (r2 + 2 * b2) + 2 * d[3] * ab


def project(parameters: ndarray, X: ndarray, Y: ndarray, Z: ndarray) -> tuple[ndarray, ndarray]:
    """Pixels of points in the camera frame. NOT checked: that Z > 0."""
    fx, fy, cx, cy, skew = _split(parameters[..., :5])
    xd, yd = distort(parameters[..., 5:], X / Z, Y / Z)
    return fx * xd + skew * yd + cx, fy * yd + cy


def linearize(
    parameters: ndarray, X: ndarray, Y: ndarray, Z: ndarray, out_parameters: ndarray
) -> tuple[ndarray, ndarray, tuple[ndarray, ndarray, ndarray], tuple[ndarray, ndarray, ndarray]]:
    """Pixels u, v, their gradients by (X, Y, Z), and, into ``out_parameters`` (..., P, 2, n), by the parameters."""
    fx, fy, cx, cy, skew = _split(parameters[..., :5])
    d = _split(parameters[..., 5:])
    p1, p2 = d[2], d[3]
    inverse_Z = 1.0 / Z
    a, b = X * inverse_Z, Y * inverse_Z
    a2, b2, ab = a * a, b * b, a * b
    r2 = a2 + b2
    factor, slope, denominator = _radial(r2, d)
    two_ab, t_a, t_b = 2 * ab, r2 + 2 * a2, r2 + 2 * b2
    xd = a * factor + p1 * two_ab + p2 * t_a
    yd = b * factor + p1 * t_b + p2 * two_ab
    two_slope = 2 * slope
    dxd_da = factor + two_slope * a2 + 2 * p1 * b + 6 * p2 * a
    dxd_db = two_slope * ab + 2 * p1 * a + 2 * p2 * b
    dyd_db = factor + two_slope * b2 + 6 * p1 * b + 2 * p2 * a
    has_skew = bool(np.any(skew))
    fx_z, fy_z = fx * inverse_Z, fy * inverse_Z
    u_x, u_y = fx_z * dxd_da, fx_z * dxd_db
    v_x, v_y = fy_z * dxd_db, fy_z * dyd_db
    if has_skew:
        skew_z = skew * inverse_Z
        u_x, u_y = u_x + skew_z * dxd_db, u_y + skew_z * dyd_db
    u_z, v_z = -(a * u_x + b * u_y), -(a * v_x + b * v_y)

    J = out_parameters
    J[..., 0, 0, :], J[..., 0, 1, :] = xd, 0
    J[..., 1, 0, :], J[..., 1, 1, :] = 0, yd
    J[..., 2, 0, :], J[..., 2, 1, :] = 1, 0
    J[..., 3, 0, :], J[..., 3, 1, :] = 0, 1
    J[..., 4, 0, :], J[..., 4, 1, :] = yd, 0
    radial_u = fx * a + skew * b if has_skew else fx * a
    radial_v = fy * b
    r = r2 if denominator is None else r2 / denominator
    np.multiply(radial_u, r, out=J[..., 5, 0, :])
    np.multiply(radial_v, r, out=J[..., 5, 1, :])
    np.multiply(J[..., 5, 0, :], r2, out=J[..., 6, 0, :])
    np.multiply(J[..., 5, 1, :], r2, out=J[..., 6, 1, :])
    J[..., 7, 0, :] = fx * two_ab + skew * t_b if has_skew else fx * two_ab
    np.multiply(fy, t_b, out=J[..., 7, 1, :])
    J[..., 8, 0, :] = fx * t_a + skew * two_ab if has_skew else fx * t_a
    np.multiply(fy, two_ab, out=J[..., 8, 1, :])
    if len(d) > 4:
        np.multiply(J[..., 6, 0, :], r2, out=J[..., 9, 0, :])
        np.multiply(J[..., 6, 1, :], r2, out=J[..., 9, 1, :])
    if len(d) > 5:
        for k in range(3):
            J[..., 10 + k, 0, :] = -factor * J[..., (5, 6, 9)[k], 0, :]
            J[..., 10 + k, 1, :] = -factor * J[..., (5, 6, 9)[k], 1, :]
    return fx * xd + skew * yd + cx if has_skew else fx * xd + cx, fy * yd + cy, (u_x, u_y, u_z), (v_x, v_y, v_z)


def unproject(
    parameters: Float[ndarray, "p"], u: Float[ndarray, "*n"], v: Float[ndarray, "*n"], max_iterations: int = 50
) -> tuple[Float[ndarray, "*n"], Float[ndarray, "*n"], Float[ndarray, "*n"], Bool[ndarray, "*n"]]:
    """Rays (X, Y, Z = 1) of pixels, and where they exist.

    Newton's method on the two distortion equations; a pixel is invalid where it does not converge to 1e-12 or lands
    beyond the radius at which the radial mapping folds back (its slope is no longer positive).
    """
    fx, fy, cx, cy, skew = parameters[:5]
    d = [np.asarray(c) for c in parameters[5:]]
    yd = (v - cy) / fy
    xd = (u - cx - skew * yd) / fx
    a, b = xd.copy(), yd.copy()
    fold = _fold_radius(parameters[5:])
    start = np.hypot(a, b)
    shrink = np.where(start > 0.9 * fold, 0.9 * fold / np.maximum(start, 1e-300), 1.0)
    a, b = a * shrink, b * shrink
    step = np.full(np.shape(a), np.inf)
    with np.errstate(all="ignore"):
        for _ in range(max_iterations):
            r2 = a * a + b * b
            factor, slope, _ = _radial(r2, d)
            e_x = a * factor + 2 * d[2] * a * b + d[3] * (r2 + 2 * a * a) - xd
            e_y = b * factor + d[2] * (r2 + 2 * b * b) + 2 * d[3] * a * b - yd
            j_xx = factor + 2 * slope * a * a + 2 * d[2] * b + 6 * d[3] * a
            j_xy = 2 * slope * a * b + 2 * d[2] * a + 2 * d[3] * b
            j_yy = factor + 2 * slope * b * b + 6 * d[2] * b + 2 * d[3] * a
            determinant = j_xx * j_yy - j_xy * j_xy
            step_a, step_b = (j_yy * e_x - j_xy * e_y) / determinant, (j_xx * e_y - j_xy * e_x) / determinant
            step = np.hypot(step_a, step_b)
            limit = np.minimum(1.0, 0.3 * (1 + np.hypot(a, b)) / np.maximum(step, 1e-300))  # no jump over the fold
            a, b = a - limit * step_a, b - limit * step_b
            if not np.nanmax(step, initial=0) > 1e-14:
                break
        r2 = a * a + b * b
        is_valid = (step < 1e-12 * (1 + np.sqrt(r2))) & (np.sqrt(r2) < fold)
    return np.where(is_valid, a, np.nan), np.where(is_valid, b, np.nan), np.where(is_valid, 1.0, np.nan), is_valid


def farthest_angle(parameters: Float[ndarray, "p"]) -> float:
    """The angle from the axis, radians, at which the radial mapping folds back; 90° if it never does."""
    return float(np.arctan(_fold_radius(parameters[5:])))


def _fold_radius(distortion: Float[ndarray, "d"]) -> float:
    """Smallest undistorted radius at which the radial mapping stops growing; inf if it never does below 20."""
    return _fold_radius_of(tuple(distortion.tolist()))


@lru_cache(maxsize=64)  # a map of 640 x 480 pixels takes a millisecond, this a tenth of one
def _fold_radius_of(distortion: tuple[float, ...]) -> float:
    r = np.linspace(0.0, 20.0, 8001)
    with np.errstate(all="ignore"):
        factor, slope, denominator = _radial(r * r, [np.asarray(c) for c in distortion])
        is_folded = ~(factor + 2 * r * r * slope > 1e-6)
        if denominator is not None:
            is_folded |= ~(denominator > 0)
    return float(r[np.argmax(is_folded)]) if is_folded.any() else np.inf


def step_parameters(
    parameters: Float[ndarray, "*batch p"], step: Float[ndarray, "*batch p"]
) -> Float[ndarray, "*batch p"]:
    """The parameters moved by a step; where the principal point moves, the others follow to second order.

    Through a long lens a shift of the principal point by f d hardly differs from a turn of the camera by -d. With points shifted so,
    k1 r² x leaves k1 d in the terms of p2 and p1, which the step cancels, and to second order scales of the axes, which the focal
    lengths take up here: the step then moves corners as the linear equations had it, however far the principal point goes.
    """
    moved = parameters + step
    before, after = (
        values[..., 5] - (values[..., 10] if values.shape[-1] == 13 else 0.0) for values in (parameters, moved)
    )
    if not np.any(np.abs(before) > STRONG_K1):
        return moved
    f, p, p_moved = parameters[..., :2], parameters[..., [8, 7]], moved[..., [8, 7]]
    d = step[..., 2:4] / f
    p_new = p_moved + (after - before)[..., None] * d
    d2, p_d, p_new_d = (np.sum(a * d, axis=-1, keepdims=True) for a in (d, p, p_new))
    scale = 1 + after[..., None] * (d2 + 2 * d * d) - 2 * p_new_d - 4 * p_new * d
    f_new = (moved[..., :2] - f * (2 * p_d + 4 * p * d)) / scale
    is_small = np.all(np.abs(scale - 1) < LARGEST_RESCALING, axis=-1, keepdims=True) & np.isfinite(f_new).all(
        axis=-1, keepdims=True
    )
    moved[..., :2] = np.where(is_small, f_new, moved[..., :2])
    moved[..., [8, 7]] = np.where(is_small, p_new, p_moved)
    return moved
