"""Rigid transforms stepped and composed, corners followed along a step, and planes fitted to their images."""

from __future__ import annotations

import math

import numpy as np
from numpy import ndarray

from binocal.kernels import _kernel
from binocal.kernels.arrays import NOTHING, threads_for
from binocal.shapes import Float


def step_poses(
    R: Float[ndarray, "*batch 3 3"], t: Float[ndarray, "*batch 3"], xi: Float[ndarray, "*batch 6"]
) -> tuple[Float[ndarray, "*batch 3 3"], Float[ndarray, "*batch 3"]]:
    """Rigid transforms stepped from the left: ``(exp(omega), tau) T`` with xi = (omega, tau)."""
    arrays = [np.ascontiguousarray(a, dtype=float) for a in (R, t, xi)]
    out = np.empty(arrays[0].shape), np.empty(arrays[1].shape)
    _kernel.step_poses(*arrays, *out)
    return out


def compose_poses(
    R_rig: Float[ndarray, "*batch 3 3"],
    t_rig: Float[ndarray, "*batch 3"],
    R: Float[ndarray, "*batch views 3 3"],
    t: Float[ndarray, "*batch views 3"],
) -> tuple[Float[ndarray, "*batch views 3 3"], Float[ndarray, "*batch views 3"]]:
    """Every rig's transform after each of its views'."""
    arrays = [np.ascontiguousarray(a, dtype=float) for a in (R_rig, t_rig, R, t)]
    out = np.empty(arrays[2].shape), np.empty(arrays[3].shape)
    _kernel.compose_poses(*arrays, *out)
    return out


def pixels_behind(
    model: str,
    parameters: tuple[Float[ndarray, "*batch p"], Float[ndarray, "*batch p"]],
    T_left_board: tuple[
        Float[ndarray, "*batch views 3 3"], Float[ndarray, "*batch views 3"], Float[ndarray, "*batch views 6"]
    ],
    T_right_left: tuple[Float[ndarray, "*batch 3 3"], Float[ndarray, "*batch 3"], Float[ndarray, "*batch 6"]] | None,
    object_points: Float[ndarray, "3 n"],
    pixels: Float[ndarray, "*batch views 2 n"],
    bend: Float[ndarray, "*batch"],
) -> Float[ndarray, "*batch views 2 n"]:
    """``pixels`` less the motion of the predicted corners along a step, to second order (of which ``bend`` counts).

    Each value comes with its step: parameters additive, transforms stepped from the left. ``T_right_left`` is None for the
    left camera. A residual to these pixels where the estimate stands is the residual that the second-order model of the
    projections leaves after the step.
    """
    n_rigs = math.prod(pixels.shape[:-3])
    out = np.empty(pixels.shape)
    rig = (NOTHING,) * 3 if T_right_left is None else T_right_left
    _kernel.pixels_behind(
        model,
        *(np.ascontiguousarray(a, dtype=float).reshape(n_rigs, -1) for a in parameters),
        *(np.ascontiguousarray(a, dtype=float) for a in (*T_left_board, *rig, bend, object_points)),
        np.ascontiguousarray(pixels, dtype=float).reshape(-1, 2, pixels.shape[-1]),
        out.reshape(-1, 2, pixels.shape[-1]),
        threads_for(pixels.size // 4),
    )
    return out


def fit_planes(
    xy: Float[ndarray, "n 2"],
    u: Float[ndarray, "*batch n"],
    v: Float[ndarray, "*batch n"],
    w: Float[ndarray, "*batch n"],
    n_passes: int,
) -> tuple[
    Float[ndarray, "*batch 3 3"],
    Float[ndarray, "*batch 3 3"],
    Float[ndarray, "*batch 3 6"],
    Float[ndarray, "*batch 2 2"],
    Float[ndarray, "*batch n"],
    Float[ndarray, "*batch n"],
]:
    """Homographies of plane points, the blocks of their inverse normal matrices, and residuals in u and v.

    Model and formulas: :func:`binocal.geometry.homography.fit_plane`.
    """
    batch = u.shape[:-1]
    rows, S_inverse, P, D_inverse, du, dv = (
        np.empty((*batch, *shape)) for shape in ((3, 3), (3, 3), (3, 6), (2, 2), u.shape[-1:], u.shape[-1:])
    )
    out = (rows, S_inverse, P, D_inverse, du, dv)
    arrays = [np.ascontiguousarray(a, dtype=float) for a in (xy.T, u, v, w)]
    _kernel.fit_planes(*arrays, n_passes, *out, threads_for(u.size // 4))
    return out
