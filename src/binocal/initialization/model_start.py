"""Start values of one camera model from the solution of another: points and poses held, intrinsics fitted."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.cameras import CameraModel
from binocal.shapes import Float

ITERATIONS = 6
MIN_COSINE = 0.1  # of the angle from the axis: a model that does not see behind has no use for points beyond
RIDGE = 1e-9  # of the diagonal: what the points leave open stays


def fit_intrinsics(
    model: CameraModel,
    start: Float[ndarray, "p"],
    points: Float[ndarray, "n 3"],
    pixels: Float[ndarray, "n 2"],
    *,
    skew: bool = False,
) -> Float[ndarray, "p"] | None:
    """The model's parameters that project these points, in the camera's frame, nearest to their pixels; None if none do.

    Gauss-Newton from ``start``, whose distortion may be 0; a step that does not lower the sum of squares ends it.
    """
    seen = np.isfinite(pixels[:, 0])
    if not model.sees_behind:
        seen &= points[:, 2] > MIN_COSINE * np.linalg.norm(points, axis=1)
    X, px = points[seen].T, pixels[seen].T
    free = np.ones(model.n_parameters, dtype=bool)
    free[4] = skew
    if 2 * X.shape[1] < 2 * free.sum():
        return None
    precision = np.array(model.prior_precision)[free]
    best, best_cost, values = None, np.inf, np.array(start, dtype=float)
    for _ in range(ITERATIONS):
        J = np.empty((model.n_parameters, 2, X.shape[1]))
        with np.errstate(all="ignore"):
            u, v, _, _ = model.linearize(values, X[0], X[1], X[2], J)
        residual = px - np.stack([u, v])
        cost = float(np.sum(residual**2) + np.sum(precision * values[free] ** 2))
        if not cost < best_cost:
            break
        best, best_cost = values, cost
        A = J[free].reshape(int(free.sum()), -1)
        H, b = A @ A.T + np.diag(precision), A @ residual.ravel() - precision * values[free]
        scale = 1 / np.sqrt(np.maximum(np.diagonal(H), 1e-300))
        H = H * scale[:, None] * scale + RIDGE * np.eye(len(H))
        values = best.copy()
        values[free] += scale * np.linalg.solve(H, scale * b)
    return best
