"""Images of a plane: homographies, and the smooth map that a lens makes of one."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.kernels.image_lens import LensFitOptions, fit_image_lens
from binocal.shapes import Float

# The polynomial's degree from so many points on: a wild point must not bend it to itself.
DEGREE_BY_POINTS = ((40, 3), (20, 2), (12, 1))
MIN_POINTS = 4  # of a homography
N_FOR_WHOLE_LENS = 20  # below it the lens is one number: six would follow a stray
BIWEIGHT_CUT = 4.7  # Tukey's constant: 95 % of least squares' efficiency on Gaussian noise
TOLERANCE_PX = 0.3  # what sub-pixel noise may do anyway
TOLERANCE_PER_SPACING = 0.05  # a fit that is extrapolated keeps a part of the points that a shadow shifted a little
N_ROUNDS = 6


def grid_residuals(
    board_xy: Float[ndarray, "n 2"],
    points_px: Float[ndarray, "n 2"],
    *,
    n_rounds: int = N_ROUNDS,
    tolerance_px: float = TOLERANCE_PX,
) -> Float[ndarray, "n"]:
    """Distance of each point from a smooth image of the plane, pixels: a homography plus a low polynomial for the lens.

    The polynomial's degree follows the number of points, up to 3, so that a wild point cannot bend it to itself; both
    fits are redescending (Tukey's biweight; the first of the ``n_rounds`` is plain least squares). What lies within
    ``tolerance_px`` keeps a weight: a part of the points, shifted a little by a shadow, must not be left to extrapolation.
    All infinite where the plane would be folded or seen from behind.
    """
    fitted = _fit_smooth(board_xy, points_px, n_rounds, tolerance_px)
    return np.full(len(points_px), np.inf) if fitted is None else fitted


def expected_points(
    board_xy: Float[ndarray, "n 2"], points_px: Float[ndarray, "n 2"], spacing_px: float, size_wh: tuple[int, int]
) -> Float[ndarray, "n 2"]:
    """Where all points of a board should lie by the plane and the image's lens through those that are known, not NaN.

    NaN where the plane would be seen from behind, and where the lens does not see a point.
    """
    seen = np.isfinite(points_px[:, 0])
    tolerance_px = max(TOLERANCE_PX, TOLERANCE_PER_SPACING * spacing_px)
    options = LensFitOptions(tolerance_px, is_robust=True, has_one_unknown=bool(seen.sum() < N_FOR_WHOLE_LENS))
    lens = fit_image_lens(board_xy[seen], points_px[seen], size_wh, options, places_xy=board_xy)
    return np.full(board_xy.shape, np.nan) if lens is None else lens.images_px


def determine_plane(board_xy: Float[ndarray, "n 2"]) -> bool:
    """Whether points of a plane determine its homography: four of them with no three on a line."""
    if len(board_xy) < MIN_POINTS:
        return False
    xy = (board_xy - board_xy.mean(axis=0)) / (board_xy.std() or 1.0)
    return bool(np.isfinite(fit_homography(xy, xy)).all())


def _fit_smooth(
    board_xy: Float[ndarray, "n 2"], points_px: Float[ndarray, "n 2"], n_rounds: int, tolerance_px: float
) -> Float[ndarray, "n"] | None:
    """Residuals; see :func:`grid_residuals`. None where the plane would be folded."""
    n = len(points_px)
    centre, scale = board_xy.mean(axis=0), np.abs(board_xy - board_xy.mean(axis=0)).max() or 1.0
    xy = (board_xy - centre) / scale
    weight, residual = np.ones(n), np.full(n, np.inf)
    degree = next((degree for least, degree in DEGREE_BY_POINTS if n >= least), 0)
    # Constant and linear terms too: the homography minimises an algebraic error and leaves some of them.
    powers = [(a, b - a) for b in range(degree + 1) for a in range(b + 1)]
    basis = _terms(xy, powers) if degree else None
    for _ in range(n_rounds):
        H = fit_homography(xy, points_px, weight)
        homogeneous = np.column_stack([xy, np.ones(n)]) @ H.T
        w = homogeneous[:, 2]
        # One sign of w: no fold. det H over w cubed is the mapping's Jacobian: positive for a board seen from its
        # front.
        if not np.isfinite(H).all() or not (w * w[0] > 0).all() or np.linalg.det(H) * w[0] <= 0:
            return None
        off = points_px - homogeneous[:, :2] / w[:, None]
        root = np.sqrt(weight)[:, None]
        if basis is not None:
            coefficients = np.linalg.lstsq(root * basis, root * off, rcond=None)[0]
            off = off - basis @ coefficients
        residual = np.linalg.norm(off, axis=1)
        cut = BIWEIGHT_CUT * max(1.4826 * float(np.median(residual)) / 1.1774, 1e-6) + tolerance_px
        weight = np.clip(1 - (residual / cut) ** 2, 0, 1) ** 2 + 1e-9
    return residual


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


def apply_homography(H: Float[ndarray, "3 3"], xy: Float[ndarray, "*n 2"]) -> Float[ndarray, "*n 2"]:
    """Points through a homography."""
    mapped = xy @ H[:, :2].T + H[:, 2]
    return mapped[..., :2] / mapped[..., 2:]
