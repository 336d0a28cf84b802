"""The compiled kernel's residuals and normal equations in NumPy, for camera models that it does not know.

Ten to thirty times slower. Same arguments, conventions and results as :func:`binocal.kernels.accumulate` and
:func:`binocal.kernels.squared_lengths`, but for the model, which is given as its functions.
"""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.cameras import CameraModel
from binocal.kernels import ViewEquations
from binocal.shapes import Bool, Float
from binocal.solvers import robust


def accumulate(
    model: CameraModel,
    parameters: Float[ndarray, "*batch p"],
    R_camera_board: Float[ndarray, "*batch views 3 3"],
    t_camera_board: Float[ndarray, "*batch views 3"],
    object_points: Float[ndarray, "3 n"],
    pixels: Float[ndarray, "*batch views 2 n"],
    is_seen: Bool[ndarray, "*batch views n"],
    scale_px: Float[ndarray, "*batch"],
    kernel: robust.Kernel,
    is_free: Bool[ndarray, "p"],
    whitening: Float[ndarray, "*batch views 3 n"] | None = None,
) -> ViewEquations:
    """Linearise every corner of every view."""
    p = model.n_parameters
    X, Y, Z = np.moveaxis(R_camera_board @ object_points + t_camera_board[..., None], -2, 0)
    columns = np.empty((*is_seen.shape[:-1], p + 7, 2, is_seen.shape[-1]))
    with np.errstate(all="ignore"):
        u, v, grad_u, grad_v = model.linearize(
            np.broadcast_to(parameters[..., None, :], (*is_seen.shape[:-1], p)), X, Y, Z, columns[..., :p, :, :]
        )
        for row, (g_x, g_y, g_z) in enumerate((grad_u, grad_v)):
            turned = (Y * g_z - Z * g_y, Z * g_x - X * g_z, X * g_y - Y * g_x)
            columns[..., p : p + 6, row, :] = np.stack([*turned, g_x, g_y, g_z], axis=-2)
        columns[..., -1, :, :] = pixels - np.stack([u, v], axis=-2)
        columns = np.where(is_seen[..., None, None, :], columns, 0.0)
        columns = columns[..., np.r_[is_free, np.ones(7, dtype=bool)], :, :]
        if whitening is not None:
            columns = _whitened(columns, whitening[..., None, :, :])
        r2 = np.square(columns[..., -1, :, :]).sum(axis=-2)
        scale = np.asarray(scale_px, dtype=float)[..., None, None]  # of each rig, for each corner of its views
        weight = robust.weights(r2, scale, kernel)
        gram = np.einsum("...acn,...n,...bcn->...ab", columns, weight, columns, optimize=True)
        cost = robust.costs(r2, scale, kernel).sum(axis=-1)
    if not model.sees_behind:
        cost[np.any(is_seen & ~(Z > 0), axis=-1)] = np.inf
    cost[~np.isfinite(cost)] = np.inf
    return ViewEquations(gram, r2, cost)


def squared_lengths(
    model: CameraModel,
    parameters: Float[ndarray, "*batch p"],
    R_camera_board: Float[ndarray, "*batch views 3 3"],
    t_camera_board: Float[ndarray, "*batch views 3"],
    object_points: Float[ndarray, "3 n"],
    pixels: Float[ndarray, "*batch views 2 n"],
    is_seen: Bool[ndarray, "*batch views n"],
    whitening: Float[ndarray, "*batch views 3 n"] | None = None,
) -> Float[ndarray, "*batch views n"]:
    """Squared residual lengths alone. 0 where not seen, inf where not finite."""
    X, Y, Z = np.moveaxis(R_camera_board @ object_points + t_camera_board[..., None], -2, 0)
    with np.errstate(all="ignore"):
        residual = pixels - np.stack(model.project(parameters[..., None, :], X, Y, Z), axis=-2)
        if whitening is not None:
            residual = _whitened(residual, whitening)
        r2 = np.square(residual).sum(axis=-2)
    return np.where(is_seen, np.where(np.isfinite(r2), r2, np.inf), 0.0)


def _whitened(
    vectors: Float[ndarray, "*any 2 n"], whitening: Float[ndarray, "*views 3 n"]
) -> Float[ndarray, "*any 2 n"]:
    """Each vector times [[a, 0], [b, c]]."""
    a, b, c = np.moveaxis(whitening, -2, 0)
    return np.stack([a * vectors[..., 0, :], b * vectors[..., 0, :] + c * vectors[..., 1, :]], axis=-2)
