"""Depth, row and projection move with every parameter as their linear forms say: against central differences."""

import numpy as np
import pytest

from binocal.cameras import Camera, StereoRig, camera_model
from binocal.geometry import SE3, so3
from binocal.metrics.image import triangulate
from binocal.rectification import rectify_points, row_rectification
from binocal.uncertainty.depth import points_at, relative_depth_gradients
from binocal.uncertainty.field import common_field
from binocal.uncertainty.projection import projection_gradients
from binocal.uncertainty.rows import row_gradients
from rigs import make_rig

MODELS = ("brown4", "brown5", "brown8", "fisheye4")


def names_of(rig):
    own = [f"{side}.{n}" for side in ("left", "right") for n in camera_model(getattr(rig, side).model).parameter_names]
    return (*own, *(f"{part}.{axis}" for part in ("rotation", "translation") for axis in "xyz"))


def moved(rig, name, step):
    """The rig with one named parameter stepped, in the coordinates of a covariance."""
    part, _, own = name.partition(".")
    T = rig.T_right_left
    if part in ("left", "right"):
        camera = getattr(rig, part)
        parameters = camera.parameters.copy()
        parameters[camera_model(camera.model).parameter_names.index(own)] += step
        sides = {"left": rig.left, "right": rig.right} | {part: Camera(camera.model, camera.size_wh, parameters)}
        return StereoRig(sides["left"], sides["right"], T)
    xi = step * (np.array(list("xyz")) == own)
    R, t = (so3.exp(xi) @ T.R, T.t) if part == "rotation" else (T.R, T.t + xi)
    return StereoRig(rig.left, rig.right, SE3(R, t))


def step_of(name):
    """Small against the numbers, large against rounding: relative errors of the differences stay below 1e-5."""
    if name.startswith("rotation") or name.split(".")[1][0] in "kp":
        return 1e-6
    return 1e-7 if name.startswith("translation") else 1e-3


def assert_close(found, expected):
    assert np.abs(found - expected).max() <= 2e-5 * np.abs(expected).max() + 1e-9  # measured: 2e-6


def test_depth_of_points_a_billion_metres_away_grows_with_range_and_beyond_reach_is_untold():
    rig = make_rig("brown4", t=(-0.06, 0.001, 0.002))
    names = names_of(rig)
    near, far, beyond = (
        relative_depth_gradients(rig, names, points_at(rig, np.array([[320.0, 240.0]]), depth_m))[0]
        for depth_m in (1e5, 1e9, 1e13)
    )
    grows = [not name.startswith("translation") for name in names]  # a baseline's share is the same at every range
    assert far[grows] == pytest.approx(1e4 * near[grows], abs=1e-4 * np.abs(far).max())
    assert np.isnan(beyond).all()


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("t", [(-0.06, 0.001, 0.002), (0.003, -0.06, 0.001)], ids=["horizontal", "vertical"])
def test_depth_and_rows_move_with_every_parameter(model, t):
    rig = make_rig(model, t=t, skew=0.7)
    field = common_field(rig, 0.8, (5, 4))
    points, px = field.points[field.is_common], field.left_px[field.is_common]
    assert len(points) >= 8
    names = names_of(rig)
    depth = relative_depth_gradients(rig, names, points)
    rows = row_gradients(rig, names, px, np.linalg.norm(points, axis=-1))
    seen = rig.left.project(points), rig.right.project(rig.T_right_left.apply(points))

    def measured(other):
        X, is_valid = triangulate(other, *seen)
        assert is_valid.all()
        r = row_rectification(other)
        left, right = (
            rectify_points(camera, R, P, q)[:, 0 if r.is_vertical else 1]
            for camera, R, P, q in (
                (other.left, r.R_rect_left, r.P_left, seen[0]),
                (other.right, r.R_rect_right, r.P_right, seen[1]),
            )
        )
        return np.log(np.linalg.norm(X, axis=1)), left - right

    for i, name in enumerate(names):
        h = step_of(name)
        plus, minus = measured(moved(rig, name, h)), measured(moved(rig, name, -h))
        assert_close(depth[:, i], (plus[0] - minus[0]) / (2 * h))
        assert_close(rows[:, i], (plus[1] - minus[1]) / (2 * h))


def test_rows_of_very_wide_lenses_are_angles_and_move_with_every_parameter():
    """A pinhole's rows 85 degrees off the axis were 21797 px apart for a rig that is right to a pixel."""
    camera = Camera("fisheye4", (640, 480), np.r_[184.0, 185.0, 320.0, 240.0, 0.0, 0.01, -0.004, 0.001, 0.0])
    rig = StereoRig(camera, camera, SE3(so3.exp(np.array([0.01, 0.02, -0.01])), np.array([-0.1, 0.001, 0.002])))
    px = np.array([[40.0, 60.0], [330.0, 20.0], [600.0, 460.0], [300.0, 250.0]])
    rays = camera.unproject(px)
    points = rays / np.linalg.norm(rays, axis=1)[:, None]  # 1 m away, some of them beside or behind the camera
    seen = camera.project(points), camera.project(rig.T_right_left.apply(points))
    names = names_of(rig)
    rows = row_gradients(rig, names, px, 1.0)

    def measured(other):
        r = row_rectification(other)
        assert r.projection == "cylindrical"
        left = rectify_points(other.left, r.R_rect_left, r.P_left, seen[0])
        return (left - rectify_points(other.right, r.R_rect_right, r.P_right, seen[1]))[:, 1]

    np.testing.assert_allclose(measured(rig), 0, atol=1e-9)
    for i, name in enumerate(names):
        h = step_of(name)
        assert_close(rows[:, i], (measured(moved(rig, name, h)) - measured(moved(rig, name, -h))) / (2 * h))
    assert np.abs(measured(moved(rig, "rotation.z", 1e-3))).max() < 0.4  # no row is stretched


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("range_m", [0.7, np.inf])
def test_projection_moves_with_every_parameter_and_with_the_boards(side, range_m):
    rig = make_rig("brown5")
    names = names_of(rig)
    px = np.array([[100.0, 80.0], [640.0, 480.0], [1200.0, 900.0]])
    found = projection_gradients(rig, names, side, px, range_m)
    camera = getattr(rig, side)
    points = camera.unproject(px) * (1.0 if np.isinf(range_m) else range_m)
    T = rig.T_right_left

    def seen(other, xi):
        """Where the other rig sees the points once its boards moved by xi: through the boards, from the true frame."""
        if np.isinf(range_m):
            world = points if side == "left" else points @ T.R  # directions
            world = world @ so3.exp(xi[:3]).T
            return getattr(other, side).project(world if side == "left" else world @ other.T_right_left.R.T)
        world = points if side == "left" else T.inverse().apply(points)
        world = world @ so3.exp(xi[:3]).T + xi[3:]
        return getattr(other, side).project(world if side == "left" else other.T_right_left.apply(world))

    for i, name in enumerate(names):
        h = step_of(name)
        difference = seen(moved(rig, name, h), np.zeros(6)) - seen(moved(rig, name, -h), np.zeros(6))
        assert_close(found[:, :, i], difference / (2 * h))
    for i in range(6):
        xi = 1e-6 * (np.arange(6) == i)
        assert_close(found[:, :, len(names) + i], (seen(rig, xi) - seen(rig, -xi)) / 2e-6)


def test_a_depth_is_along_the_axis_of_a_pinhole_and_a_distance_of_a_fisheye():
    px = np.array([[100.0, 100.0], [640.0, 480.0]])
    np.testing.assert_allclose(points_at(make_rig("brown4"), px, 2.0)[:, 2], 2.0)
    np.testing.assert_allclose(np.linalg.norm(points_at(make_rig("fisheye4"), px, 2.0), axis=1), 2.0)
