"""Stereo rectification: rotations that make matching points share a row, new projections, maps, disparity and depth.

Frames ``rect_left`` and ``rect_right`` have the same axes; the baseline lies along x (or along y, for a rig whose
cameras stand one above the other: matching points then share a column, and disparity runs down the columns).
"""

from __future__ import annotations

from typing import Literal

from binocal.cameras import StereoRig
from binocal.cameras.epipolar_projection import PROJECTIONS, EpipolarProjection, ProjectionKind
from binocal.cameras.rectified_pair import Projection, Rectification, rectify_at_camera_scale
from binocal.rectification.disparity import (
    DepthRange,
    Matcher,
    disparity_range,
    distance_per_pixel,
    distances_of,
    match_rectified,
    match_semi_global,
    points_from_disparity,
    usual_range,
    without_uncovered,
)
from binocal.rectification.maps import RectificationMaps, rectification_map, rectified_rig, rectify_points

__all__ = [
    "PROJECTIONS",
    "DepthRange",
    "EpipolarProjection",
    "Matcher",
    "Projection",
    "ProjectionKind",
    "Rectification",
    "RectificationMaps",
    "disparity_range",
    "distance_per_pixel",
    "distances_of",
    "match_rectified",
    "match_semi_global",
    "points_from_disparity",
    "rectification_map",
    "rectified_rig",
    "rectify",
    "rectify_points",
    "row_rectification",
    "usual_range",
    "without_uncovered",
]


def rectify(
    rig: StereoRig,
    *,
    size_wh: tuple[int, int] | None = None,
    alpha: float | None = None,
    projection: Literal["auto"] | ProjectionKind = "auto",
) -> Rectification:
    """Rectification of a rig, for every camera model: :meth:`binocal.StereoRig.rectify`, which says what the options mean."""
    return rig.rectify(size_wh=size_wh, alpha=alpha, projection=projection)


def row_rectification(rig: StereoRig) -> Rectification:
    """The projection at the cameras' own scale, for row errors of points: :func:`binocal.cameras.rectified_pair.rectify_at_camera_scale`."""
    return rectify_at_camera_scale(rig.left, rig.right, rig.T_right_left)
