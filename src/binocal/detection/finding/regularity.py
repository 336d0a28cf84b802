"""Do found points lie where one smooth lens could have put a plane's points?"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy import ndarray

from binocal.shapes import Bool, Float


def grid_residuals(
    board_xy: Float[ndarray, "n 2"], points_px: Float[ndarray, "n 2"], *, n_rounds: int = 6, tolerance_px: float = 0.3
) -> Float[ndarray, "n"]:
    """Distance of each point from a smooth image of the plane, pixels: a homography plus a low polynomial for the lens.

    The polynomial's degree follows the number of points, up to 3, so that a wild point cannot bend it to itself; both
    fits are redescending (Tukey's biweight; the first of the ``n_rounds`` is plain least squares). What lies within
    ``tolerance_px`` keeps a weight: a part of the points, shifted a little by a shadow, must not be left to extrapolation.
    All infinite where the plane would be folded or seen from behind.
    """
    return _fit_smooth(board_xy, points_px, n_rounds, tolerance_px)[0]


def expected_points(
    board_xy: Float[ndarray, "n 2"], points_px: Float[ndarray, "n 2"], spacing_px: float
) -> Float[ndarray, "n 2"]:
    """Where all points of a board should lie by the smooth image of the plane through those that are known, not NaN.

    NaN where that image is folded.
    """
    seen = np.isfinite(points_px[:, 0])
    _, image = _fit_smooth(board_xy[seen], points_px[seen], 6, max(0.3, 0.05 * spacing_px))
    return np.full(board_xy.shape, np.nan) if image is None else image(board_xy)


def _fit_smooth(
    board_xy: Float[ndarray, "n 2"], points_px: Float[ndarray, "n 2"], n_rounds: int, tolerance_px: float
) -> tuple[Float[ndarray, "n"], Callable[[ndarray], ndarray] | None]:
    """Residuals, and the smooth image of the plane as a function; see :func:`grid_residuals`."""
    n = len(points_px)
    centre, scale = board_xy.mean(axis=0), np.abs(board_xy - board_xy.mean(axis=0)).max() or 1.0
    xy = (board_xy - centre) / scale
    weight = np.ones(n)
    residual = np.full(n, np.inf)
    degree = 3 if n >= 40 else 2 if n >= 20 else 1 if n >= 12 else 0
    # Constant and linear terms too: the homography minimises an algebraic error and leaves some of them.
    powers = [(a, b - a) for b in range(degree + 1) for a in range(b + 1)]
    basis = _terms(xy, powers) if degree else None
    coefficients = None
    for _ in range(n_rounds):
        H = fit_homography(xy, points_px, weight)
        homogeneous = np.column_stack([xy, np.ones(n)]) @ H.T
        w = homogeneous[:, 2]
        # One sign of w: no fold. det H over w cubed is the mapping's Jacobian: positive for a board seen from its
        # front.
        if not np.isfinite(H).all() or not (w * w[0] > 0).all() or np.linalg.det(H) * w[0] <= 0:
            return np.full(n, np.inf), None
        off = points_px - homogeneous[:, :2] / w[:, None]
        root = np.sqrt(weight)[:, None]
        if basis is not None:
            coefficients = np.linalg.lstsq(root * basis, root * off, rcond=None)[0]
            off = off - basis @ coefficients
        residual = np.linalg.norm(off, axis=1)
        cut = 4.7 * max(1.4826 * float(np.median(residual)) / 1.1774, 1e-6) + tolerance_px
        weight = np.clip(1 - (residual / cut) ** 2, 0, 1) ** 2 + 1e-9

    def image(places: ndarray) -> ndarray:
        at = (places - centre) / scale
        homogeneous = np.column_stack([at, np.ones(len(at))]) @ H.T
        points = homogeneous[:, :2] / homogeneous[:, 2:]
        return points if coefficients is None else points + _terms(at, powers) @ coefficients

    return residual, image


def _terms(xy: Float[ndarray, "n 2"], powers: list[tuple[int, int]]) -> Float[ndarray, "n t"]:
    x, y = ([np.ones(len(xy)), axis, axis * axis, axis * axis * axis] for axis in xy.T)
    return np.stack([x[a] * y[b] for a, b in powers], axis=-1)


def fit_homography(
    xy: Float[ndarray, "n 2"], points_px: Float[ndarray, "n 2"], weight: Float[ndarray, "n"] | None = None
) -> Float[ndarray, "3 3"]:
    """Plane to image by the normalised direct linear transform (Hartley & Zisserman 2004, algorithm 4.2).

    NaN if degenerate.
    """
    mean, spread = points_px.mean(axis=0), points_px.std() or 1.0
    uv = (points_px - mean) / spread
    rows = np.zeros((2, len(xy), 3, 3))
    plane = rows[0, :, 0]
    plane[:, :2], plane[:, 2] = xy, 1
    if weight is not None:
        plane *= np.sqrt(weight)[:, None]
    rows[1, :, 1] = plane
    rows[:, :, 2] = -uv.T[..., None] * plane
    rows = rows.reshape(-1, 9)
    values, V = np.linalg.eigh(rows.T @ rows)
    if not values[1] > 1e-14 * values[8]:
        return np.full((3, 3), np.nan)
    back = np.array([[spread, 0, mean[0]], [0, spread, mean[1]], [0, 0, 1]])
    H = back @ V[:, 0].reshape(3, 3)
    return H * np.sign(H[2] @ np.append(xy.mean(axis=0), 1)) / np.linalg.norm(H)


def find_irregular(
    board_xy: Float[ndarray, "n 2"], points_px: Float[ndarray, "n 2"], spacing_px: Float[ndarray, "n"]
) -> Bool[ndarray, "n"]:
    """Points more than a tenth of the local spacing (and 1 px) from a smooth image of the plane.

    Spacing is per point, pixels.
    Measured on the real sets: the worst true corner of a 110-degree lens is 0.04 spacings off; a corner taken for its
    neighbour 1.
    """
    limit = np.maximum(0.1 * spacing_px, 1.0)
    # One plain fit clears most grids: a wild point keeps half of its error in it (leverage below 0.5 from 40 points on).
    if len(points_px) >= 40 and (grid_residuals(board_xy, points_px, n_rounds=1) < 0.5 * limit).all():
        return np.zeros(len(points_px), bool)
    tolerance_px = max(0.3, 0.5 * float(np.median(limit)))  # 0.3 px: what sub-pixel noise may do anyway
    return ~(grid_residuals(board_xy, points_px, tolerance_px=tolerance_px) < limit)
