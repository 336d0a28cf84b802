"""Steps of the joint normal equations, their reduced forms, and what controllers observe of them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.kernels import _kernel
from binocal.kernels.arrays import NOTHING
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
    floats = (
        mad_px,
        steps.shared,
        steps.views,
        steps.predicted_px2,
        steps.gradient_px2,
        steps.least_pivot,
        t_right_left,
    )
    before = (last.previous_mad_px, last.previous.predicted_px2, last.previous.shared)
    _kernel.observe(
        [np.ascontiguousarray(a).reshape(n_rigs, *a.shape[-2:]) for a in r2_px2],
        [np.ascontiguousarray(a) for a in is_seen],
        *(np.ascontiguousarray(a, dtype=float) for a in (*floats, t_left_board, last.scale_px, last.gain)),
        np.ascontiguousarray(last.is_kept),
        *(np.ascontiguousarray(a, dtype=float) for a in before),
        out,
    )
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
    out = (steps.shared, steps.views, steps.predicted_px2, NOTHING, steps.gradient_px2, steps.least_pivot)
    growths = (growth, growth if pose_growth is None else pose_growth)
    _solve(grams, T_right_left, growths, is_rig_free, prior, (stretch, shift), out)
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
    out = (NOTHING, NOTHING, NOTHING, reduced, NOTHING, NOTHING)
    _solve(grams, T_right_left, (np.ones(batch), np.ones(batch)), is_rig_free, prior, (None, None), out)
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
    unused = (np.empty((*batch, s)), np.empty((*batch, n_views, 6)), np.empty(batch))
    growths = (growth, growth if pose_growth is None else pose_growth)
    _solve(
        grams, T_right_left, growths, is_rig_free, prior, (None, None), (*unused, reduced, gradient, np.empty(batch))
    )
    return reduced, gradient


def _n_shared(grams: tuple[ndarray, ...], is_rig_free: bool) -> int:
    return sum(gram.shape[-1] - 7 for gram in grams) + (6 if len(grams) == 2 and is_rig_free else 0)


def _solve(
    grams: tuple[ndarray, ...],
    T_right_left: tuple[ndarray, ndarray] | None,
    growths: tuple[Float[ndarray, "*batch"], Float[ndarray, "*batch"]],
    is_rig_free: bool,
    prior: tuple[ndarray, ndarray] | None,
    alteration: tuple[ndarray | None, ndarray | None],
    out: tuple[ndarray, ...],
) -> None:
    n_views = grams[0].shape[-3]
    n_rigs = math.prod(grams[0].shape[:-3])
    flat = [np.ascontiguousarray(gram).reshape(n_rigs, n_views, *gram.shape[-2:]) for gram in grams]
    R, t = (NOTHING, NOTHING) if T_right_left is None else T_right_left
    information, gradient = (NOTHING, NOTHING) if prior is None else prior
    _kernel.solve_steps(
        flat,
        *(np.ascontiguousarray(a, dtype=float) for a in (R, t)),
        is_rig_free,
        *(
            np.ascontiguousarray(a, dtype=float)
            for a in (information, gradient, *growths, *(NOTHING if a is None else a for a in alteration))
        ),
        *out,
        min(n_threads(), 1 + n_rigs * n_views // VIEWS_PER_THREAD),
    )
