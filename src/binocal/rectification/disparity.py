"""Disparity of rectified pairs: the range to search, the matching, and the points that disparities stand for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy import ndarray

from binocal.cameras.epipolar_projection import EpipolarProjection
from binocal.cameras.rectified_pair import Rectification
from binocal.rectification.maps import RectificationMaps
from binocal.shapes import Bool, Float, Float32, UInt8

Matcher: TypeAlias = Callable[[ndarray, ndarray, tuple[int, int]], ndarray]
"""Disparity, left minus right, pixels, of every pixel of the left image, NaN where there is none: takes both grey images, whose matching
points share rows, and the range (least, most) of whole pixels to search."""

NEAR_SHARE = 0.2  # of the width: the disparities that are searched where no range is given
MARGIN_PX = 3  # a block of five pixels, and one for the blend of black into the border
ROUNDING_PX = 1e-6
PIXELS_IN_RANGE = 64  # places along a row at which a curved projection's range is looked at


@dataclass(frozen=True, slots=True)
class DepthRange:
    """The nearest and the farthest distance that is of interest, metres (board pitches without a scale); infinity is one."""

    near: float
    far: float

    def __post_init__(self) -> None:
        if not 0 < self.near < self.far:
            raise ValueError(f"a range is from near to far, both positive; got {self.near:g} to {self.far:g}")


def usual_range(rectification: Rectification) -> DepthRange:
    """What to search where nobody says: disparities from 0, at infinity, to a fifth of the image's width.

    Of cameras that converge, so much to either side of the distance at which the middles of both images meet.
    """
    r = rectification
    a = r.left.along
    middle = (np.array(r.size_wh) - 1) / 2
    nearer = -np.sign(r.offset_m) * NEAR_SHARE * r.size_wh[a]
    ray = r.left.unproject(middle)

    def distance(disparity_px: float) -> float:
        other = middle.copy()
        other[a] -= disparity_px
        with np.errstate(all="ignore"):
            scale = r.offset_m / (r.right.unproject(other)[a] - ray[a])
        if not (np.isfinite(scale) and scale > 0):
            return np.inf
        return float(scale if r.projection == "pinhole" else scale * np.linalg.norm(ray))

    near, far = distance(nearer), np.inf if r.infinity_px == 0 else distance(-nearer)
    return DepthRange(near, far) if near < far else DepthRange(abs(r.offset_m), np.inf)  # they diverge


def disparity_range(rectification: Rectification, distances: DepthRange) -> tuple[int, int]:
    """The least and the most disparity of points within these distances, whole pixels.

    Distance is z of the rectified frame for a pinhole, else that from the left camera. Never more than the image is long.
    """
    r = rectification
    a = r.left.along
    length = r.size_wh[a]
    pixels = np.tile((np.array(r.size_wh) - 1) / 2, (PIXELS_IN_RANGE, 1))
    pixels[:, a] = np.linspace(0, length - 1, PIXELS_IN_RANGE)
    rays = r.left.unproject(pixels)
    rays = rays[np.isfinite(rays).all(axis=1)]
    found = []
    for distance in (distances.near, distances.far):
        size = 1.0 if r.projection == "pinhole" else np.linalg.norm(rays, axis=1)
        moved = rays.copy()
        moved[:, a] += r.offset_m * size / distance
        found.append(r.left.project(rays)[:, a] - r.right.project(moved)[:, a])
    least, most = np.floor(np.min(found) + ROUNDING_PX), np.ceil(np.max(found) - ROUNDING_PX)
    return int(np.clip(least, -length, length - 1)), int(np.clip(most, 1 - length, length))


def match_rectified(
    rectification: Rectification,
    left: UInt8[ndarray, "h w"],
    right: UInt8[ndarray, "h w"],
    distances: DepthRange,
    matcher: Matcher | None = None,
) -> Float32[ndarray, "h w"]:
    """Disparity of every pixel of the rectified left image, NaN where there is none or it lies outside the range.

    By OpenCV's semi-global matching, or any other ``matcher``. It is shown rows: of a vertical rig, the images are turned over their
    diagonal.

    Raises:
        ValueError: The matcher's result has another shape than the images.
    """
    least, most = disparity_range(rectification, distances)
    match = match_semi_global if matcher is None else matcher
    pair = [np.ascontiguousarray(image.T) if rectification.is_vertical else image for image in (left, right)]
    disparity = np.array(match(pair[0], pair[1], (least, most)), dtype=np.float32)
    if disparity.shape != pair[0].shape:
        raise ValueError(f"the matcher returned {disparity.shape}, the left image is {pair[0].shape}")
    with np.errstate(invalid="ignore"):
        disparity[(disparity < least) | (disparity > most)] = np.nan
    return np.ascontiguousarray(disparity.T) if rectification.is_vertical else disparity


def without_uncovered(
    rectification: Rectification,
    maps: RectificationMaps,
    disparity_px: Float32[ndarray, "h w"],
) -> Float32[ndarray, "h w"]:
    """Disparities without those of pixels that either camera does not see: black there matches black.

    Pixels within ``MARGIN_PX`` of the black are left out too: a matcher's window reaches that far.
    """
    left, right = (_well_inside(planes[0] > -1) for planes in (maps.left, maps.right))
    height, width = disparity_px.shape
    rows, columns = np.mgrid[0:height, 0:width]
    moved = (rows if rectification.is_vertical else columns) - disparity_px
    known = np.isfinite(moved)
    moved = np.where(known, moved, 0)
    length = height if rectification.is_vertical else width
    place = np.clip(np.round(moved), 0, length - 1).astype(int)
    seen = right[place, columns] if rectification.is_vertical else right[rows, place]
    is_kept = known & left & seen & (moved > -1) & (moved < length)
    return np.where(is_kept, disparity_px, np.float32(np.nan))


def match_semi_global(
    left: UInt8[ndarray, "h w"], right: UInt8[ndarray, "h w"], search: tuple[int, int]
) -> Float32[ndarray, "h w"]:
    """Semi-global block matching of OpenCV, with its check from right to left and its speckle filter.

    Source: Hirschmüller 2008, "Stereo processing by semiglobal matching and mutual information", in OpenCV's three-way variant.
    Deviation: both images are extended, so that pixels near the border are searched too.
    """
    import cv2

    least, most = search
    count = 16 * int(np.ceil((most - least + 1) / 16))
    before, after = max(least + count, 0), max(-least, 0)
    block = 5
    matcher = cv2.StereoSGBM.create(
        minDisparity=least, numDisparities=count, blockSize=block, P1=8 * block**2, P2=32 * block**2, disp12MaxDiff=1,
        preFilterCap=63, uniquenessRatio=10, speckleWindowSize=100, speckleRange=2, mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )  # fmt: skip
    wide = [cv2.copyMakeBorder(image, 0, 0, before, after, cv2.BORDER_REPLICATE) for image in (left, right)]
    fixed = matcher.compute(wide[0], wide[1])[:, before : before + left.shape[1]]
    return np.where(fixed < 16 * least, np.float32(np.nan), fixed.astype(np.float32) / 16)


def points_from_disparity(
    rectification: Rectification, disparity_px: Float[ndarray, "h w"] | Float32[ndarray, "h w"]
) -> Float32[ndarray, "h w 3"]:
    """Points of the frame ``rect_left``, metres, of every pixel; NaN where there is no disparity or it is of no point ahead.

    For every projection: the ray of the left pixel is followed to where the right camera sees it on the other ray's half plane.
    """
    r = rectification
    a = r.left.along
    rows, columns = r.left.pixel_rays(r.size_wh)
    along = rows[:, None, a] + columns[None, :, a]
    index = np.arange(r.size_wh[a], dtype=float)
    place = (index[:, None] if r.is_vertical else index[None, :]) - disparity_px
    other = _along_of(r.right, place)
    with np.errstate(all="ignore"):
        scale = r.offset_m / (other - along)
        scale = np.where(np.isfinite(scale) & (scale > 0), scale, np.nan)
        points = (rows[:, None] + columns[None]) * scale[..., None]
    return points.astype(np.float32)


def distances_of(rectification: Rectification, points: Float32[ndarray, "h w 3"]) -> Float32[ndarray, "h w"]:
    """What a depth image holds: z of the rectified frame for a pinhole, the distance from the left camera for the others."""
    return points[..., 2] if rectification.projection == "pinhole" else np.linalg.norm(points, axis=-1)


def distance_per_pixel(rectification: Rectification, points: Float32[ndarray, "h w 3"]) -> Float32[ndarray, "h w"]:
    """By how much the distance of a point changes with a pixel of disparity, metres per pixel."""
    r = rectification
    a = r.left.along
    across = points[..., 2] if r.projection == "pinhole" else np.hypot(points[..., 1 - a], points[..., 2])
    with np.errstate(all="ignore"):
        slope = np.float32(1.0 / r.right.focal_px[a])
        if r.projection == "equirectangular":  # the coordinate is the angle whose tangent gives the depth
            slope = slope * (1 + ((points[..., a] + np.float32(r.offset_m)) / across) ** 2)
        return (distances_of(r, points) * across / np.float32(abs(r.offset_m)) * slope).astype(np.float32)


def _well_inside(is_covered: Bool[ndarray, "h w"]) -> Bool[ndarray, "h w"]:
    """Covered pixels whose neighbours at ``MARGIN_PX`` to all sides are covered too; the image's own border does not count."""
    padded = np.pad(is_covered, MARGIN_PX, mode="edge")
    height, width = is_covered.shape
    inside = is_covered.copy()
    for row in (0, MARGIN_PX, 2 * MARGIN_PX):
        for column in (0, MARGIN_PX, 2 * MARGIN_PX):
            inside &= padded[row : row + height, column : column + width]
    return inside


def _along_of(projection: EpipolarProjection, places_px: Float[ndarray, "h w"]) -> Float[ndarray, "h w"]:
    """The component along the baseline of the rays of pixels in the projection, where z (pinhole) or rho (the others) is 1."""
    u = (places_px - projection.centre_px[projection.along]) / projection.focal_px[projection.along]
    if projection.kind != "equirectangular":
        return u
    return np.where(np.abs(u) < np.pi / 2, np.tan(u), np.nan)
