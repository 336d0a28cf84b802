"""Criteria that need no truth: pixel error (eq. 19), rectified row error, and the error of measured lengths.

All take board corners that both cameras saw, best of views that the calibration did not use. NaN marks a corner that
was not seen; a corner that cannot be measured (no ray, behind a camera) is left out and counted, never replaced.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.cameras import Camera, StereoRig, camera_model
from binocal.evidence import Detections
from binocal.geometry import SE3, so3
from binocal.rectification import rectify_points, row_rectification
from binocal.shapes import Bool, Float, Int

MIN_CORNERS_FOR_SCALE = 4  # a similarity of the plane has 4 unknowns; 4 corners leave as many again to spare
MOST_UNLIKE_SIDE = 0.04  # of the side: a ruler may find a print some percent longer in one direction than in the other
REFINEMENT_STEPS = 5  # quadratic convergence from the mid-point: the third step is below 1e-12 m on the table-2 rig


@dataclass(frozen=True, slots=True, eq=False)
class PixelError:
    """Distances between measured and computed pixels, RMS over corners (eq. 19), pixels.

    ``view_rms_px`` has one value per view, both cameras together, NaN where the view has no corner.
    """

    left_px: float
    right_px: float
    all_px: float
    view_rms_px: Float[ndarray, "views"]
    n_corners: int


@dataclass(frozen=True, slots=True, eq=False)
class RowError:
    """How far matching points miss each other's row (column, if the rig is vertical) once rectified, pixels.

    ``median_px`` is signed: it shows a common shift.
    """

    rms_px: float
    median_px: float
    view_rms_px: Float[ndarray, "views"]
    n_corners: int


@dataclass(frozen=True, slots=True, eq=False)
class LengthError:
    """Relative error of measured lengths (table 3), percent: measured over true, minus one.

    ``scale_rms_percent`` is what calibration contributes: the board's scale in each view, RMS over views.
    ``side_rms_percent`` is the error of one single side between neighbouring corners, RMS over all of them: it is
    dominated by the noise of its two corners.
    """

    scale_rms_percent: float
    scale_mean_percent: float
    view_scale_percent: Float[ndarray, "views"]
    n_views: int
    side_rms_percent: float
    n_sides: int


def triangulate(
    rig: StereoRig, left_px: Float[ndarray, "*batch 2"], right_px: Float[ndarray, "*batch 2"]
) -> tuple[Float[ndarray, "*batch 3"], Bool[ndarray, "*batch"]]:
    """Points in the left frame, metres, that minimise the squared distances to both measured pixels; and which exist.

    The maximum-likelihood point for equal, independent Gaussian noise in both images: mid-point of the two rays, then
    Gauss-Newton on the four pixel residuals through the full camera models, each step kept only where it lowers the
    cost. A point is invalid (NaN) where a pixel is NaN or has no ray, the rays are parallel within 1e-9, or they meet
    behind a camera. Source: Hartley & Sturm 1997, "Triangulation"; the iterative form, because lenses distort.
    """
    left_px, right_px = np.asarray(left_px, dtype=float), np.asarray(right_px, dtype=float)
    if left_px.shape != right_px.shape or left_px.shape[-1:] != (2,):
        raise ValueError(f"left and right pixels must both be (..., 2); got {left_px.shape} and {right_px.shape}")
    shape = left_px.shape[:-1]
    measured_left, measured_right = left_px.reshape(-1, 2), right_px.reshape(-1, 2)
    points, is_valid = _midpoint(rig, rig.left.unproject(measured_left), rig.right.unproject(measured_right))
    X = points[is_valid]
    measured = np.concatenate([measured_left[is_valid], measured_right[is_valid]], axis=-1)
    if len(X):
        predicted, J = _linearize_pair(rig, X)
        residual = measured - predicted
        cost = np.sum(residual**2, axis=-1)
        for _ in range(REFINEMENT_STEPS):
            normal = np.einsum("nij,nik->njk", J, J)
            gradient = np.einsum("nij,ni->nj", J, residual)
            trial = X + np.linalg.solve(normal, gradient[..., None])[..., 0]
            trial_predicted, trial_J = _linearize_pair(rig, trial)
            trial_residual = measured - trial_predicted
            trial_cost = np.sum(trial_residual**2, axis=-1)
            is_better = (trial_cost < cost) & _is_in_front(rig, trial)
            if not is_better.any():
                break
            X = np.where(is_better[:, None], trial, X)
            residual = np.where(is_better[:, None], trial_residual, residual)
            J = np.where(is_better[:, None, None], trial_J, J)
            cost = np.where(is_better, trial_cost, cost)
        points[is_valid] = X
    return points.reshape(*shape, 3), is_valid.reshape(shape)


def pixel_error(rig: StereoRig, detections: Detections, T_left_board: SE3) -> PixelError:
    """RMS distance, pixels, between measured corners and those computed from the board's poses (eq. 19).

    ``T_left_board`` has one pose per view; pose and corners of the same view share noise, so the figure is a little low
    (6 of 4n numbers per view are fitted).
    """
    if T_left_board.t.shape != (detections.n_views, 3):
        raise ValueError(f"{detections.n_views} views for board poses of shape {T_left_board.t.shape}")
    in_left = T_left_board.apply(detections.object_points_m)
    left2 = _squared_distance(rig.left.project(in_left), detections.left_px)
    right2 = _squared_distance(rig.right.project(rig.T_right_left.apply(in_left)), detections.right_px)
    both2 = np.concatenate([left2, right2], axis=1)
    return PixelError(_rms(left2), _rms(right2), _rms(both2), _rms_by_view(both2), int(np.isfinite(both2).sum()))


def rectified_row_error(rig: StereoRig, detections: Detections) -> RowError:
    """RMS distance, pixels of the rectified images, between the rows on which matching corners lie.

    No board, pose or triangulation enters: only rotation, direction of the baseline and lenses.

    Raises:
        DegenerateGeometryError: The rig cannot be rectified.
    """
    difference = row_differences(rig, detections)
    seen = difference[np.isfinite(difference)]
    median_px = float(np.median(seen)) if seen.size else np.nan
    return RowError(_rms(difference**2), median_px, _rms_by_view(difference**2), int(seen.size))


def row_differences(rig: StereoRig, detections: Detections) -> Float[ndarray, "views n"]:
    """Left less right row of the rectified corners (column, if the rig is vertical), pixels; NaN unless both cameras saw it.

    Raises:
        DegenerateGeometryError: The rig cannot be rectified.
    """
    rectification = row_rectification(rig)
    left = rectify_points(rig.left, rectification.R_rect_left, rectification.P_left, detections.left_px)
    right = rectify_points(rig.right, rectification.R_rect_right, rectification.P_right, detections.right_px)
    return (left - right)[..., 0 if rectification.is_vertical else 1]


def length_error(rig: StereoRig, detections: Detections, *, side_m: float | None = None) -> LengthError:
    """Error of lengths that the rig measures on a board, percent (PAPER table 3).

    Each view's corners are triangulated; a similarity is fitted from the known board to them; its scale minus one is
    the view's error. Views with fewer than 4 measured corners or with corners in one line are left out (NaN).
    ``side_m`` is the side for the single-side figure; the least distance between two board points unless given.
    """
    points, is_valid = triangulate(rig, detections.left_px, detections.right_px)
    scale = np.full(detections.n_views, np.nan)
    for view in range(detections.n_views):
        chosen = is_valid[view]
        if chosen.sum() >= MIN_CORNERS_FOR_SCALE:
            scale[view] = similarity_scale(detections.object_points_m[chosen], points[view, chosen])
    scale_percent = 100 * (scale - 1)
    measured = scale_percent[np.isfinite(scale_percent)]
    sides, true_m = board_sides(detections.object_points_m, side_m)
    length_m = np.linalg.norm(points[:, sides[:, 0]] - points[:, sides[:, 1]], axis=-1)
    side_percent = 100 * (length_m / true_m - 1)
    return LengthError(
        scale_rms_percent=_rms(measured**2),
        scale_mean_percent=float(measured.mean()) if measured.size else np.nan,
        view_scale_percent=scale_percent,
        n_views=int(measured.size),
        side_rms_percent=_rms(side_percent**2),
        n_sides=int(np.isfinite(side_percent).sum()),
    )


def similarity_scale(source: Float[ndarray, "n 3"], measured: Float[ndarray, "n 3"]) -> float:
    """Scale s of the least-squares similarity ``measured ≈ s R source + t``; NaN where the points lie in one line.

    Source: Umeyama 1991, eqs 40-42; noise is taken to be in ``measured`` alone.
    """
    a, b = source - source.mean(axis=0), measured - measured.mean(axis=0)
    spread = np.linalg.svd(a, compute_uv=False)
    if spread[1] < 1e-6 * spread[0]:
        return float("nan")
    M = b.T @ a
    return float(np.sum(so3.project_to_rotation(M) * M) / np.sum(a * a))


def board_sides(
    object_points_m: Float[ndarray, "n 3"], side_m: float | None = None
) -> tuple[Int[ndarray, "s 2"], Float[ndarray, "s"]]:
    """Pairs of board points ``side_m`` (default: the least distance) apart within 4 %, and their exact distances."""
    distance_m = np.linalg.norm(object_points_m[:, None] - object_points_m[None], axis=-1)
    upper = np.triu_indices(len(object_points_m), 1)
    d = distance_m[upper]
    side_m = float(d.min()) if side_m is None else side_m
    chosen = np.abs(d - side_m) < MOST_UNLIKE_SIDE * side_m
    return np.stack([upper[0][chosen], upper[1][chosen]], axis=-1), d[chosen]


def _midpoint(
    rig: StereoRig, rays_left: Float[ndarray, "n 3"], rays_right: Float[ndarray, "n 3"]
) -> tuple[Float[ndarray, "n 3"], Bool[ndarray, "n"]]:
    """Middle of the shortest segment between unit rays, left frame; valid where both ray lengths are positive."""
    T_left_right = rig.T_right_left.inverse()
    d_left, d_right, centre = rays_left, rays_right @ T_left_right.R.T, T_left_right.t
    cosine = np.sum(d_left * d_right, axis=-1)
    sine2 = np.sum(np.cross(d_left, d_right) ** 2, axis=-1)
    with np.errstate(all="ignore"):
        along_left = (d_left @ centre - cosine * (d_right @ centre)) / sine2
        along_right = (cosine * (d_left @ centre) - d_right @ centre) / sine2
        is_valid = (sine2 > 1e-18) & (along_left > 0) & (along_right > 0)
    points = (along_left[:, None] * d_left + centre + along_right[:, None] * d_right) / 2
    is_valid[is_valid] &= _is_in_front(rig, points[is_valid])
    points[~is_valid] = np.nan
    return points, is_valid


def _is_in_front(rig: StereoRig, points: Float[ndarray, "n 3"]) -> Bool[ndarray, "n"]:
    """Where both camera models can see a point (a fisheye sees behind its image plane)."""
    left_sees = camera_model(rig.left.model).sees_behind | (points[:, 2] > 0)
    return left_sees & (camera_model(rig.right.model).sees_behind | (rig.T_right_left.apply(points)[:, 2] > 0))


def _linearize_pair(rig: StereoRig, X: Float[ndarray, "n 3"]) -> tuple[Float[ndarray, "n 4"], Float[ndarray, "n 4 3"]]:
    """Pixels (left u v, right u v) of points in the left frame, and their gradients by the point."""
    left_px, left_J = _linearize(rig.left, X)
    right_px, right_J = _linearize(rig.right, rig.T_right_left.apply(X))
    return np.concatenate([left_px, right_px], axis=-1), np.concatenate([left_J, right_J @ rig.T_right_left.R], axis=-2)


def _linearize(camera: Camera, X: Float[ndarray, "n 3"]) -> tuple[Float[ndarray, "n 2"], Float[ndarray, "n 2 3"]]:
    model = camera_model(camera.model)
    unused = np.empty((model.n_parameters, 2, len(X)))
    with np.errstate(all="ignore"):  # a trial point may leave the half-space; its step is then refused
        u, v, grad_u, grad_v = model.linearize(camera.parameters, X[:, 0], X[:, 1], X[:, 2], unused)
    return np.stack([u, v], axis=-1), np.stack([np.stack(grad_u, axis=-1), np.stack(grad_v, axis=-1)], axis=-2)


def _squared_distance(predicted: ndarray, measured: ndarray) -> ndarray:
    return np.sum((measured - predicted) ** 2, axis=-1)


def _rms(squares: ndarray) -> float:
    finite = squares[np.isfinite(squares)]
    return float(np.sqrt(finite.mean())) if finite.size else float("nan")


def _rms_by_view(squares: Float[ndarray, "views n"]) -> Float[ndarray, "views"]:
    return np.array([_rms(row) for row in squares])
