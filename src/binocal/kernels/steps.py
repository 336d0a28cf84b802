"""Steps of the joint normal equations, their reduced forms, and what controllers observe of them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.kernels import _kernel
from binocal.kernels.arrays import NOTHING, as_floats
from binocal.shapes import Bool, Float
from binocal.threads import n_threads

VIEWS_PER_THREAD = 400  # as CORNERS_PER_THREAD, for the elimination of the board poses


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """Steps of the shared unknowns and of the board poses, and what is known of them.

    ``predicted_px2`` is the fall of the cost that the linear model predicts. ``gradient_px2`` is the shared unknowns' gradient
    with the board poses eliminated, ``least_pivot`` the least pivot of their equilibrated matrix: 1 where the unknowns do not
    mix, near 0 where some can hardly be distinguished.
    """

    shared: Float[ndarray, "*batch s"]
    views: Float[ndarray, "*batch views 6"]
    predicted_px2: Float[ndarray, "*batch"]
    gradient_px2: Float[ndarray, "*batch s"]
    least_pivot: Float[ndarray, "*batch"]


@dataclass(frozen=True, slots=True, eq=False)
class LastIteration:
    """The kernel's scale now, and of the last iteration: gain, whether its candidate was kept, noise and step before it."""

    scale_px: Float[ndarray, "*batch"]
    gain: Float[ndarray, "*batch"]
    is_kept: Bool[ndarray, "*batch"]
    previous_mad_px: Float[ndarray, "*batch"]
    previous: Steps


def observe(
    r2_px2: tuple[Float[ndarray, "*batch views n"], ...],
    is_seen: tuple[Bool[ndarray, "*batch views n"], ...],
    mad_px: Float[ndarray, "*batch"],
    steps: Steps,
    t_right_left: Float[ndarray, "*batch 3"],
    t_left_board: Float[ndarray, "*batch views 3"],
    last: LastIteration,
) -> Float[ndarray, "*batch f"]:
    """Scale-free numbers of two cameras' residuals and of the next step; :mod:`binocal.solvers.observation` names them."""
    batch = mad_px.shape
    n_rigs = math.prod(batch)
    out = np.empty((*batch, _kernel.N_OBSERVED))
    step = _kernel.NextStep(
        shared=as_floats(steps.shared),
        views=as_floats(steps.views),
        predicted=as_floats(steps.predicted_px2),
        gradient=as_floats(steps.gradient_px2),
        pivot=as_floats(steps.least_pivot),
    )
    previous = _kernel.Previous(
        scale_px=as_floats(last.scale_px),
        gain=as_floats(last.gain),
        is_kept=np.ascontiguousarray(last.is_kept),
        mad=as_floats(last.previous_mad_px),
        predicted=as_floats(last.previous.predicted_px2),
        shared=as_floats(last.previous.shared),
    )
    lengths2 = [np.ascontiguousarray(a).reshape(n_rigs, *a.shape[-2:]) for a in r2_px2]
    seen = [np.ascontiguousarray(a) for a in is_seen]
    t_rig, t_board = as_floats(t_right_left), as_floats(t_left_board)
    _kernel.observe(lengths2, seen, as_floats(mad_px), step, t_rig, t_board, previous, out)
    return out


def solve_steps(
    grams: tuple[Float[ndarray, "*batch views _ _"], ...],
    T_right_left: tuple[Float[ndarray, "*batch 3 3"], Float[ndarray, "*batch 3"]] | None,
    growth: Float[ndarray, "*batch"],
    *,
    pose_growth: Float[ndarray, "*batch"] | None = None,
    is_rig_free: bool = True,
    prior: tuple[Float[ndarray, "*batch s s"], Float[ndarray, "*batch s"]] | None = None,
    stretch: Float[ndarray, "*batch s"] | None = None,
    shift: Float[ndarray, "*batch s"] | None = None,
) -> Steps:
    """Shared and view steps of the joint normal equations, and the fall of the cost that they predict.

    ``grams`` come from :func:`accumulate`, one for each camera; the diagonal of the normal equations is multiplied by
    ``growth``, the board poses' own part by ``pose_growth`` if given. Shared unknowns are the cameras' free parameters,
    then the rig's six if it is free. ``prior`` is added to their information and
    gradient. ``stretch`` multiplies the shared
    steps and ``shift`` is added to them; the views then take their best step beside, and the fall of that step is
    predicted. Views are eliminated by Cholesky factors (Schur complement), the rest by Gauss with pivoting, both
    equilibrated. A view whose weighted corners do not determine its pose neither steps nor counts; a rig whose equations
    are singular gets NaN.
    """
    *batch, n_views, _, _ = grams[0].shape
    n_shared = _n_shared(grams, is_rig_free)
    steps = Steps(
        np.empty((*batch, n_shared)),
        np.empty((*batch, n_views, 6)),
        np.empty(batch),
        np.empty((*batch, n_shared)),
        np.empty(batch),
    )
    out = _kernel.StepArrays(
        shared=steps.shared,
        views=steps.views,
        predicted=steps.predicted_px2,
        reduced=NOTHING,
        gradient=steps.gradient_px2,
        pivot=steps.least_pivot,
    )
    damping = _damping(growth, pose_growth, stretch, shift)
    _solve(_equations(grams, T_right_left, is_rig_free, prior), damping, out, grams[0].shape)
    return steps


def reduced_information(
    grams: tuple[Float[ndarray, "*batch views _ _"], ...],
    T_right_left: tuple[Float[ndarray, "*batch 3 3"], Float[ndarray, "*batch 3"]] | None,
    *,
    is_rig_free: bool = True,
    prior: tuple[Float[ndarray, "*batch s s"], Float[ndarray, "*batch s"]] | None = None,
) -> Float[ndarray, "*batch s s"]:
    """Information of the shared unknowns with the board poses free: the Schur complement of :func:`solve_steps`.

    NaN where a view's own equations are singular.
    """
    batch = grams[0].shape[:-3]
    n_shared = _n_shared(grams, is_rig_free)
    reduced = np.empty((*batch, n_shared, n_shared))
    out = _kernel.StepArrays(
        shared=NOTHING, views=NOTHING, predicted=NOTHING, reduced=reduced, gradient=NOTHING, pivot=NOTHING
    )
    damping = _damping(np.ones(batch), None, None, None)
    _solve(_equations(grams, T_right_left, is_rig_free, prior), damping, out, grams[0].shape)
    return reduced


def reduced_equations(
    grams: tuple[Float[ndarray, "*batch views _ _"], ...],
    T_right_left: tuple[Float[ndarray, "*batch 3 3"], Float[ndarray, "*batch 3"]] | None,
    growth: Float[ndarray, "*batch"],
    *,
    pose_growth: Float[ndarray, "*batch"] | None = None,
    is_rig_free: bool = True,
    prior: tuple[Float[ndarray, "*batch s s"], Float[ndarray, "*batch s"]] | None = None,
) -> tuple[Float[ndarray, "*batch s s"], Float[ndarray, "*batch s"]]:
    """The damped equations of the shared unknowns alone, board poses eliminated, as :func:`solve_steps` solves them.

    For callers who hold combinations of unknowns. NaN for a rig whose equations are singular.
    """
    *batch, n_views, _, _ = grams[0].shape
    s = _n_shared(grams, is_rig_free)
    reduced, gradient = np.empty((*batch, s, s)), np.empty((*batch, s))
    out = _kernel.StepArrays(
        shared=np.empty((*batch, s)),
        views=np.empty((*batch, n_views, 6)),
        predicted=np.empty(batch),
        reduced=reduced,
        gradient=gradient,
        pivot=np.empty(batch),
    )
    damping = _damping(growth, pose_growth, None, None)
    _solve(_equations(grams, T_right_left, is_rig_free, prior), damping, out, grams[0].shape)
    return reduced, gradient


def _n_shared(grams: tuple[ndarray, ...], is_rig_free: bool) -> int:
    return sum(gram.shape[-1] - 7 for gram in grams) + (6 if len(grams) == 2 and is_rig_free else 0)


def _equations(
    grams: tuple[ndarray, ...],
    T_right_left: tuple[ndarray, ndarray] | None,
    is_rig_free: bool,
    prior: tuple[ndarray, ndarray] | None,
) -> _kernel.JointEquations:
    """Contiguous arrays with the batch dimensions made one."""
    n_rigs = math.prod(grams[0].shape[:-3])
    R, t = T_right_left or (None, None)
    information, gradient = prior or (None, None)
    return _kernel.JointEquations(
        grams=[np.ascontiguousarray(gram).reshape(n_rigs, *gram.shape[-3:]) for gram in grams],
        R=as_floats(R),
        t=as_floats(t),
        is_rig_free=is_rig_free,
        prior_information=as_floats(information),
        prior_gradient=as_floats(gradient),
    )


def _damping(
    growth: Float[ndarray, "*batch"],
    pose_growth: Float[ndarray, "*batch"] | None,
    stretch: Float[ndarray, "*batch s"] | None,
    shift: Float[ndarray, "*batch s"] | None,
) -> _kernel.Damping:
    return _kernel.Damping(
        growth=as_floats(growth),
        pose_growth=as_floats(growth if pose_growth is None else pose_growth),
        stretch=as_floats(stretch),
        shift=as_floats(shift),
    )


def _solve(
    equations: _kernel.JointEquations, damping: _kernel.Damping, out: _kernel.StepArrays, shape: tuple[int, ...]
) -> None:
    n_views = math.prod(shape[:-2])  # of all rigs
    _kernel.solve_steps(equations, damping, out, min(n_threads(), 1 + n_views // VIEWS_PER_THREAD))
