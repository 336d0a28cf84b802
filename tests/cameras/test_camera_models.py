"""Agreement of the built-in camera models with OpenCV, and where they end; test_contract.py holds what every model must do."""

import cv2
import numpy as np
import pytest

from binocal.cameras import CAMERA_MODELS, Camera

DISTORTIONS = {
    "brown4": [-0.2, 0.05, 1e-3, -2e-3],
    "brown5": [-0.2, 0.05, 1e-3, -2e-3, 0.01],
    "brown8": [-0.2, 0.05, 1e-3, -2e-3, 0.01, 0.1, 0.02, 0.003],
    "fisheye4": [0.01, -0.02, 0.003, -0.001],
}
pytestmark = pytest.mark.parametrize("name", list(CAMERA_MODELS))


def make_camera(name, skew=3.0):
    return Camera(name, (1280, 960), np.r_[800, 820, 640, 480, skew, DISTORTIONS[name]])


def sample_points(n=40, seed=0):
    rng = np.random.default_rng(seed)
    return np.stack([rng.uniform(-0.4, 0.4, n), rng.uniform(-0.4, 0.4, n), rng.uniform(0.8, 1.2, n)], axis=-1)


def test_projection_equals_opencv(name):
    camera, points = make_camera(name, skew=0.0), sample_points()
    if name == "fisheye4":
        expected, _ = cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), camera.K, camera.distortion)
    else:
        expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.K, camera.distortion)
    assert np.abs(expected[:, 0] - camera.project(points)).max() < 1e-10


def test_points_behind_are_nan_unless_the_model_sees_them(name):
    pixels = make_camera(name).project(np.array([[0.5, 0.1, -0.1], [0.1, 0.0, 1.0]]))
    assert np.isfinite(pixels[1]).all()
    assert np.isfinite(pixels[0]).all() == CAMERA_MODELS[name].sees_behind


def test_pixels_beyond_the_fold_have_no_ray(name):
    strong = {"brown4": [-0.5, 0, 0, 0], "brown5": [-0.5, 0, 0, 0, 0], "fisheye4": [-0.3, 0, 0, 0]}
    if name not in strong:
        pytest.skip("the rational model has no simple fold")
    camera = Camera(name, (1280, 960), np.r_[800, 800, 640, 480, 0, strong[name]])
    rays = camera.unproject(np.array([[640.0, 480.0], [640.0 + 5000, 480.0]]))
    assert np.isfinite(rays[0]).all() and np.isnan(rays[1]).all()


def test_a_camera_refuses_impossible_numbers(name):
    n = CAMERA_MODELS[name].n_parameters
    with pytest.raises(ValueError, match="fx, fy > 0"):
        Camera(name, (640, 480), np.zeros(n))
    with pytest.raises(ValueError, match="parameters"):
        Camera(name, (640, 480), np.ones(n + 1))
