"""Which pixels have no ray, and that the quick answer never promises one that is missing."""

import numpy as np
import pytest

from binocal.cameras import Camera
from binocal.cameras.ray_coverage import pixels_without_ray, reaches_corners
from binocal.simulation import random_rig

SIZE = (640, 480)
LINEAR = [400.0, 400.0, 319.5, 239.5, 0.0]


def test_a_lens_that_folds_inside_the_image_lacks_its_corners():
    # radial mapping r (1 - 0.45 r²) turns at r = 0.861, where it is 0.574: 229.5 px of the 400 to a corner
    found = pixels_without_ray(Camera("brown4", SIZE, np.array([*LINEAR, -0.45, 0, 0, 0])))
    assert found is not None
    disc = np.pi * 229.5**2 / (640 * 480)
    assert found.share == pytest.approx(1 - disc, abs=0.01)
    assert found.radius_px == pytest.approx(229.5, abs=8)  # the grid's steps are 14 and 10 px


@pytest.mark.parametrize(
    ("model", "distortion"),
    [
        ("brown4", [0, 0, 0, 0]),
        ("brown5", [0.2, 0.1, 0, 0, 0.1]),
        ("brown4", [-0.1, 0.02, 1e-3, 1e-3]),
        ("fisheye4", [0, 0, 0, 0]),
    ],
)
def test_a_lens_that_keeps_growing_has_a_ray_for_every_pixel(model, distortion):
    camera = Camera(model, SIZE, np.array([*LINEAR, *distortion]))
    assert reaches_corners(camera) and pixels_without_ray(camera) is None


@pytest.mark.parametrize("model", ["brown4", "brown5", "brown8", "fisheye4"])
def test_the_quick_answer_never_promises_a_ray_that_is_missing(model):
    rng = np.random.default_rng(5)
    u, v = np.meshgrid(np.linspace(0, 1, 33), np.linspace(0, 1, 33))
    answers = []
    for _ in range(60):
        camera = random_rig(rng, model).left
        parameters = camera.parameters.copy()
        parameters[5:] *= rng.uniform(-1, 1) * (
            4 if model in ("brown8", "fisheye4") else 12
        )  # many of these lenses fold
        parameters[7:9] *= 0.1 if model != "fisheye4" else 1.0
        bent = Camera(model, camera.size_wh, parameters)
        width, height = bent.size_wh
        has_all = np.isfinite(bent.unproject(np.stack([u * (width - 1), v * (height - 1)], axis=-1))).all()
        answers.append(reaches_corners(bent))
        assert has_all or not answers[-1]
    assert 5 < sum(answers) < 60
