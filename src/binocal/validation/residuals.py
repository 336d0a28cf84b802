"""Residuals of a calibration's corners, and whether they are white: whether neighbours on the board err alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.evidence import Detections
from binocal.evidence.pixel_locking import RigLocking
from binocal.result import StereoCalibration
from binocal.shapes import Float

SMOOTHED_WH = 17, 13  # places over an image at which residuals are averaged
LEAST_WEIGHT = 3.0  # corners that a place's mean is of, to be stated
NEAR = 1.3  # times the least distance of two board points: neighbours along rows and columns


@dataclass(frozen=True, slots=True, eq=False)
class Whiteness:
    """How far errors of neighbouring corners of one image are alike.

    ``correlation`` is that of their residuals, 0 of independent corners; ``sigma`` its standard deviation then. ``common_px`` is what
    neighbours have in common, one standard deviation of a coordinate. ``by_point_px`` is the mean residual of every board point over
    all views (left x, y, right x, y); ``by_view_px`` that of every view.
    """

    correlation: float
    sigma: float
    common_px: float
    by_point_px: Float[ndarray, "n 4"]
    by_view_px: Float[ndarray, "views 4"]


def solved_detections(calibration: StereoCalibration) -> Detections:
    """The corners as the solve took them: without their locking to the pixels, where some was found."""
    detections = calibration.corners.detections
    found = calibration.provenance.get("pixel_locking")
    return RigLocking.of_document(found).corrected(detections) if found else detections


def corner_residuals(
    calibration: StereoCalibration,
) -> tuple[Float[ndarray, "views n 2"], Float[ndarray, "views n 2"]]:
    """Measured less predicted corners of both cameras, pixels; NaN where not seen or left out as an outlier.

    Raises:
        DataError: The calibration holds no corners.
    """
    evidence, rig = calibration.corners, calibration.rig
    detections = solved_detections(calibration)
    in_left = evidence.T_left_board.apply(evidence.board_points_m)
    own = evidence.T_right_board
    in_right = rig.T_right_left.apply(in_left) if own is None else own.apply(evidence.board_points_m)
    left, right = detections.left_px - rig.left.project(in_left), detections.right_px - rig.right.project(in_right)
    for index, view in enumerate(calibration.views):
        for outlier in view.outliers:
            (left if outlier.camera == "left" else right)[index, outlier.corner] = np.nan
    return left, right


def measure_whiteness(calibration: StereoCalibration) -> Whiteness | None:
    """Correlation of neighbours' residuals over all images; None where the board has no neighbours that were seen.

    Raises:
        DataError: The calibration holds no corners.
    """
    sides = corner_residuals(calibration)
    points = calibration.corners.detections.object_points_m
    a, b = _neighbours(points)
    n_pairs, products, squares, count = 0, 0.0, 0.0, 0
    for residual in sides:
        own = residual[np.isfinite(residual[..., 0])]
        squares, count = squares + float(np.sum(own**2)), count + own.size
        both = np.isfinite(residual[:, a, 0]) & np.isfinite(residual[:, b, 0])
        products += float(np.sum(residual[:, a][both] * residual[:, b][both]))
        n_pairs += 2 * int(both.sum())
    if not n_pairs or not squares > 0:
        return None
    variance = squares / count
    correlation = products / n_pairs / variance
    with np.errstate(invalid="ignore"):
        stacked = np.concatenate(sides, axis=-1)
    return Whiteness(
        correlation,
        1 / float(np.sqrt(n_pairs)),
        float(np.sqrt(max(correlation, 0.0) * variance)),
        _mean(stacked, 0),
        _mean(stacked, 1),
    )


def _mean(values: Float[ndarray, "views n 4"], axis: int) -> Float[ndarray, "k 4"]:
    known = np.isfinite(values)
    total = np.where(known, values, 0.0).sum(axis=axis)
    return np.where(known.any(axis=axis), total / np.maximum(known.sum(axis=axis), 1), np.nan)


def _neighbours(points: Float[ndarray, "n 3"]) -> tuple[ndarray, ndarray]:
    """Pairs of neighbouring board points."""
    distance = np.linalg.norm(points[:, None] - points[None], axis=-1)
    upper = np.triu(np.ones(distance.shape, dtype=bool), 1)
    if not upper.any():
        return np.zeros(0, dtype=int), np.zeros(0, dtype=int)
    a, b = np.nonzero(upper & (distance < NEAR * distance[upper].min()))
    return a, b


@dataclass(frozen=True, slots=True, eq=False)
class SmoothedResiduals:
    """Mean residuals over an image, on a grid of places: what neighbouring corners have in common there.

    ``mean_px`` and its standard error ``sigma_px`` (one coordinate) are NaN where no corner was near.
    """

    px: Float[ndarray, "rows columns 2"]
    mean_px: Float[ndarray, "rows columns 2"]
    sigma_px: Float[ndarray, "rows columns"]


def smooth_residuals(
    px: Float[ndarray, "views n 2"],
    residuals: Float[ndarray, "views n 2"],
    size_wh: tuple[int, int],
    grid_wh: tuple[int, int] = SMOOTHED_WH,
) -> SmoothedResiduals:
    """Residuals averaged with a Gaussian weight of one grid step; a place needs the weight of :data:`LEAST_WEIGHT` corners.

    The standard error takes corners to be independent: where the mean is many of it, they are not noise.
    """
    known = np.isfinite(residuals).all(axis=-1) & np.isfinite(px).all(axis=-1)
    at, off = px[known], residuals[known]
    width, height = size_wh
    x, y = (np.linspace(0, n - 1, m) for n, m in zip(size_wh, grid_wh, strict=True))
    step = max((width - 1) / (grid_wh[0] - 1), (height - 1) / (grid_wh[1] - 1), 1e-9)
    weights = [np.exp(-0.5 * ((grid[:, None] - at[:, i]) / step) ** 2) for i, grid in enumerate((x, y))]
    total = weights[1] @ weights[0].T
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.stack([(weights[1] * off[:, i]) @ weights[0].T for i in (0, 1)], axis=-1) / total[..., None]
        squares = (weights[1] ** 2) @ (weights[0] ** 2).T
        variance = float(np.mean(off**2)) if len(off) else np.nan
        sigma = np.sqrt(squares * variance) / total
    is_near = total >= LEAST_WEIGHT
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    return SmoothedResiduals(grid, np.where(is_near[..., None], mean, np.nan), np.where(is_near, sigma, np.nan))
