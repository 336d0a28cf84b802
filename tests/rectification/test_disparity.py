from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from binocal.cameras.epipolar_projection import PROJECTIONS
from binocal.geometry import SE3, so3
from binocal.rectification import RectificationMaps, rectify
from binocal.rectification.disparity import (
    DepthRange,
    disparity_range,
    distance_per_pixel,
    distances_of,
    match_rectified,
    points_from_disparity,
    usual_range,
    without_uncovered,
)
from textured_planes import render_plane, small_rig

SETUPS = {
    "horizontal": small_rig(),
    "vertical": small_rig(t=(0.0005, -0.06, 0.001)),
    "swapped": small_rig(t=(0.06, 0.0005, 0.001)),
    "vertical and swapped": small_rig(t=(0.0005, 0.06, 0.001)),
    "right upside down": small_rig(turn_deg=180),
    "fisheye": small_rig("fisheye4"),
    "fisheye, vertical": small_rig("fisheye4", t=(0.0005, -0.06, 0.001)),
}
CONVERGING = replace(
    small_rig(), T_right_left=SE3(so3.exp(np.array([0.0, 1.1, 0.0])), np.array([-0.45, 0.0, 0.28]))
)  # by 63 deg, each image with a centre of its own


def rays_of(r):
    rows, columns = r.left.pixel_rays(r.size_wh)
    return rows[:, None] + columns


@pytest.mark.parametrize("projection", PROJECTIONS)
@pytest.mark.parametrize("name", [*SETUPS, "converging"])
def test_points_come_back_from_their_exact_disparities(name, projection):
    rig = SETUPS.get(name, CONVERGING)
    r = rectify(rig, projection=projection, size_wh=(80, 60))
    points = rays_of(r) * np.random.default_rng(0).uniform(0.3, 4, (60, 80, 1))
    in_right = points.copy()
    in_right[..., r.left.along] += r.offset_m
    disparity = (r.left.project(points) - r.right.project(in_right))[..., r.left.along]
    found = points_from_disparity(r, disparity)
    np.testing.assert_allclose(found, points, rtol=1e-5, atol=1e-6)

    distance = distances_of(r, found)
    step = 1e-3
    nearer, farther = (distances_of(r, points_from_disparity(r, disparity + s)) for s in (step, -step))
    np.testing.assert_allclose(distance_per_pixel(r, found), np.abs(farther - nearer) / (2 * step), rtol=0.02)
    if projection == "pinhole":
        x, y = np.meshgrid(np.arange(80.0), np.arange(60.0))
        homogeneous = np.stack([x, y, disparity, np.ones_like(x)], axis=-1) @ r.Q.T
        np.testing.assert_allclose(homogeneous[..., :3] / homogeneous[..., 3:], points, rtol=1e-9, atol=1e-9)
    least, most = disparity_range(r, DepthRange(float(distance.min()), float(distance.max())))
    middle = disparity[30] if r.left.along == 0 else disparity[:, 40]
    assert np.all((middle >= least - 1e-6) & (middle <= most + 1e-6))


@pytest.mark.parametrize("name", SETUPS)
def test_the_depth_of_a_plane_is_measured(name):
    """The whole path, from raw images: what is measured lies on the plane, within a fraction of a pixel of disparity."""
    rig = SETUPS[name]
    r = rectify(rig)
    maps = RectificationMaps.of(rig, r)
    left, right = maps.rectify(*render_plane(rig, 0.8))
    disparity = without_uncovered(r, maps, match_rectified(r, left, right, DepthRange(0.4, 3.0)))
    points = points_from_disparity(r, disparity)
    known = np.isfinite(points).all(axis=-1)
    # a wide lens sees past the texture's border
    assert known.mean() > (0.2 if "fisheye" in name else 0.6)  # measured: 0.28 and 0.70 at least
    in_left = points[known] @ r.R_rect_left
    off_px = (in_left[:, 2] - 0.2 * in_left[:, 0] - 0.8) / distance_per_pixel(r, points)[known]
    assert abs(np.median(off_px)) < 0.06 and np.quantile(np.abs(off_px), 0.8) < 0.5


def test_the_depth_of_converging_cameras_is_measured():
    """By 63°, of a plane across the middle of what both see; disparity at infinity is far outside of what is searched."""
    r = rectify(CONVERGING)
    distances = usual_range(r)
    ahead = r.R_rect_left[2]  # the plane ahead . X = distance, of which all points have one disparity
    middle = float(np.sqrt(distances.near * distances.far))
    images = render_plane(CONVERGING, middle / ahead[2], tilt=-ahead[0] / ahead[2])
    maps = RectificationMaps.of(CONVERGING, r)
    left, right = maps.rectify(*images)
    disparity = without_uncovered(r, maps, match_rectified(r, left, right, distances))
    points = points_from_disparity(r, disparity)
    known = np.isfinite(points).all(axis=-1)
    off_px = (points[known, 2] - middle) / distance_per_pixel(r, points)[known]
    assert known.mean() > 0.4 and abs(np.median(off_px)) < 0.1 and np.quantile(np.abs(off_px), 0.8) < 0.5


def test_black_borders_have_no_depth():
    rig = small_rig("fisheye4")
    r = rectify(rig, alpha=1.0)
    maps = RectificationMaps.of(rig, r)
    kept = without_uncovered(r, maps, np.zeros(r.size_wh[::-1], np.float32))
    seen = (maps.left[0] >= 0) & (maps.right[0] >= 0)
    assert np.isnan(kept[~seen]).all() and 0.4 < np.isfinite(kept).mean() < seen.mean()


def test_any_matcher_can_stand_in():
    rig = SETUPS["vertical"]
    r = rectify(rig, projection="pinhole")
    images = tuple(np.zeros(r.size_wh[::-1], np.uint8) for _ in range(2))
    asked = []

    def match(left, right, search):
        asked.append((left.shape, search))
        return np.full(left.shape, 12.0)

    found = match_rectified(r, *images, DepthRange(0.3, np.inf), match)
    assert found.shape == r.size_wh[::-1] and np.all(found == 12)
    assert asked == [(r.size_wh, disparity_range(r, DepthRange(0.3, np.inf)))]  # rows: turned over the diagonal
    assert np.isnan(match_rectified(r, *images, DepthRange(2.0, 3.0), match)).all()  # outside of what was asked for
    with pytest.raises(ValueError, match="the matcher returned"):
        match_rectified(r, *images, DepthRange(0.3, 3.0), lambda left, right, search: left[:5])


def test_the_usual_range_is_a_fifth_of_the_width():
    r = rectify(SETUPS["horizontal"])
    distances = usual_range(r)
    assert np.isinf(distances.far) and disparity_range(r, distances) == (0, r.size_wh[0] // 5)
    r = rectify(CONVERGING)
    distances = usual_range(r)
    assert r.infinity_px != 0 and 0 < distances.near < 0.5 < distances.far < 1
    with pytest.raises(ValueError, match="from near to far"):
        DepthRange(2.0, 1.0)
