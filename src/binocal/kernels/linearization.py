"""Residuals, normal equations and robust costs of every view of one camera.

A view's pose is perturbed from the left, ``T_camera_board <- exp(xi) T_camera_board``, so a corner moves by ``omega x X + tau``
in the camera's own frame; the solver turns that into steps of the rig and of the board poses with adjoints
(:mod:`binocal.solvers.board_views`). Both cameras look the same from here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.kernels import _kernel
from binocal.kernels.arrays import NOTHING, as_floats, per_rig, threads_for
from binocal.shapes import Bool, Float


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
class PointEquations:
    """What the board's own points add to the normal equations of one camera's views.

    ``coupling`` holds the weighted products of the columns of :class:`ViewEquations` with the derivatives by each point's step
    along the board's axes, or with combinations of them (:meth:`in_modes`); its last row is the points' gradient. ``information``
    are the points' own 3 x 3 matrices: xx, xy, xz, yy, yz, zz.
    """

    coupling: Float[ndarray, "*batch views q axes columns"]
    information: Float[ndarray, "*batch views 6 n"]

    def in_modes(self, modes: Float[ndarray, "m r"]) -> PointEquations:
        """The coupling with combinations of the points' coordinates, as (views, q, 1, r); their own information is left out."""
        *shape, _, n = self.coupling.shape
        coupling = self.coupling.reshape(-1, 3 * n) @ modes
        return PointEquations(coupling.reshape(*shape, 1, -1), self.information[..., :0])


def accumulate(
    model: str,
    parameters: Float[ndarray, "*batch p"],
    R_camera_board: Float[ndarray, "*batch views 3 3"],
    t_camera_board: Float[ndarray, "*batch views 3"],
    object_points: Float[ndarray, "3 n"],
    pixels: Float[ndarray, "*batch views 2 n"],
    is_seen: Bool[ndarray, "*batch views n"],
    scale_px: Float[ndarray, "*batch"],
    kernel: str,
    is_free: Bool[ndarray, "p"] | None = None,
    whitening: Float[ndarray, "*batch views 3 n"] | None = None,
) -> ViewEquations:
    """Linearise every corner of every view.

    ``pixels`` must be finite where not seen too (any number), and so must ``whitening``: a, b, c of the matrix
    [[a, 0], [b, c]] that a corner's residual and columns are multiplied by. Parameters that are not ``is_free``
    (default: all are) get no columns.
    """
    views = _views(parameters, R_camera_board, t_camera_board, object_points, pixels, is_seen, whitening)
    return _accumulated(model, views, is_seen.shape, scale_px, kernel, is_free, parameters.shape[-1], False)[0]


def accumulate_with_points(
    model: str,
    parameters: Float[ndarray, "*batch p"],
    R_camera_board: Float[ndarray, "*batch views 3 3"],
    t_camera_board: Float[ndarray, "*batch views 3"],
    object_points: Float[ndarray, "3 n"],
    pixels: Float[ndarray, "*batch views 2 n"],
    is_seen: Bool[ndarray, "*batch views n"],
    scale_px: Float[ndarray, "*batch"],
    kernel: str,
    is_free: Bool[ndarray, "p"] | None = None,
    whitening: Float[ndarray, "*batch views 3 n"] | None = None,
) -> tuple[ViewEquations, PointEquations]:
    """:func:`accumulate`, and what it takes to move the board's points as well."""
    views = _views(parameters, R_camera_board, t_camera_board, object_points, pixels, is_seen, whitening)
    equations, points = _accumulated(model, views, is_seen.shape, scale_px, kernel, is_free, parameters.shape[-1], True)
    assert points is not None  # they were asked for
    return equations, points


def point_gradients(
    model: str,
    parameters: Float[ndarray, "p"],
    R_camera_board: Float[ndarray, "views 3 3"],
    t_camera_board: Float[ndarray, "views 3"],
    object_points: Float[ndarray, "3 n"],
    pixels: Float[ndarray, "views 2 n"],
    is_seen: Bool[ndarray, "views n"],
    scale_px: Float[ndarray, "*batch"],
    kernel: str,
    whitening: Float[ndarray, "views 3 n"] | None = None,
) -> Float[ndarray, "3 n"]:
    """The gradient of the board's points in all views of one rig together: the last row of the coupling."""
    views = _views(parameters, R_camera_board, t_camera_board, object_points, pixels, is_seen, whitening)
    n_views, n = is_seen.shape
    gradients = np.empty((n_views, 3, n))
    out = _kernel.Sums(
        gram=np.empty((n_views, 7, 7)),
        r2=np.empty((n_views, n)),
        cost=np.empty(n_views),
        coupling=gradients,
        information=NOTHING,
    )
    held = np.zeros(parameters.shape[-1], dtype=bool)
    _kernel.accumulate(model, views, held, per_rig(scale_px, ()), kernel, out, threads_for(is_seen.size))
    return gradients.sum(axis=0)


def _accumulated(
    model: str,
    views: _kernel.Views,
    shape: tuple[int, ...],
    scale_px: Float[ndarray, "*batch"],
    kernel: str,
    is_free: Bool[ndarray, "p"] | None,
    p: int,
    with_points: bool,
) -> tuple[ViewEquations, PointEquations | None]:
    *batch, n_views, n = shape
    free = np.ones(p, dtype=bool) if is_free is None else np.ascontiguousarray(is_free)
    q = int(np.count_nonzero(free)) + 7
    gram = np.empty((*batch, n_views, q, q))
    r2, cost = np.empty((*batch, n_views, n)), np.empty((*batch, n_views))
    points = None
    if with_points:
        points = PointEquations(np.empty((*batch, n_views, q, 3, n)), np.empty((*batch, n_views, 6, n)))
    out = _kernel.Sums(
        gram=gram,
        r2=r2,
        cost=cost,
        coupling=NOTHING if points is None else points.coupling,
        information=NOTHING if points is None else points.information,
    )
    _kernel.accumulate(model, views, free, per_rig(scale_px, tuple(batch)), kernel, out, threads_for(r2.size))
    return ViewEquations(gram, r2, cost), points


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
    r2 = np.empty(is_seen.shape)
    views = _views(parameters, R_camera_board, t_camera_board, object_points, pixels, is_seen, whitening)
    _kernel.squared_lengths(model, views, r2, threads_for(r2.size // 4))
    return r2


def robust_costs(
    r2_px2: Float[ndarray, "*batch n"],
    scale_px: Float[ndarray, "*batch"],
    kernel: str,
) -> Float[ndarray, "*batch"]:
    """Robust cost of squared residual lengths, summed over the last axis."""
    batch = r2_px2.shape[:-1]
    n_rigs = math.prod(batch)
    cost = np.empty(batch)
    scale = per_rig(scale_px, batch)
    _kernel.costs(np.ascontiguousarray(r2_px2, dtype=float).reshape(n_rigs, -1), scale, kernel, cost)
    return cost


def median_lengths2(
    r2_px2: tuple[Float[ndarray, "*batch views n"], ...], is_seen: tuple[Bool[ndarray, "*batch views n"], ...]
) -> Float[ndarray, "*batch"]:
    """Median of each rig's seen squared residual lengths, all cameras together; 0 where nothing is seen."""
    medians = np.empty(r2_px2[0].shape[:-2])
    _kernel.medians([np.ascontiguousarray(a) for a in r2_px2], [np.ascontiguousarray(a) for a in is_seen], medians)
    return medians


def unweighted_columns(
    model: str,
    parameters: Float[ndarray, "p"],
    R_camera_board: Float[ndarray, "views 3 3"],
    t_camera_board: Float[ndarray, "views 3"],
    object_points: Float[ndarray, "3 n"],
    pixels: Float[ndarray, "views 2 n"],
    is_seen: Bool[ndarray, "views n"],
) -> Float[ndarray, "views q columns"]:
    """The columns [parameters, xi (6), residual] themselves, of one rig, for solvers that must not square them."""
    n_views, n = is_seen.shape
    columns = np.empty((n_views, len(parameters) + 7, 2 * n))
    views = _views(parameters, R_camera_board, t_camera_board, object_points, pixels, is_seen, None)
    _kernel.unweighted_columns(model, views, columns)
    return columns


def _views(
    parameters: ndarray,
    R: ndarray,
    t: ndarray,
    object_points: ndarray,
    pixels: ndarray,
    is_seen: ndarray,
    whitening: ndarray | None,
) -> _kernel.Views:
    """Contiguous arrays with the batch dimensions made one."""
    n, n_rigs = is_seen.shape[-1], math.prod(is_seen.shape[:-2])
    return _kernel.Views(
        parameters=as_floats(parameters).reshape(n_rigs, -1),
        R=as_floats(R),
        t=as_floats(t),
        points=as_floats(object_points),
        pixels=as_floats(pixels),
        is_seen=np.ascontiguousarray(is_seen).reshape(-1, n),
        whitening=as_floats(whitening),
    )
