"""From one lens model's solution to another's start."""

import numpy as np
import pytest

from binocal.cameras import Camera, camera_model
from binocal.initialization.model_start import fit_intrinsics
from binocal.simulation import random_rig


def points_of(camera, n=300, seed=0):
    rng = np.random.default_rng(seed)
    pixels = rng.uniform(0, 1, (n, 2)) * (np.array(camera.size_wh) - 1)
    return camera.unproject(pixels) * rng.uniform(0.5, 2.0, (n, 1)), pixels


@pytest.mark.parametrize("model", ["brown4", "brown5", "fisheye4"])
def test_a_lens_of_the_model_itself_is_found_exactly(model):
    camera = random_rig(np.random.default_rng(1), model).left
    start = np.r_[camera.parameters[:5], np.zeros(len(camera.parameters) - 5)]
    found = fit_intrinsics(camera_model(model), start, *points_of(camera))
    assert found == pytest.approx(camera.parameters, rel=1e-6, abs=1e-6)


def test_a_fisheye_start_follows_an_ordinary_lens_to_a_tenth_of_a_pixel():
    camera = random_rig(np.random.default_rng(2), "brown4").left
    points, pixels = points_of(camera)
    found = fit_intrinsics(camera_model("fisheye4"), np.r_[camera.parameters[:5], np.zeros(4)], points, pixels)
    miss = Camera("fisheye4", camera.size_wh, found).project(points) - pixels
    assert np.sqrt(np.mean(miss**2)) < 0.2  # 0.12 measured: tangential terms are not in that model


def test_corners_behind_the_image_plane_have_no_brown_lens():
    camera = Camera("fisheye4", (1000, 1000), np.array([260.0, 260, 499.5, 499.5, 0, 0, 0, 0, 0]))
    angle = np.linspace(1.6, 1.9, 50)  # beyond 90 degrees
    points = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=-1)
    assert (
        fit_intrinsics(
            camera_model("brown4"), np.r_[260.0, 260, 499.5, 499.5, np.zeros(5)], points, camera.project(points)
        )
        is None
    )
