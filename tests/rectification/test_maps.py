from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from binocal.cameras import Camera, StereoRig
from binocal.errors import DegenerateGeometryError
from binocal.geometry import SE3, so3
from binocal.rectification import rectification_map, rectified_rig, rectify, rectify_points
from rigs import DISTORTION, make_rig

POINTS_M = np.random.default_rng(1).uniform([-0.15, -0.1, 0.5], [0.2, 0.1, 1.5], (200, 3))


def rectified(rig: StereoRig, points_m: np.ndarray, **options) -> tuple[np.ndarray, np.ndarray]:
    r = rectify(rig, **options)
    left, right = rig.left.project(points_m), rig.right.project(rig.T_right_left.apply(points_m))
    return rectify_points(rig.left, r.R_rect_left, r.P_left, left), rectify_points(
        rig.right, r.R_rect_right, r.P_right, right
    )


@pytest.mark.parametrize("model", DISTORTION)
@pytest.mark.parametrize("t", [(-0.06, 0.002, 0.004), (0.06, -0.003, 0.001), (0.002, -0.05, 0.003), (0.001, 0.05, 0.0)])
def test_matching_points_share_a_row_or_a_column(model, t):
    rig = make_rig(model, t=t)
    r = rectify(rig, projection="pinhole")
    assert r.is_vertical == (abs(t[1]) > abs(t[0])) and r.is_swapped == (t[1 if r.is_vertical else 0] > 0)
    left, right = rectified(rig, POINTS_M, projection="pinhole")
    across, along = (0, 1) if r.is_vertical else (1, 0)
    np.testing.assert_allclose(left[:, across], right[:, across], atol=1e-7)
    disparity_px = left[:, along] - right[:, along]
    assert np.all((disparity_px < 0) == r.is_swapped)

    # Q gives back the points, in the rectified left frame, with positive depth in every arrangement
    xyd1 = np.concatenate([left, disparity_px[:, None], np.ones((len(left), 1))], axis=1)
    homogeneous = xyd1 @ r.Q.T
    np.testing.assert_allclose(homogeneous[:, :3] / homogeneous[:, 3:], POINTS_M @ r.R_rect_left.T, atol=1e-8)


@given(st.lists(st.floats(-0.3, 0.3), min_size=3, max_size=3), st.lists(st.floats(-0.3, 0.3), min_size=2, max_size=2))
def test_the_identities_of_a_rectification(rotation, aside):
    rig = make_rig(rotation_rad=rotation, t=(-1.0, *aside))
    r = rectify(rig)
    np.testing.assert_allclose(r.R_rect_right @ rig.T_right_left.R, r.R_rect_left, atol=1e-12)
    np.testing.assert_allclose(
        r.R_rect_right @ rig.T_right_left.t, [r.P_right[0, 3] / r.P_right[0, 0], 0, 0], atol=1e-12
    )
    np.testing.assert_allclose(r.R_rect_left @ r.R_rect_left.T, np.eye(3), atol=1e-12)
    assert r.P_right[0, 3] / r.P_right[0, 0] == pytest.approx(-rig.baseline_m, rel=1e-12)


def test_agrees_with_opencv():
    cv2 = pytest.importorskip("cv2")
    rig = make_rig("brown5")
    T = rig.T_right_left
    R1, R2, P1, P2, Q, *_ = cv2.stereoRectify(
        rig.left.K,
        rig.left.distortion,
        rig.right.K,
        rig.right.distortion,
        rig.left.size_wh,
        T.R,
        T.t[:, None],
        flags=cv2.CALIB_ZERO_DISPARITY,
        alpha=-1,
    )
    r = rectify(rig)
    np.testing.assert_allclose(r.R_rect_left, R1, atol=1e-9)
    np.testing.assert_allclose(r.R_rect_right, R2, atol=1e-9)
    assert r.Q[3, 2] == pytest.approx(Q[3, 2], rel=1e-9) and np.sign(P2[0, 3]) == np.sign(r.P_right[0, 3])
    assert r.P_left[0, 0] == pytest.approx(P1[0, 0], rel=0.1)


@pytest.mark.parametrize("model", DISTORTION)
def test_the_map_is_the_inverse_of_the_points(model):
    rig = make_rig(model)
    r = rectify(rig)
    source, is_inside = rectification_map(rig.right, r.R_rect_right, r.P_right, r.size_wh)
    assert source.shape == (*r.size_wh[::-1], 2) and 0.9 < is_inside.mean() <= 1
    assert is_inside.mean() == pytest.approx(r.covered[1], abs=0.015)
    assert np.array_equal(np.isfinite(source[..., 0]), is_inside)
    rows, columns = (index[::997] for index in np.nonzero(is_inside))
    back = rectify_points(rig.right, r.R_rect_right, r.P_right, source[rows, columns])
    np.testing.assert_allclose(back, np.stack([columns, rows], axis=-1), atol=2e-4)  # the map is in single precision


def test_the_rectified_rig_sees_what_rectification_says():
    rig = make_rig()
    r = rectify(rig)
    ideal = rectified_rig(rig, r)
    left, right = rectified(rig, POINTS_M)
    points = POINTS_M @ r.R_rect_left.T
    np.testing.assert_allclose(ideal.left.project(points), left, atol=1e-7)
    np.testing.assert_allclose(ideal.right.project(ideal.T_right_left.apply(points)), right, atol=1e-7)
    assert ideal.baseline_m == pytest.approx(rig.baseline_m)


def test_a_rig_without_a_side_is_refused():
    with pytest.raises(DegenerateGeometryError, match="one behind the other"):
        rectify(make_rig(t=(-0.01, 0.0, 0.06)))
    with pytest.raises(DegenerateGeometryError, match="no baseline"):
        rectify(make_rig(t=(0.0, 0.0, 0.0)))
    with pytest.raises(DegenerateGeometryError, match="no field in common"):  # they diverge by 100 deg
        rectify(make_rig(rotation_rad=(0.0, -1.75, 0.0), t=(-0.06 * np.cos(0.87), 0.0, -0.06 * np.sin(0.87))))


def test_pixels_without_a_ray_are_nan():
    camera = Camera("brown4", (640, 480), np.array([500, 500, 320, 240, 0, -0.5, 0, 0, 0]))
    rig = StereoRig(camera, camera, SE3(np.eye(3), np.array([-0.1, 0, 0])))
    r = rectify(rig)
    points = rectify_points(
        camera, r.R_rect_left, r.P_left, np.array([[320.0, 240.0], [5000.0, 240.0], [np.nan, np.nan]])
    )
    assert np.isfinite(points[0]).all() and np.isnan(points[1:]).all()
    turned = replace(rig, T_right_left=SE3(so3.exp(np.array([0, 0.1, 0])), np.array([-0.1, 0, 0])))
    assert np.isfinite(rectify(turned).P_left).all()
