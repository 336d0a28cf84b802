"""The one door to the compiled kernel: the inner loop of the joint solver; images enter by :mod:`binocal.kernels.images`.

Both cameras look the same from here. A view's pose is perturbed from the left, ``T_camera_board <- exp(xi)
T_camera_board``, so a corner moves by ``omega x X + tau`` in the camera's own frame; the solver turns that into steps
of the rig and of the board poses with adjoints (:mod:`binocal.solvers.board_views`).

The kernel holds no lock while it works and gives the same result for any number of threads. Its formulas are those of
:mod:`binocal.cameras` and :mod:`binocal.solvers.robust`; tests/kernels states them plainly in NumPy and compares.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy import ndarray

from binocal.shapes import Bool, Float
from binocal.threads import n_threads

try:
    from binocal.kernels import _kernel
except ImportError as error:
    raise ImportError(
        "binocal's compiled kernel is missing or was built for another Python; install binocal with pip "
        "(from a working tree: make, or pip install -e .)"
    ) from error


CORNERS_PER_THREAD = 20_000  # half a millisecond of work; starting a thread costs some 30 microseconds

VIEWS_PER_THREAD = 400  # likewise, for the elimination of the board poses


@dataclass(frozen=True, slots=True, eq=False)
class ViewEquations:
    """Normal equations of every view of one camera.

    ``gram`` is the weighted Gram matrix of the columns [free parameters, xi (6), residual]: JᵀWJ, JᵀWr and rᵀWr in one.
    ``r2_px2`` are squared residual lengths, whitened where there is a whitening but without the robust weight, 0 where a
    corner was not seen. ``cost_px2`` is the robust cost per view; inf where a seen corner lies behind a camera that
    cannot see there, or where a number overflowed.
    """

    gram: Float[ndarray, "*batch views q q"]
    r2_px2: Float[ndarray, "*batch views n"]
    cost_px2: Float[ndarray, "*batch views"]


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """Steps of the shared unknowns and of the board poses, and what is known of them.

    ``predicted_px2`` is the fall of the cost that the linear model predicts. ``gradient_px2`` is the shared unknowns' gradient
    with the board poses eliminated, ``least_pivot`` the least pivot of their equilibrated matrix: 1 where the unknowns do not
    mix, near 0 where some can hardly be told apart.
    """

    shared: Float[ndarray, "*batch s"]
    views: Float[ndarray, "*batch views 6"]
    predicted_px2: Float[ndarray, "*batch"]
    gradient_px2: Float[ndarray, "*batch s"]
    least_pivot: Float[ndarray, "*batch"]


def _n_threads(n_corners: int) -> int:
    return min(n_threads(), 1 + n_corners // CORNERS_PER_THREAD)


def accumulate(
    model: str,
    parameters: Float[ndarray, "*batch p"],
    R_camera_board: Float[ndarray, "*batch views 3 3"],
    t_camera_board: Float[ndarray, "*batch views 3"],
    object_points: Float[ndarray, "3 n"],
    pixels: Float[ndarray, "*batch views 2 n"],
    is_seen: Bool[ndarray, "*batch views n"],
    scale_px: Float[ndarray, "*batch"],
    kernel: Literal["squared", "cauchy", "hampel"],
    is_free: Bool[ndarray, "p"] | None = None,
    whitening: Float[ndarray, "*batch views 3 n"] | None = None,
) -> ViewEquations:
    """Linearise every corner of every view.

    ``pixels`` must be finite where not seen too (any number), and so must ``whitening``: a, b, c of the matrix
    [[a, 0], [b, c]] that a corner's residual and columns are multiplied by. Parameters that are not ``is_free``
    (default: all are) get no columns.
    """
    *batch, n_views, n = is_seen.shape
    free = np.ones(parameters.shape[-1], dtype=bool) if is_free is None else np.ascontiguousarray(is_free)
    q = int(np.count_nonzero(free)) + 7
    n_rigs = math.prod(batch)
    gram = np.empty((*batch, n_views, q, q))
    r2, cost = np.empty((*batch, n_views, n)), np.empty((*batch, n_views))
    scale = _per_rig(scale_px, tuple(batch))
    arrays = _flat(parameters, R_camera_board, t_camera_board, object_points, pixels, is_seen, n_rigs)
    _kernel.accumulate(model, *arrays, _given(whitening), free, scale, kernel, gram, r2, cost, _n_threads(r2.size))
    return ViewEquations(gram, r2, cost)


def squared_lengths(
    model: str,
    parameters: Float[ndarray, "*batch p"],
    R_camera_board: Float[ndarray, "*batch views 3 3"],
    t_camera_board: Float[ndarray, "*batch views 3"],
    object_points: Float[ndarray, "3 n"],
    pixels: Float[ndarray, "*batch views 2 n"],
    is_seen: Bool[ndarray, "*batch views n"],
    whitening: Float[ndarray, "*batch views 3 n"] | None = None,
) -> Float[ndarray, "*batch views n"]:
    """Squared residual lengths alone, as those of :func:`accumulate`. 0 where not seen, inf where not finite."""
    n_rigs = math.prod(is_seen.shape[:-2])
    r2 = np.empty(is_seen.shape)
    arrays = _flat(parameters, R_camera_board, t_camera_board, object_points, pixels, is_seen, n_rigs)
    _kernel.squared_lengths(model, *arrays, _given(whitening), r2, _n_threads(r2.size // 4))
    return r2


def robust_costs(
    r2_px2: Float[ndarray, "*batch n"],
    scale_px: Float[ndarray, "*batch"],
    kernel: Literal["squared", "cauchy", "hampel"],
) -> Float[ndarray, "*batch"]:
    """Robust cost of squared residual lengths, summed over the last axis."""
    batch = r2_px2.shape[:-1]
    n_rigs = math.prod(batch)
    cost = np.empty(batch)
    scale = _per_rig(scale_px, batch)
    _kernel.costs(np.ascontiguousarray(r2_px2, dtype=float).reshape(n_rigs, -1), scale, kernel, cost)
    return cost


def median_lengths2(
    r2_px2: tuple[Float[ndarray, "*batch views n"], ...], is_seen: tuple[Bool[ndarray, "*batch views n"], ...]
) -> Float[ndarray, "*batch"]:
    """Median of each rig's seen squared residual lengths, all cameras together; 0 where nothing is seen."""
    medians = np.empty(r2_px2[0].shape[:-2])
    _kernel.medians([np.ascontiguousarray(a) for a in r2_px2], [np.ascontiguousarray(a) for a in is_seen], medians)
    return medians


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
    rig = (_NOTHING,) * 3 if T_right_left is None else T_right_left
    _kernel.pixels_behind(
        model,
        *(np.ascontiguousarray(a, dtype=float).reshape(n_rigs, -1) for a in parameters),
        *(np.ascontiguousarray(a, dtype=float) for a in (*T_left_board, *rig, bend, object_points)),
        np.ascontiguousarray(pixels, dtype=float).reshape(-1, 2, pixels.shape[-1]),
        out.reshape(-1, 2, pixels.shape[-1]),
        _n_threads(pixels.size // 4),
    )
    return out


def unweighted_columns(
    model: str,
    parameters: Float[ndarray, "p"],
    R_camera_board: Float[ndarray, "views 3 3"],
    t_camera_board: Float[ndarray, "views 3"],
    object_points: Float[ndarray, "3 n"],
    pixels: Float[ndarray, "views 2 n"],
    is_seen: Bool[ndarray, "views n"],
) -> Float[ndarray, "views q 2n"]:
    """The columns [parameters, xi (6), residual] themselves, of one rig, for solvers that must not square them."""
    n_views, n = is_seen.shape
    columns = np.empty((n_views, len(parameters) + 7, 2 * n))
    _kernel.unweighted_columns(
        model, *_flat(parameters, R_camera_board, t_camera_board, object_points, pixels, is_seen, 1), columns
    )
    return columns


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
    out = tuple(np.empty((*batch, *shape)) for shape in ((3, 3), (3, 3), (3, 6), (2, 2), u.shape[-1:], u.shape[-1:]))
    arrays = [np.ascontiguousarray(a, dtype=float) for a in (xy.T, u, v, w)]
    _kernel.fit_planes(*arrays, n_passes, *out, _n_threads(u.size // 4))
    return out


def solve_steps(
    grams: tuple[Float[ndarray, "*batch views q q"], ...],
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
    out = (steps.shared, steps.views, steps.predicted_px2, _NOTHING, steps.gradient_px2, steps.least_pivot)
    growths = (growth, growth if pose_growth is None else pose_growth)
    _solve(grams, T_right_left, growths, is_rig_free, prior, (stretch, shift), out)
    return steps


def reduced_information(
    grams: tuple[Float[ndarray, "*batch views q q"], ...],
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
    out = (_NOTHING, _NOTHING, _NOTHING, reduced, _NOTHING, _NOTHING)
    _solve(grams, T_right_left, (np.ones(batch),) * 2, is_rig_free, prior, (None, None), out)
    return reduced


def reduced_equations(
    grams: tuple[Float[ndarray, "*batch views q q"], ...],
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


_NOTHING = np.empty(0)


def _per_rig(scale_px: ndarray, batch: tuple[int, ...]) -> Float[ndarray, "rigs"]:
    """One scale for each rig, in a row."""
    scale = np.asarray(scale_px, dtype=float)
    if scale.shape != batch:
        scale = np.broadcast_to(scale, batch)
    return np.ascontiguousarray(scale).reshape(-1)


def _given(whitening: ndarray | None) -> ndarray:
    return _NOTHING if whitening is None else np.ascontiguousarray(whitening, dtype=float)


def _n_shared(grams: tuple[ndarray, ...], is_rig_free: bool) -> int:
    return sum(gram.shape[-1] - 7 for gram in grams) + (6 if len(grams) == 2 and is_rig_free else 0)


def _solve(
    grams: tuple[ndarray, ...],
    T_right_left: tuple[ndarray, ndarray] | None,
    growths: tuple[ndarray, ndarray],
    is_rig_free: bool,
    prior: tuple[ndarray, ndarray] | None,
    alteration: tuple[ndarray | None, ndarray | None],
    out: tuple[ndarray, ...],
) -> None:
    n_views = grams[0].shape[-3]
    n_rigs = math.prod(grams[0].shape[:-3])
    flat = [np.ascontiguousarray(gram).reshape(n_rigs, n_views, *gram.shape[-2:]) for gram in grams]
    R, t = (_NOTHING, _NOTHING) if T_right_left is None else T_right_left
    information, gradient = (_NOTHING, _NOTHING) if prior is None else prior
    _kernel.solve_steps(
        flat,
        *(np.ascontiguousarray(a, dtype=float) for a in (R, t)),
        is_rig_free,
        *(
            np.ascontiguousarray(a, dtype=float)
            for a in (information, gradient, *growths, *(_NOTHING if a is None else a for a in alteration))
        ),
        *out,
        min(n_threads(), 1 + n_rigs * n_views // VIEWS_PER_THREAD),
    )


def _flat(
    parameters: ndarray,
    R: ndarray,
    t: ndarray,
    object_points: ndarray,
    pixels: ndarray,
    is_seen: ndarray,
    n_rigs: int,
) -> tuple[ndarray, ...]:
    """Contiguous arrays with the batch dimensions made one."""
    n = is_seen.shape[-1]
    return (
        np.ascontiguousarray(parameters, dtype=float).reshape(n_rigs, -1),
        np.ascontiguousarray(R, dtype=float).reshape(-1, 3, 3),
        np.ascontiguousarray(t, dtype=float).reshape(-1, 3),
        np.ascontiguousarray(object_points, dtype=float),
        np.ascontiguousarray(pixels, dtype=float).reshape(-1, 2, n),
        np.ascontiguousarray(is_seen).reshape(-1, n),
    )
