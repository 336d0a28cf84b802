"""The canvas: what two cameras both see fills it, whichever way they stand."""

from __future__ import annotations

import numpy as np
import pytest

from binocal.benchmark.unlike_cameras import NARROW, beside, converging
from binocal.benchmark.unlike_cameras import UNLIKE_RIGS as RIGS
from binocal.cameras import Camera, StereoRig
from binocal.errors import DegenerateGeometryError
from binocal.geometry import SE3, so3
from binocal.rectification import rectification_map, rectify_points
from rigs import DISTORTION, make_rig

CURVED = {
    "converging by 100°": "equirectangular",
    "converging by 150°": "equirectangular",
    "fisheyes of 120°": "cylindrical",
    "fisheyes of 200°": "equirectangular",
    "fisheyes of 200° converging by 90°": "equirectangular",
    "fisheyes of 200°, one above the other": "equirectangular",
}


@pytest.mark.parametrize("name", RIGS)
def test_what_both_see_fills_both_images(name):
    rig = RIGS[name]
    r = rig.rectify()
    assert r.projection == CURVED.get(name, "pinhole")
    for camera, R, P, stated in (
        (rig.left, r.R_rect_left, r.P_left, r.covered[0]),
        (rig.right, r.R_rect_right, r.P_right, r.covered[1]),
    ):
        covered = rectification_map(camera, R, P, r.size_wh)[1].mean()
        assert covered > 0.8 and covered == pytest.approx(stated, abs=0.03)  # measured: 0.85 to 1.00
    assert r.kept > 0.64  # measured: 0.66 at 150 deg, 0.82 and more for all others


@pytest.mark.parametrize("name", RIGS)
def test_matching_points_share_a_row_and_the_left_image_stands_upright(name):
    rig = RIGS[name]
    r = rig.rectify()
    x, y = np.meshgrid(np.linspace(0.1, 0.9, 9), np.linspace(0.1, 0.9, 7))
    pixels = np.stack([x, y], axis=-1).reshape(-1, 2) * rig.left.size_wh
    points = rig.left.unproject(pixels) * 0.9
    right = rig.right.project(rig.T_right_left.apply(points))
    seen = rig.right.sees(rig.T_right_left.apply(points))
    left_rect = rectify_points(rig.left, r.R_rect_left, r.P_left, pixels)
    right_rect = rectify_points(rig.right, r.R_rect_right, r.P_right, right)
    known = seen & np.isfinite(left_rect).all(axis=1) & np.isfinite(right_rect).all(axis=1)
    across = 1 - r.left.along
    np.testing.assert_allclose(left_rect[known, across], right_rect[known, across], atol=1e-6)
    middle = (np.array(rig.left.size_wh) - 1) / 2
    steps = rectify_points(rig.left, r.R_rect_left, r.P_left, middle + [[0, 0], [20, 0], [0, 20]])
    assert steps[1, 0] > steps[0, 0] + 3 and steps[2, 1] > steps[0, 1] + 3  # right is right, down is down


def test_a_camera_upside_down_gives_the_rectification_of_the_upright_one():
    upright, turned = beside(NARROW, NARROW).rectify(), beside(NARROW, NARROW, 180).rectify()
    np.testing.assert_allclose(turned.R_rect_left, upright.R_rect_left, atol=1e-12)
    np.testing.assert_allclose(turned.R_rect_right, upright.R_rect_right @ np.diag([-1.0, -1, 1]), atol=1e-12)
    assert not turned.is_vertical and turned.offset_m == pytest.approx(upright.offset_m)


@pytest.mark.parametrize("name", ["parallel", "converging by 100°", "fisheyes of 200°", "right on its side"])
def test_alpha_zooms_from_valid_pixels_to_all(name):
    rig = RIGS[name]
    shown = [rig.rectify(alpha=alpha) for alpha in (0.0, 0.5, 1.0)]
    sizes = [r.left.focal_px[0] for r in shown]
    assert sizes[0] > sizes[1] > sizes[2] and len({r.size_wh for r in shown}) == 1
    valid = shown[0]
    for camera, R, P in (
        (rig.left, valid.R_rect_left, valid.P_left),
        (rig.right, valid.R_rect_right, valid.P_right),
    ):
        assert rectification_map(camera, R, P, valid.size_wh)[1].mean() > 0.998
    assert shown[2].kept > 0.97  # what lies along the baseline is in no image


def test_alpha_0_is_as_large_as_opencvs():
    cv2 = pytest.importorskip("cv2")
    rig = beside(NARROW, NARROW)
    T = rig.T_right_left
    P1 = cv2.stereoRectify(
        rig.left.K, rig.left.distortion, rig.right.K, rig.right.distortion, (640, 480), T.R, T.t[:, None],
        flags=cv2.CALIB_ZERO_DISPARITY, alpha=0.0,
    )[2]  # fmt: skip
    assert rig.rectify(alpha=0.0).left.focal_px[0] <= 1.02 * P1[0, 0]


def test_size_and_projection_are_as_asked_for():
    rig = RIGS["converging by 100°"]
    asked = rig.rectify(size_wh=(320, 200), projection="pinhole")
    assert asked.size_wh == (320, 200) and asked.P_left.shape == (3, 4) and min(asked.covered) > 0.5
    assert asked.kept < rig.rectify().kept
    for options, text in (
        ({"alpha": 1.5}, "alpha is between"),
        ({"size_wh": (0, 200)}, "size_wh is"),
    ):
        with pytest.raises(ValueError, match=text):
            rig.rectify(**options)


def test_what_is_no_pinhole_has_no_matrix():
    r = RIGS["fisheyes of 200°"].rectify()
    with pytest.raises(DegenerateGeometryError, match="equirectangular projection, which has no matrix Q"):
        _ = r.Q
    assert r.P_left is r.left and r.P_right is r.right


def test_cameras_that_see_nothing_in_common_are_refused():
    with pytest.raises(DegenerateGeometryError, match="no field in common"):
        converging(-60).rectify()
    away = StereoRig(NARROW, NARROW, SE3(so3.exp(np.array([1.2, 0.0, 0.0])), np.array([-0.1, 0, 0])))
    with pytest.raises(DegenerateGeometryError, match="no field in common"):
        away.rectify()


@pytest.mark.parametrize("model", DISTORTION)
def test_a_camera_sees_the_rays_of_its_pixels_and_no_others(model):
    camera = make_rig(model).left
    u, v = np.meshgrid(np.linspace(0, 1279, 12), np.linspace(0, 959, 9))
    rays = camera.unproject(np.stack([u, v], axis=-1))
    assert camera.sees(rays).all() and camera.sees(3 * rays).all()
    assert not camera.sees(camera.unproject(np.array([[-2.0, 400.0], [600.0, 961.0]]))).any()
    assert not camera.sees(np.array([[0.0, 0, -1], [0, 0, 0]])).any()


def test_a_ray_beyond_the_fold_is_not_seen():
    """The image of a strong barrel lens comes back towards the middle there."""
    camera = Camera("brown4", (640, 480), np.array([500.0, 500, 320, 240, 0, -0.5, 0, 0, 0]))
    folded = np.array([[1.2, 0.0, 1.0]])
    assert np.all(np.abs(camera.project(folded) - [320, 240]) < 320) and not camera.sees(folded).any()
