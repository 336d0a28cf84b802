"""Rigid transforms stepped and composed, corners followed along a step, and planes fitted to their images."""

from __future__ import annotations

import math

import numpy as np
from numpy import ndarray

from binocal.kernels import _kernel
from binocal.kernels.arrays import as_floats, threads_for
from binocal.shapes import Float


def step_poses(
    R: Float[ndarray, "*batch 3 3"], t: Float[ndarray, "*batch 3"], xi: Float[ndarray, "*batch 6"]
) -> tuple[Float[ndarray, "*batch 3 3"], Float[ndarray, "*batch 3"]]:
    """Rigid transforms stepped from the left: ``(exp(omega), tau) T`` with xi = (omega, tau)."""
    R_out, t_out = np.empty(R.shape), np.empty(t.shape)
    _kernel.step_poses(as_floats(R), as_floats(t), as_floats(xi), R_out, t_out)
    return R_out, t_out


def compose_poses(
    R_rig: Float[ndarray, "*batch 3 3"],
    t_rig: Float[ndarray, "*batch 3"],
    R: Float[ndarray, "*batch views 3 3"],
    t: Float[ndarray, "*batch views 3"],
) -> tuple[Float[ndarray, "*batch views 3 3"], Float[ndarray, "*batch views 3"]]:
    """Every rig's transform after each of its views'."""
    R_out, t_out = np.empty(R.shape), np.empty(t.shape)
    _kernel.compose_poses(as_floats(R_rig), as_floats(t_rig), as_floats(R), as_floats(t), R_out, t_out)
    return R_out, t_out


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
    values, value_steps = (as_floats(a).reshape(n_rigs, -1) for a in parameters)
    R, t, view_step = (as_floats(a) for a in T_left_board)
    R_rig, t_rig, rig_step = (as_floats(a) for a in T_right_left or (None, None, None))
    movement = _kernel.Movement(
        parameters=values,
        parameter_step=value_steps,
        R=R,
        t=t,
        view_step=view_step,
        R_rig=R_rig,
        t_rig=t_rig,
        rig_step=rig_step,
    )
    flat = as_floats(pixels).reshape(-1, 2, pixels.shape[-1])
    n_threads = threads_for(pixels.size // 4)
    _kernel.pixels_behind(
        model, movement, as_floats(bend), as_floats(object_points), flat, out.reshape(flat.shape), n_threads
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
    *batch, n = u.shape
    rows, S_inverse, P, D_inverse = (np.empty((*batch, *shape)) for shape in ((3, 3), (3, 3), (3, 6), (2, 2)))
    du, dv = np.empty((*batch, n)), np.empty((*batch, n))
    out = _kernel.PlaneFits(rows=rows, S_inverse=S_inverse, P=P, D_inverse=D_inverse, du=du, dv=dv)
    n_threads = threads_for(u.size // 4)
    _kernel.fit_planes(as_floats(xy.T), as_floats(u), as_floats(v), as_floats(w), n_passes, out, n_threads)
    return rows, S_inverse, P, D_inverse, du, dv
