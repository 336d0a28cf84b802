"""The inner loop: residuals, Jacobians and per-view normal equations of one camera.

This is the one door to the hot loop; a compiled kernel replaces :func:`accumulate` and nothing else.

Both cameras look the same from here. A view's pose is perturbed from the left, ``T_camera_board <- exp(xi)
T_camera_board``, so a corner moves by ``omega x X + tau`` in the camera's own frame; the solver turns that into steps
of the rig and of the board poses with adjoints (:mod:`binocal.solvers.stereo`).
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray

from binocal.cameras import CameraModel
from binocal.solvers import robust

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

CHUNK_CORNERS = (
    2500  # corners linearised at once: their Jacobian (0.7 MB) and every temporary stay in cache and out of page faults
)


_scratch = threading.local()


def _scratch_columns(shape: tuple[int, ...]) -> ndarray:
    """Uninitialised memory that this thread's next call will overwrite.

    Fresh memory for every call cost more in page faults (2200 an iteration at 100 views) than the arithmetic: 6.3 ms
    against 3.8.
    """
    size = int(np.prod(shape))
    buffer = getattr(_scratch, "buffer", None)
    if buffer is None or buffer.size < size:
        buffer = _scratch.buffer = np.empty(size)
    return buffer[:size].reshape(shape)


@dataclass(frozen=True, slots=True, eq=False)
class ViewEquations:
    """Normal equations of every view of one camera.

    ``gram`` is the weighted Gram matrix of the columns [parameters, xi (6), residual]: JᵀWJ, JᵀWr and rᵀWr in one.
    ``r2_px2`` are unweighted squared residual lengths, 0 where a corner was not seen. ``cost_px2`` is the robust cost
    per view; inf where a seen corner lies behind a camera that cannot see there, or where a number overflowed.
    """

    gram: Float[ndarray, "*batch views q q"]
    r2_px2: Float[ndarray, "*batch views n"]
    cost_px2: Float[ndarray, "*batch views"]


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
) -> ViewEquations:
    """Linearise every corner of every view. ``pixels`` must be finite where not seen too (any number).

    Cost linear in the views; memory beyond the result is bounded (see ``CHUNK_CORNERS``).
    """
    batch = pixels.shape[:-3]
    n_views, n = pixels.shape[-3], pixels.shape[-1]
    p = model.n_parameters
    size = p + 7
    total = int(np.prod(batch, dtype=int)) * n_views
    per_view_parameters = np.broadcast_to(parameters[..., None, :], (*batch, n_views, p)).reshape(total, p)
    per_view_scale = np.broadcast_to(np.asarray(scale_px, dtype=float)[..., None], (*batch, n_views)).reshape(total, 1)
    R, t = R_camera_board.reshape(total, 3, 3), t_camera_board.reshape(total, 3)
    flat_pixels, flat_seen = pixels.reshape(total, 2, n), is_seen.reshape(total, n)

    gram = np.empty((total, size, size))
    r2 = np.empty((total, n))
    cost = np.empty(total)
    chunk = max(1, CHUNK_CORNERS // n)
    columns = _scratch_columns((min(chunk, total), size, 2, n))
    for start in range(0, total, chunk):
        these = slice(start, min(start + chunk, total))
        J = columns[: these.stop - start]
        length2, Z = _fill_columns(
            model,
            per_view_parameters[these],
            R[these],
            t[these],
            object_points,
            flat_pixels[these],
            flat_seen[these],
            J,
        )
        r2[these] = length2
        with np.errstate(all="ignore"):
            if kernel != "squared":
                J *= np.sqrt(robust.weights(length2, per_view_scale[these], kernel))[:, None, None]
            flat = J.reshape(len(J), size, 2 * n)
            np.matmul(flat, flat.swapaxes(-1, -2), out=gram[these])
            view_cost = robust.costs(length2, per_view_scale[these], kernel).sum(axis=-1)
        if not model.sees_behind:
            view_cost[np.any(flat_seen[these] & (Z <= 0), axis=-1)] = np.inf
        view_cost[~np.isfinite(view_cost)] = np.inf
        cost[these] = view_cost
    return ViewEquations(
        gram.reshape(*batch, n_views, size, size), r2.reshape(*batch, n_views, n), cost.reshape(*batch, n_views)
    )


def squared_lengths(
    model: CameraModel,
    parameters: Float[ndarray, "*batch p"],
    R_camera_board: Float[ndarray, "*batch views 3 3"],
    t_camera_board: Float[ndarray, "*batch views 3"],
    object_points: Float[ndarray, "3 n"],
    pixels: Float[ndarray, "*batch views 2 n"],
    is_seen: Bool[ndarray, "*batch views n"],
) -> Float[ndarray, "*batch views n"]:
    """Squared residual lengths alone, a third of the cost of :func:`accumulate`.

    0 where not seen, inf where not finite.
    """
    X = R_camera_board @ object_points + t_camera_board[..., None]
    with np.errstate(all="ignore"):
        u, v = model.project(parameters[..., None, :], X[..., 0, :], X[..., 1, :], X[..., 2, :])
        r2 = (pixels[..., 0, :] - u) ** 2 + (pixels[..., 1, :] - v) ** 2
    return np.where(is_seen, np.where(np.isfinite(r2), r2, np.inf), 0.0)


def unweighted_columns(
    model: CameraModel,
    parameters: Float[ndarray, "p"],
    R_camera_board: Float[ndarray, "views 3 3"],
    t_camera_board: Float[ndarray, "views 3"],
    object_points: Float[ndarray, "3 n"],
    pixels: Float[ndarray, "views 2 n"],
    is_seen: Bool[ndarray, "views n"],
) -> Float[ndarray, "views q 2n"]:
    """The columns [parameters, xi (6), residual] themselves, of one rig, for solvers that must not square them."""
    n_views, n = len(pixels), pixels.shape[-1]
    J = np.empty((n_views, model.n_parameters + 7, 2, n))
    repeated = np.broadcast_to(parameters, (n_views, model.n_parameters))
    _fill_columns(model, repeated, R_camera_board, t_camera_board, object_points, pixels, is_seen, J)
    return J.reshape(n_views, -1, 2 * n)


def _fill_columns(
    model: CameraModel,
    parameters: ndarray,
    R: ndarray,
    t: ndarray,
    object_points: ndarray,
    pixels: ndarray,
    is_seen: ndarray,
    J: ndarray,
) -> tuple[Float[ndarray, "views n"], Float[ndarray, "views n"]]:
    """Fill ``J`` (views, p + 7, 2, n), zero where not seen; return squared residual lengths and depths."""
    p = model.n_parameters
    X = R @ object_points
    X += t[:, :, None]
    X, Y, Z = X[:, 0], X[:, 1], X[:, 2]
    with np.errstate(all="ignore"):
        u, v, grad_u, grad_v = model.linearize(parameters, X, Y, Z, J[:, :p])
        for row, (g_x, g_y, g_z) in enumerate((grad_u, grad_v)):
            J[:, p, row] = Y * g_z - Z * g_y
            J[:, p + 1, row] = Z * g_x - X * g_z
            J[:, p + 2, row] = X * g_y - Y * g_x
            J[:, p + 3, row], J[:, p + 4, row], J[:, p + 5, row] = g_x, g_y, g_z
        np.subtract(pixels[:, 0], u, out=J[:, -1, 0])
        np.subtract(pixels[:, 1], v, out=J[:, -1, 1])
        length2 = np.einsum("vcn,vcn->vn", J[:, -1], J[:, -1])
        if not is_seen.all():
            length2[~is_seen] = 0.0
            J[np.broadcast_to(~is_seen[:, None, None], J.shape)] = 0.0
    return length2, Z
