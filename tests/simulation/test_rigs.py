import numpy as np
import pytest

from binocal.cameras import CAMERA_MODELS
from binocal.geometry import so3
from binocal.simulation import random_rig, table2_rig
from binocal.simulation.visibility import field_angle_rad


def test_table2_rig_is_the_papers():
    rig = table2_rig()
    assert rig.baseline_m == pytest.approx(0.060, abs=1e-12)
    assert not rig.is_swapped
    for camera in (rig.left, rig.right):
        assert camera.size_wh == (1280, 960)
        assert camera.model == "brown4"
        assert camera.parameters[:2] == pytest.approx([1600, 1600], rel=3e-3)
        assert camera.parameters[2:4] == pytest.approx([639.5, 479.5], abs=15)
    # toe-in: a point far ahead of the left camera appears right of the middle of the right one
    assert (rig.T_right_left.R @ [0, 0, 1])[0] > 0.01
    assert np.degrees(so3.angle_rad(rig.T_right_left.R)) < 1.5


@pytest.mark.parametrize("model", CAMERA_MODELS)
@pytest.mark.parametrize("has_skew", [False, True])
def test_random_rigs_have_a_ray_for_every_pixel_and_project_it_back(model, has_skew):
    for seed in range(8):
        rig = random_rig(np.random.default_rng(seed), model, has_skew=has_skew)
        assert 0.05 <= rig.baseline_m <= 0.15
        assert not rig.is_swapped
        for camera in (rig.left, rig.right):
            width, height = camera.size_wh
            u, v = np.meshgrid(np.linspace(0, width - 1, 9), np.linspace(0, height - 1, 7))
            pixels = np.stack([u, v], axis=-1)
            error = camera.project(camera.unproject(pixels)) - pixels
            assert np.abs(error).max() < 1e-8  # NaN fails as well
            assert (camera.parameters[4] != 0) == has_skew
            half_field = np.degrees(field_angle_rad(camera))
            assert (50 < half_field < 110) if model == "fisheye4" else (17 < half_field < 62)


def test_random_rig_takes_what_is_given_and_repeats_by_seed():
    first, second = (
        random_rig(np.random.default_rng(5), "brown5", size_wh=(320, 240), baseline_m=0.2, field_deg=60)
        for _ in range(2)
    )
    assert first.baseline_m == pytest.approx(0.2)
    assert first.left.size_wh == (320, 240)
    assert np.array_equal(first.left.parameters, second.left.parameters)
    assert not np.array_equal(first.left.parameters, first.right.parameters)
    half_width = np.degrees(np.arctan(160 / first.left.parameters[0]))
    assert half_width == pytest.approx(30, abs=0.5)


def test_impossible_requests_are_refused():
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="unknown camera model"):
        random_rig(rng, "pinhole9")
    with pytest.raises(ValueError, match="field_deg"):
        random_rig(rng, "brown4", field_deg=150)
