"""The kernel's formulas stated plainly in NumPy: what binocal.kernels must reproduce."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.cameras import CameraModel
from binocal.solvers import robust


def accumulate(
    model: CameraModel,
    parameters: ndarray,
    R: ndarray,
    t: ndarray,
    object_points: ndarray,
    pixels: ndarray,
    is_seen: ndarray,
    scale_px: float,
    kernel: robust.Kernel,
    whitening: ndarray | None = None,
) -> tuple[ndarray, ndarray, ndarray]:
    """gram, r2 and cost of the views of one rig."""
    columns, depth = unweighted_columns(model, parameters, R, t, object_points, pixels, is_seen)
    if whitening is not None:
        a, b, c = np.moveaxis(whitening[:, None], 2, 0)
        columns = np.stack([a * columns[:, :, 0], b * columns[:, :, 0] + c * columns[:, :, 1]], axis=2)
    r2 = np.sum(columns[:, -1] ** 2, axis=1)
    with np.errstate(all="ignore"):
        weight = robust.weights(r2, np.asarray(scale_px), kernel)
        gram = np.einsum("vacn,vn,vbcn->vab", columns, weight, columns)
        cost = robust.costs(r2, np.asarray(scale_px), kernel).sum(axis=-1)
    if not model.sees_behind:
        cost[np.any(is_seen & (depth <= 0), axis=-1)] = np.inf
    cost[~np.isfinite(cost)] = np.inf
    return gram, r2, cost


def unweighted_columns(
    model: CameraModel,
    parameters: ndarray,
    R: ndarray,
    t: ndarray,
    object_points: ndarray,
    pixels: ndarray,
    is_seen: ndarray,
) -> tuple[ndarray, ndarray]:
    """Columns [parameters, xi, residual] (views, q, 2, n), 0 where not seen, and depths (views, n)."""
    p = model.n_parameters
    X, Y, Z = np.moveaxis(R @ object_points + t[:, :, None], 1, 0)
    J = np.empty((len(R), p + 7, 2, object_points.shape[1]))
    with np.errstate(all="ignore"):
        u, v, grad_u, grad_v = model.linearize(np.broadcast_to(parameters, (len(R), p)), X, Y, Z, J[:, :p])
        for row, (g_x, g_y, g_z) in enumerate((grad_u, grad_v)):
            J[:, p : p + 3, row] = np.stack([Y * g_z - Z * g_y, Z * g_x - X * g_z, X * g_y - Y * g_x], axis=1)
            J[:, p + 3 : p + 6, row] = np.stack([g_x, g_y, g_z], axis=1)
        J[:, -1] = pixels - np.stack([u, v], axis=1)
    return np.where(is_seen[:, None, None], J, 0.0), Z
