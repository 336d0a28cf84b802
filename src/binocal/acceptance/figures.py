"""What the checks look at: figures of a solved rig, its views and its corners."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.evidence import Detections
from binocal.result import StereoCalibration
from binocal.shapes import Float, Int

MAX_SPACING_VIEWS = 12  # evenly chosen; the median spacing of eight real sets is then within 2.5 % of all views'

MAX_SPACING_POINTS = 2000  # of the board, evenly chosen; their median is that of all
SPACING_BLOCK = 1 << 21  # distances held at once: 16 MB


def focal_sigma_share(calibration: StereoCalibration, side: str) -> float:
    """The larger relative standard deviation of a camera's two focal lengths; 0 where they are held."""
    sigma = calibration.covariance.sigma
    fx, fy = getattr(calibration.rig, side).parameters[:2]
    return max(sigma.get(f"{side}.fx", 0.0) / fx, sigma.get(f"{side}.fy", 0.0) / fy)


def common_factor(calibration: StereoCalibration) -> float:
    """By what the standard deviations exceed those of independent corner noise: what views have in common, 1 where not known."""
    found = calibration.provenance.get("views_in_common", {})
    return max(float(found.get("sigma_factor", 1.0)), 1.0)


def translation_sigma(calibration: StereoCalibration) -> float:
    """Standard deviation of the translation, all three axes together; 0 where it is held."""
    sigma = calibration.covariance.sigma
    return float(np.sqrt(sum(sigma.get(f"translation.{axis}", 0.0) ** 2 for axis in "xyz")))


def board_normals(calibration: StereoCalibration) -> Float[ndarray, "views 3"]:
    """The board's direction in the left frame, one per used view; empty without evidence."""
    return calibration.evidence.T_left_board.R[:, :, 2] if calibration.evidence else np.empty((0, 3))


def normal_spread_deg(normals: Float[ndarray, "views 3"]) -> float:
    """RMS angle between the directions and their mean."""
    unit = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    mean = unit.sum(axis=0)
    mean /= np.linalg.norm(mean)
    chords = np.minimum(np.linalg.norm(unit - mean, axis=1), 2.0)
    return float(np.degrees(np.sqrt(np.mean((2 * np.arcsin(chords / 2)) ** 2))))


def corner_spacing_px(detections: Detections, most_views: int = MAX_SPACING_VIEWS) -> float:
    """Median distance in the images of corners that are neighbours on the board; NaN where none are seen."""
    some_points, nearest = _neighbours(detections.object_points_m)
    n_some = min(detections.n_views, most_views)
    some = np.arange(n_some) * (detections.n_views - 1) // max(n_some - 1, 1)
    px = np.concatenate([detections.left_px[some], detections.right_px[some]])
    steps = px[:, nearest] - px[:, some_points]
    gaps2 = np.vecdot(steps, steps).ravel()
    gaps2 = gaps2[np.isfinite(gaps2)]
    return float(np.sqrt(np.partition(gaps2, len(gaps2) // 2)[len(gaps2) // 2])) if len(gaps2) else float("nan")


def _neighbours(points: Float[ndarray, "n 3"]) -> tuple[Int[ndarray, "k"], Int[ndarray, "k"]]:
    """Evenly chosen points of a board, all of them where they are few, and the nearest other point of each."""
    n_some = min(len(points), MAX_SPACING_POINTS)
    some = np.arange(n_some) * (len(points) - 1) // max(n_some - 1, 1)
    half = 0.5 * np.square(points).sum(axis=1)
    nearest = np.empty(n_some, dtype=int)
    rows = max(1, SPACING_BLOCK // len(points))
    for begin in range(0, n_some, rows):
        block = some[begin : begin + rows]
        distance2 = half - points[block] @ points.T  # half of it, short of a constant for each row
        distance2[np.arange(len(block)), block] = np.inf
        nearest[begin : begin + rows] = np.argmin(distance2, axis=1)
    return some, nearest
