"""What rigs of different camera models make of views that they were not fitted to: rows and lengths.

Blocks of views are left out in turn. The rig without a block follows from the solver's own equations by one Newton step: at the
minimum of all views the others' equations are at hand, so no block needs a solve. Rows and lengths are then measured on the
block's corners: how far matching corners miss each other's epipolar plane, and how large the rig measures the board.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.evidence import Detections
from binocal.geometry import so3
from binocal.kernels import ViewEquations
from binocal.shapes import Bool, Float, Int
from binocal.solvers.board_views import BundleEstimate, BundleMinimum, BundleProblem

MAX_BLOCKS = 6
CAP_SIGMA = 5.0  # a wild corner must not choose the model
MIN_SINE = 0.05  # between a ray and the baseline: nearer to the epipole an epipolar plane is not determined
MIN_CORNERS = 4
MIN_CORNERS_FOR_LENGTH = 6


@dataclass(frozen=True, slots=True, eq=False)
class LeftOutErrors:
    """Row errors of the corners, pixels, and the relative error of lengths in each view; NaN where not measured."""

    rows_px: Float[ndarray, "views n"]
    lengths: Float[ndarray, "views"]

    @staticmethod
    def unmeasured(n_views: int, n: int) -> LeftOutErrors:
        """Nothing was left out."""
        return LeftOutErrors(np.full((n_views, n), np.nan), np.full(n_views, np.nan))


def blocks_of(n_views: int) -> Int[ndarray, "views"]:
    """The block of each view: neighbours in the sequence are alike, so they are left out together."""
    return np.arange(n_views) * min(MAX_BLOCKS, n_views) // n_views


def left_out_errors(
    views: Detections,
    problem: BundleProblem,
    minimum: BundleMinimum,
    is_used: Bool[ndarray, "views n"],
    unit: tuple[float, float],
) -> LeftOutErrors | None:
    """Row and length errors of every view with the rig of the others; None where a block leaves the rig undetermined.

    ``is_used`` says which corners count: the same for every model. ``unit`` is the focal length, pixels, that turns angles into
    rows, and the noise of a corner coordinate, pixels, in which wild corners are capped: the same for every model, too.
    """
    block = blocks_of(views.n_views)
    rigs = [_without(problem, minimum, block == k) for k in range(block[-1] + 1)]
    if any(rig is None for rig in rigs):
        return None
    parameters = tuple(np.stack([rig.parameters[side] for rig in rigs])[block] for side in range(2))  # type: ignore[union-attr]
    R = np.stack([rig.T_right_left.R for rig in rigs])[block]  # type: ignore[union-attr]
    t = np.stack([rig.T_right_left.t for rig in rigs])[block]  # type: ignore[union-attr]
    boards = problem.camera_poses(minimum.estimate)
    rays = [
        _rays(camera.model, values, T.apply(views.object_points_m), px)
        for camera, values, T, px in zip(
            problem.cameras, parameters, boards, (views.left_px, views.right_px), strict=True
        )
    ]
    focal_px, noise_px = unit
    left = rays[0] @ R.swapaxes(-1, -2)
    rows_px = focal_px * _off_plane(left, rays[1], t)
    is_used = is_used & np.isfinite(views.left_px[..., 0]) & np.isfinite(views.right_px[..., 0])
    cap_px = CAP_SIGMA * np.sqrt(2) * noise_px
    rows_px = np.where(np.isfinite(rows_px), np.clip(rows_px, -cap_px, cap_px), cap_px)
    rows_px = np.where(is_used & (is_used.sum(axis=1) >= MIN_CORNERS)[:, None], rows_px, np.nan)
    return LeftOutErrors(rows_px, _length_errors(_meet(left, rays[1], t), views.object_points_m, is_used))


def _without(
    problem: BundleProblem, minimum: BundleMinimum, is_left_out: Bool[ndarray, "views"]
) -> BundleEstimate | None:
    """The minimum without some views, to first order; None where the others do not determine it."""
    keep = ~is_left_out
    equations = replace(
        minimum.equations,
        cameras=tuple(ViewEquations(e.gram[keep], e.r2_px2[keep], e.cost_px2[keep]) for e in minimum.equations.cameras),
    )
    estimate = replace(minimum.estimate, T_left_board=minimum.estimate.T_left_board[keep])
    step = problem.solve_step(estimate, equations, np.zeros(()))
    return problem.retract(estimate, step) if np.isfinite(step.shared).all() else None


def _rays(
    model: object,
    parameters: Float[ndarray, "views p"],
    X: Float[ndarray, "views n 3"],
    px: Float[ndarray, "views n 2"],
) -> Float[ndarray, "views n 3"]:
    """Directions of measured pixels, near the points X: one Newton step of least length from them.

    X projects within a few pixels of its corner, over which a lens is straight: the step is exact to 1e-3 px.
    """
    x, y, z = X[..., 0], X[..., 1], X[..., 2]
    unused = np.empty((*x.shape[:-1], parameters.shape[-1], 2, x.shape[-1]))
    with np.errstate(all="ignore"):
        u, v, grad_u, grad_v = model.linearize(parameters, x, y, z, unused)  # type: ignore[attr-defined]
        a, b = np.stack(grad_u, axis=-1), np.stack(grad_v, axis=-1)
        r_u, r_v = px[..., 0] - u, px[..., 1] - v
        aa, ab, bb = np.vecdot(a, a), np.vecdot(a, b), np.vecdot(b, b)
        determinant = aa * bb - ab * ab
        along_a, along_b = (bb * r_u - ab * r_v) / determinant, (aa * r_v - ab * r_u) / determinant
        d = X + along_a[..., None] * a + along_b[..., None] * b
        return d / np.linalg.norm(d, axis=-1, keepdims=True)


def _off_plane(
    left: Float[ndarray, "views n 3"], right: Float[ndarray, "views n 3"], t: Float[ndarray, "views 3"]
) -> Float[ndarray, "views n"]:
    """Sine of the angle of left rays, in the right frame, out of the plane of the baseline and the right ray."""
    baseline = t / np.linalg.norm(t, axis=-1, keepdims=True)
    normal = np.cross(baseline[:, None], right)
    length = np.linalg.norm(normal, axis=-1)
    with np.errstate(all="ignore"):
        sine = np.vecdot(normal, left) / length
    return np.where(length > MIN_SINE, sine, 0.0)


def _meet(
    left: Float[ndarray, "views n 3"], right: Float[ndarray, "views n 3"], t: Float[ndarray, "views 3"]
) -> Float[ndarray, "views n 3"]:
    """Middle of the shortest segment between the rays, right frame."""
    centre = t[:, None]
    cosine = np.vecdot(left, right)
    along_left, along_right = np.vecdot(left, centre), np.vecdot(right, centre)
    with np.errstate(all="ignore"):
        sine2 = 1 - cosine**2
        a = (cosine * along_right - along_left) / sine2
        b = (along_right - cosine * along_left) / sine2
    return 0.5 * (centre + a[..., None] * left + b[..., None] * right)


def _length_errors(
    points: Float[ndarray, "views n 3"], board: Float[ndarray, "n 3"], is_used: Bool[ndarray, "views n"]
) -> Float[ndarray, "views"]:
    """Scale of the similarity from the board to the measured points, minus one (Umeyama 1991, eqs 40-42); NaN for few points."""
    is_used = is_used & np.isfinite(points).all(axis=-1)
    n = is_used.sum(axis=1)
    weight = is_used[..., None] / np.maximum(n, 1)[:, None, None]
    measured = np.where(is_used[..., None], points, 0.0)
    a = board - np.sum(weight * board, axis=1, keepdims=True)
    b = measured - np.sum(weight * measured, axis=1, keepdims=True)
    M = (weight * b).swapaxes(-1, -2) @ a
    spread = np.sum(weight * a * a, axis=(1, 2))
    with np.errstate(all="ignore"):
        scale = np.sum(so3.project_to_rotation(M) * M, axis=(1, 2)) / spread
    return np.where(n >= MIN_CORNERS_FOR_LENGTH, scale - 1, np.nan)
