"""Straight segments of an image, placed to a fraction of a pixel, with what each is uncertain by.

OpenCV's detector finds them (von Gioi et al. 2010, LSD) to about half a pixel and breaks long edges; pieces of one edge are joined.
Then the edge is measured anew every pixel along, where the grey values' slope across is greatest, and a line is fitted to these
points, with the lens taken out where it is known. The points' scatter, and how far it is alike along the edge, is the covariance.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy import ndarray

from binocal.cameras import Camera
from binocal.detection.detect import stretch_8_bit
from binocal.evidence.line_segments import LineSegments
from binocal.shapes import Bool, Float, Float32

MIN_LENGTH_SHARE, MIN_LENGTH_PX = 0.02, 15.0  # of the image's diagonal; shorter ones point nowhere
MAX_SEGMENTS = 600  # of an image, the longest
JOIN_TURN_RAD, JOIN_BESIDE_PX, JOIN_GAP_SHARE = np.radians(2.0), 1.5, 0.5
"""Two pieces are of one edge within these: turn, distance of their ends from the other's line, gap over the longer's length."""
REACH_PX = 4  # across, to both sides
SMOOTHING_PX = 0.8
MIN_SLOPE_DN = 2.0  # grey levels a pixel, of the stretched image
MIN_POINTS = 10
MAX_POINTS = 300
SCATTER_FLOOR_PX = 0.02  # no edge is placed better
LAGS = 12  # points along, over which the edge's own unevenness is alike
SAG_POINTS = 30  # fewer tell no bend


def find_line_segments(image: ndarray, name: str, camera: Camera | None = None) -> LineSegments:
    """The straight segments of a grey image (h, w), uint8 or uint16.

    With a ``camera`` its lens is taken out: pixels are then those of a pinhole camera with its fx both ways and its principal point.
    """
    grey, problem = stretch_8_bit(image)
    size = image.shape[1], image.shape[0]
    found = np.zeros((0, 4))
    if not problem:
        lines = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD).detect(np.ascontiguousarray(grey))[0]
        found = found if lines is None else np.asarray(lines, dtype=float).reshape(-1, 4)
    ends = joined_pieces(found.reshape(-1, 2, 2))
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    least = max(MIN_LENGTH_PX, MIN_LENGTH_SHARE * float(np.hypot(*size)))
    ends = ends[np.argsort(-length)[: min(MAX_SEGMENTS, int((length >= least).sum()))]]
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), SMOOTHING_PX)
    fits = [_fitted(_edge_points(smooth, *pair), camera) for pair in ends]
    kept = [fit for fit in fits if fit is not None and np.linalg.norm(fit[0][1] - fit[0][0]) >= MIN_LENGTH_PX]
    ends_px, covariance_px2, bend_per_px = (
        np.array([fit[k] for fit in kept]).reshape(-1, *shape) for k, shape in enumerate(((2, 2), (2, 2), (2,)))
    )
    return LineSegments(ends_px, covariance_px2, bend_per_px, np.zeros(len(kept), dtype=int), (name,), size)


def joined_pieces(ends_px: Float[ndarray, "n 2 2"]) -> Float[ndarray, "m 2 2"]:
    """Segments in which the pieces of an edge are one; pieces with the dark on different sides are of different edges."""
    rest = list(np.argsort(-np.linalg.norm(ends_px[:, 1] - ends_px[:, 0], axis=1)))
    out = []
    while rest:
        current = ends_px[rest.pop(0)]
        while rest:
            others = ends_px[rest]
            along = current[1] - current[0]
            length = float(np.linalg.norm(along))
            along = along / length
            theirs = others[:, 1] - others[:, 0]
            theirs_length = np.linalg.norm(theirs, axis=1)
            place, beside = (others - current[0]) @ along, (others - current[0]) @ np.array([-along[1], along[0]])
            gap = np.maximum(place.min(axis=1) - length, -place.max(axis=1))
            is_same = (
                (theirs @ along > np.cos(JOIN_TURN_RAD) * theirs_length)
                & (np.abs(beside).max(axis=1) < JOIN_BESIDE_PX)
                & (gap < JOIN_GAP_SHARE * length)
            )
            if not is_same.any():
                break
            k = int(np.argmax(is_same))
            low, high = min(0.0, place[k].min()), max(length, place[k].max())
            start, turned = current[0], along
            if high - low > length + 1e-9:  # through the outermost ends, so that the direction follows
                all_ends = np.concatenate([current, others[k]])
                order = np.argsort((all_ends - start) @ turned)
                current = all_ends[order[[0, -1]]]
            rest.pop(k)
        out.append(current)
    return np.array(out).reshape(-1, 2, 2)


def _edge_points(
    smooth: Float32[ndarray, "h w"], first: Float[ndarray, "2"], last: Float[ndarray, "2"]
) -> Float[ndarray, "m 2"]:
    """Where the slope across is greatest, about every pixel along from the first end to the last."""
    length = float(np.linalg.norm(last - first))
    along = (last - first) / length
    normal = np.array([-along[1], along[0]])
    place = np.linspace(1.0, length - 1.0, int(np.clip(length - 1, 2, MAX_POINTS)))
    across = np.arange(-REACH_PX, REACH_PX + 1, dtype=float)
    grid = first + place[:, None, None] * along + across[None, :, None] * normal
    maps = np.ascontiguousarray(grid, dtype=np.float32)
    profile = cv2.remap(smooth, maps, np.empty(0, np.float32), cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    slope = 0.5 * (profile[:, 2:] - profile[:, :-2]).astype(float)
    slope *= np.sign(np.median(slope[:, slope.shape[1] // 2])) or 1.0
    best = slope[:, 1:-1].argmax(axis=1) + 1
    rows = np.arange(len(slope))
    before, at, after = (slope[rows, best + k] for k in (-1, 0, 1))
    bow = before - 2 * at + after
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = 0.5 * (before - after) / bow
    is_edge = (at > np.maximum(MIN_SLOPE_DN, 0.3 * np.median(at))) & (bow < 0) & (np.abs(shift) <= 0.5)
    offset = across[1:-1][best] + np.where(is_edge, shift, 0.0)
    points = first + place[:, None] * along + offset[:, None] * normal
    inside = ((points >= 0) & (points <= np.array(smooth.shape[::-1]) - 1)).all(axis=1)
    return points[is_edge & inside]


def _fitted(
    points_px: Float[ndarray, "m 2"], camera: Camera | None
) -> tuple[Float[ndarray, "2 2"], Float[ndarray, "2 2"], Float[ndarray, "2"]] | None:
    """Ends of the line through edge points, covariance of their displacements, and the bend with its standard deviation."""
    if camera is not None:
        points_px = without_lens(camera, points_px)
    if len(points_px) < MIN_POINTS:
        return None
    along = points_px[-1] - points_px[0]
    if not np.linalg.norm(along) > 0:
        return None
    along = along / np.linalg.norm(along)
    normal = np.array([-along[1], along[0]])
    middle = points_px.mean(axis=0)
    x, y = (points_px - middle) @ along, (points_px - middle) @ normal
    half = max(float(np.abs(x).max()), 1.0)
    powers = np.stack([np.ones_like(x), x / half, (x / half) ** 2], axis=1)
    line, is_near = _robust_line(powers[:, :2], y)
    if is_near.sum() < MIN_POINTS:
        return None
    A, y = powers[is_near], y[is_near]
    residuals = y - A[:, :2] @ line
    alike = _alike_along(residuals)
    ends_at = np.array([[1.0, x[is_near].min() / half], [1.0, x[is_near].max() / half]])
    scatter = max(float(np.sqrt(residuals @ residuals / max(len(y) - 2, 1))), SCATTER_FLOOR_PX)
    C = ends_at @ np.linalg.inv(A[:, :2].T @ A[:, :2]) @ ends_at.T * scatter**2 * alike
    ends = middle + ends_at[:, 1:] * half * along + (ends_at @ line)[:, None] * normal
    bend = np.array([0.0, np.inf])
    if len(y) >= SAG_POINTS:
        bow = np.linalg.lstsq(A, y, rcond=None)[0]
        spread = float(np.linalg.inv(A.T @ A)[2, 2])
        left = max(float(np.std(y - A @ bow)), SCATTER_FLOOR_PX)
        bend = 2 * np.array([bow[2], np.sqrt(spread * alike) * left]) / half**2
    return ends, C, bend


def without_lens(camera: Camera, points_px: Float[ndarray, "m 2"]) -> Float[ndarray, "k 2"]:
    """Pixels as a pinhole camera with fx both ways sees them; those that it cannot see are left out."""
    rays = camera.unproject(points_px)
    rays = rays[np.isfinite(rays).all(axis=1) & (rays[:, 2] > 0.1)]
    fx, _, cx, cy = camera.parameters[:4]
    return rays[:, :2] / rays[:, 2:] * fx + np.array([cx, cy])


def _robust_line(A: Float[ndarray, "m 2"], y: Float[ndarray, "m"]) -> tuple[Float[ndarray, "2"], Bool[ndarray, "m"]]:
    """Offset and slope, and the points that they rest on."""
    is_near = np.ones(len(y), dtype=bool)
    line = np.zeros(2)
    for _ in range(4):
        line = np.linalg.lstsq(A[is_near], y[is_near], rcond=None)[0]
        away = np.abs(y - A @ line)
        near = away < 3.0 * max(1.4826 * float(np.median(away[is_near])), SCATTER_FLOOR_PX)
        if near.sum() < MIN_POINTS or np.array_equal(near, is_near):
            break
        is_near = near
    return line, is_near


def _alike_along(residuals: Float[ndarray, "m"]) -> float:
    """By how much likeness of neighbours makes the variance of a mean larger, 1 to a third of their number."""
    n = len(residuals)
    power = float(residuals @ residuals)
    if power <= 0:
        return 1.0
    lags = range(1, min(LAGS, n // 3) + 1)
    total = 1 + 2 * sum(float(residuals[k:] @ residuals[:-k]) / power for k in lags)
    return float(np.clip(total, 1.0, n / 3))
