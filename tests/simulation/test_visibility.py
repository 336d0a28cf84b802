import numpy as np
import pytest

from binocal.cameras import Camera
from binocal.simulation import table2_rig, visible_px


def test_image_reaches_half_a_pixel_beyond_the_outer_pixel_centres():
    camera = Camera("brown4", (100, 80), np.array([100.0, 100, 49.5, 39.5, 0, 0, 0, 0, 0]))
    wanted = np.array([[-0.49, 0], [-0.51, 0], [99.49, 79.49], [99.51, 0], [50, 79.6]])
    points = np.c_[(wanted - [49.5, 39.5]) / 100, np.ones(5)]
    seen = visible_px(camera, points)
    assert np.isfinite(seen[:, 0]).tolist() == [True, False, True, False, False]
    assert seen[[0, 2]] == pytest.approx(wanted[[0, 2]])
    assert np.isnan(visible_px(camera, points, margin_px=1)).all()


def test_a_point_that_folds_back_into_the_image_is_not_seen():
    camera = Camera("brown4", (640, 480), np.array([400.0, 400, 320, 240, 0, -0.3, 0, 0, 0]))
    far_out = np.array([[1.8, 0.0, 1.0]])  # factor 1 - 0.3 * 3.24 = 0.03: lands 20 px from the middle
    assert np.abs(camera.project(far_out) - [320, 240]).max() < 25
    assert np.isnan(visible_px(camera, far_out)).all()


def test_points_behind_are_not_seen():
    camera = table2_rig().left
    assert np.isnan(visible_px(camera, np.array([[0.0, 0.0, -1.0]]))).all()


def test_fisheye_sees_beyond_90_degrees():
    camera = Camera("fisheye4", (1000, 1000), np.array([280.0, 280, 499.5, 499.5, 0, 0, 0, 0, 0]))
    points = np.array([[1.0, 0.0, -0.1], [1.0, 0.0, -1.0], [0.0, 0.0, -1.0]])  # 95.7, 135 and 180 degrees
    assert np.isfinite(visible_px(camera, points)[:, 0]).tolist() == [True, False, False]
