from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.cameras import Camera
from binocal.geometry import SE3, so3
from binocal.metrics import image
from rigs import DISTORTION, make_detections, make_poses, make_rig


@pytest.mark.parametrize("model", DISTORTION)
def test_exact_pixels_give_exact_points(model):
    rig = make_rig(model)
    points = np.random.default_rng(0).uniform([-0.1, -0.08, 0.3], [0.15, 0.08, 2.0], (100, 3))
    left, right = rig.left.project(points), rig.right.project(rig.T_right_left.apply(points))
    found, is_valid = image.triangulate(rig, left, right)
    assert is_valid.all()
    np.testing.assert_allclose(found, points, atol=1e-9)


def test_triangulation_is_the_least_squares_point():
    """At the minimum the gradient of the cost vanishes; measured 3e-10 of the mid-point's."""
    rng = np.random.default_rng(3)
    rig = make_rig()
    points = rng.uniform([-0.1, -0.08, 0.3], [0.1, 0.08, 1.0], (50, 3))
    left = rig.left.project(points) + rng.standard_normal((50, 2))
    right = rig.right.project(rig.T_right_left.apply(points)) + rng.standard_normal((50, 2))

    def cost(X):
        return np.sum((rig.left.project(X) - left) ** 2, -1) + np.sum(
            (rig.right.project(rig.T_right_left.apply(X)) - right) ** 2, -1
        )

    found, _ = image.triangulate(rig, left, right)
    middle, _ = image._midpoint(rig, rig.left.unproject(left), rig.right.unproject(right))
    assert np.all(cost(found) <= cost(middle))
    for step in 1e-5 * np.eye(3):
        assert np.all(cost(found + step) > cost(found)) and np.all(cost(found - step) > cost(found))


def test_triangulation_scatter_is_what_the_jacobian_predicts():
    """Whitened squared error of 4000 points: mean 3 within 4 standard errors (0.15); measured 3.02."""
    rng = np.random.default_rng(5)
    rig, noise_px = make_rig(), 0.1
    points = np.tile([0.02, 0.01, 0.5], (4000, 1))
    left = rig.left.project(points) + noise_px * rng.standard_normal((4000, 2))
    right = rig.right.project(rig.T_right_left.apply(points)) + noise_px * rng.standard_normal((4000, 2))
    found, _ = image.triangulate(rig, left, right)
    _, J = image._linearize_pair(rig, points[:1])
    whitened = np.einsum("ni,ij,nj->n", found - points, J[0].T @ J[0] / noise_px**2, found - points)
    assert whitened.mean() == pytest.approx(3.0, abs=0.15)


@pytest.mark.usefixtures("unchecked_types")
def test_what_cannot_be_triangulated_is_nan():
    rig = make_rig(rotation_rad=(0, 0, 0), t=(-0.06, 0, 0))
    rays = np.array([[0.0, 0, 1], [0.0, 0, 1], [0, 0, 1]])
    left = rig.left.project(rays)
    right = rig.right.project(
        np.array([[0.0, 0, 1], [0.1, 0, 1], [-0.1, 0, 1]])
    )  # parallel, meeting behind, meeting in front
    points, is_valid = image.triangulate(rig, left, right)
    assert is_valid.tolist() == [False, False, True] and np.isnan(points[:2]).all() and np.isfinite(points[2]).all()
    right[2, 0] = np.nan
    assert not image.triangulate(rig, left, right)[1].any()
    with pytest.raises(ValueError, match="must both"):
        image.triangulate(rig, left, right[:2])


def test_all_criteria_are_zero_for_the_true_rig():
    rig, poses = make_rig(), make_poses(4, np.random.default_rng(0))
    detections = make_detections(rig, poses)
    assert image.pixel_error(rig, detections, poses).all_px < 1e-9
    assert image.rectified_row_error(rig, detections).rms_px < 1e-7
    lengths = image.length_error(rig, detections)
    assert lengths.scale_rms_percent < 1e-8 and lengths.side_rms_percent < 1e-7
    assert lengths.n_views == 4 and lengths.n_sides == 4 * (10 * 8 + 11 * 7)


def test_a_wrong_baseline_is_a_wrong_length_and_nothing_else():
    rig, poses = make_rig(), make_poses(5, np.random.default_rng(0))
    detections = make_detections(rig, poses)
    T = rig.T_right_left
    longer = replace(rig, T_right_left=SE3(T.R, T.t * 1.01))
    lengths = image.length_error(longer, detections)
    assert lengths.scale_rms_percent == pytest.approx(1.0, abs=1e-7) and lengths.scale_mean_percent == pytest.approx(
        1.0, abs=1e-7
    )
    assert lengths.side_rms_percent == pytest.approx(1.0, abs=1e-6)
    assert image.rectified_row_error(longer, detections).rms_px < 1e-7


def test_a_tilted_right_camera_is_a_row_error():
    """One milliradian about x moves rows by about f * 1e-3 = 1.6 px."""
    rig, poses = make_rig(), make_poses(5, np.random.default_rng(0))
    detections = make_detections(rig, poses)
    T = rig.T_right_left
    tilted = replace(rig, T_right_left=SE3(so3.exp(np.array([1e-3, 0, 0])) @ T.R, T.t))
    rows = image.rectified_row_error(tilted, detections)
    assert rows.rms_px == pytest.approx(1.6, rel=0.1) and abs(rows.median_px) == pytest.approx(1.6, rel=0.1)
    assert rows.view_rms_px.shape == (5,)


def test_pixel_error_is_the_distance_per_corner():
    """Noise of 0.1 px per coordinate is 0.1 sqrt(2) = 0.141 px per corner, OpenCV's convention."""
    rng = np.random.default_rng(0)
    rig, poses = make_rig(), make_poses(20, rng)
    error = image.pixel_error(rig, make_detections(rig, poses, noise_px=0.1, rng=rng), poses)
    assert error.all_px == pytest.approx(0.1414, rel=0.03) and error.n_corners == 20 * 2 * 88
    assert error.left_px == pytest.approx(error.right_px, rel=0.06)


def test_missing_corners_are_left_out():
    rig, poses = make_rig(), make_poses(3, np.random.default_rng(0))
    detections = make_detections(rig, poses)
    left = detections.left_px.copy()
    left[0], left[1, 3:] = np.nan, np.nan
    partial = replace(detections, left_px=left)
    lengths = image.length_error(rig, partial)
    assert lengths.n_views == 1 and np.isnan(lengths.view_scale_percent[:2]).all() and lengths.scale_rms_percent < 1e-8
    assert image.pixel_error(rig, partial, poses).n_corners == 3 * 88 + 3 + 88
    nothing = image.length_error(rig, replace(detections, left_px=np.full_like(left, np.nan)))
    assert np.isnan(nothing.scale_rms_percent) and nothing.n_views == 0


def test_a_row_of_corners_has_no_scale():
    line = np.stack([np.arange(5.0), np.zeros(5), np.zeros(5)], axis=-1)
    assert np.isnan(image.similarity_scale(line, line))
    square = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    assert image.similarity_scale(square, 3 * square @ so3.exp(np.array([1.0, 2, 3])).T + 1) == pytest.approx(
        3.0, rel=1e-12
    )


@pytest.mark.parametrize(
    ("spec", "side_m", "n_sides"),
    [
        ("chessboard:3x3:10mm", 0.01, 12),
        ("aprilgrid:2x2:10mm:0.3", 0.01, 16),
        ("acircles:3x3:10mm", np.sqrt(2) * 0.01, 10),
    ],
)
def test_sides_of_every_board(spec, side_m, n_sides):
    sides, length_m = image.board_sides(parse_board(spec).object_points_m, side_m)
    assert len(sides) == n_sides
    np.testing.assert_allclose(length_m, side_m, rtol=1e-12)


def test_a_vertical_rig_misses_columns():
    camera = Camera("brown4", (1280, 960), np.array([1600.0, 1600, 640, 480, 0, 0, 0, 0, 0]))
    rig = replace(make_rig(t=(0.0, -0.06, 0.0), rotation_rad=(0, 0, 0)), left=camera, right=camera)
    detections = make_detections(rig, make_poses(3, np.random.default_rng(0)))
    shifted = replace(detections, right_px=detections.right_px + [0.7, 0.0])
    assert image.rectified_row_error(rig, shifted).rms_px == pytest.approx(0.7, rel=1e-6)
