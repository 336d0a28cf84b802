"""Rendered streets and rooms: two cameras see the same world, and only what moves differs between exposures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from binocal.cameras import Camera, StereoRig
from binocal.geometry import SE3, so3
from binocal.matching.pairs import match_pair
from binocal.simulation import SceneOptions, draw_textured_scene, render_scene_image
from binocal.simulation.scene_renderer import render_scene_light
from binocal.simulation.textured_scenes import TexturedPatch
from binocal.simulation.textures import Texture, grain, slats
from binocal.solvers.epipolar import EpipolarProblem
from binocal.solvers.relative_pose import RelativePose

SIZE = (400, 300)
T = SE3(so3.exp(np.radians([0.5, -1.0, 0.7])), np.array([-0.3, 0.004, 0.01]))
BROWN = Camera("brown4", SIZE, np.array([300.0, 301, 203, 148, 0, -0.2, 0.05, 1e-3, -5e-4]))
SMALL = Camera("brown4", (160, 120), np.array([120.0, 121, 81, 59, 0, -0.2, 0.05, 1e-3, -5e-4]))
FISHEYE = Camera("fisheye4", SIZE, np.array([150.0, 151, 201, 147, 0, 0.01, -0.01, 0.002, 0]))


def shown(rig, kind, seed=0, **options):
    """Both images of a pair."""
    scene = draw_textured_scene(kind, rig, 1, np.random.default_rng(seed))
    options = SceneOptions(0.7, **options)
    poses = (
        (rig.left, scene.T_left_world[0], 0.0),
        (rig.right, rig.T_right_left @ scene.T_left_world[0], options.gap_s),
    )
    return [
        render_scene_image(scene, 0, camera, pose, options, np.random.default_rng(k), elapsed_s)
        for k, (camera, pose, elapsed_s) in enumerate(poses)
    ]


@pytest.mark.parametrize(
    "cameras", [(BROWN, BROWN), (FISHEYE, FISHEYE), (BROWN, FISHEYE)], ids=["brown", "fisheye", "mixed"]
)
@pytest.mark.parametrize("kind", ["street", "room"])
def test_matches_of_rendered_pairs_lie_on_the_true_epipolar_lines(cameras, kind):
    rig = StereoRig(*cameras, T)
    matches = match_pair(*shown(rig, kind, noise_dn=1.0), "0").matches
    problem, _ = EpipolarProblem.of_matches(cameras, matches)
    residuals = problem.residuals_px(RelativePose.of(T))
    right = residuals[np.abs(residuals) < 0.5]
    assert len(right) > 25 and len(right) > 0.7 * len(residuals)
    # measured 0.007 to 0.010, of two lens models 0.07 to 0.09: windows of the one hardly look like those of the other
    assert np.median(np.abs(right)) < (0.02 if cameras[0] is cameras[1] else 0.15)
    assert abs(np.median(right)) < 5 * np.std(right) / np.sqrt(len(right)) + 0.01


def test_light_is_that_of_a_far_finer_grid():
    """A slanted wall with a fence before it, against the exact ray of every one of 12 x 12 points per pixel, blurred there."""
    import cv2

    camera = Camera("brown4", (80, 60), np.array([90.0, 91, 40, 29, 0, -0.2, 0.05, 1e-3, -5e-4]))
    turned = so3.exp(np.array([0.1, 0.5, 0.2]))
    texture = grain(np.random.default_rng(0), 4.0)
    wall = TexturedPatch(np.array([0, 0, 5.0]), turned[:2], (40.0, 40.0), 120, 30, slats(0.6), 40)
    light = render_scene_light(camera, SE3.identity(), [wall], texture, 0.7)
    n = 12
    x, y = np.meshgrid((np.arange(80 * n) + 0.5) / n - 0.5, (np.arange(60 * n) + 0.5) / n - 0.5)
    rays = camera.unproject(np.stack([x, y], axis=-1)).reshape(-1, 3)
    normal = np.cross(*wall.axes)
    distance = (normal @ wall.centre_m) / (rays @ normal)
    u, v = ((distance[:, None] * rays - wall.centre_m) @ axis for axis in wall.axes)
    spacing = distance / np.abs(rays @ normal) / 4 / camera.parameters[0]
    from binocal.simulation.scene_renderer import _light_of

    exact = _light_of(wall, texture, *(a.astype(np.float32) for a in (u, v, spacing))).reshape(60 * n, 80 * n)
    exact = cv2.GaussianBlur(exact, (0, 0), 0.7 * n, borderType=cv2.BORDER_REPLICATE)
    exact = cv2.resize(exact, (80, 60), interpolation=cv2.INTER_AREA)
    inner = np.s_[6:-6, 6:-6]
    assert np.abs(light - exact)[inner].max() < 0.06  # measured 0.028 of a contrast of 147
    assert np.ptp(exact[inner]) > 80


def test_only_what_moves_moves_between_the_exposures():
    rig = StereoRig(SMALL, SMALL, T)
    together, apart = (shown(rig, "street", noise_dn=0.0, gap_s=gap_s) for gap_s in (0.0, 0.1))
    assert np.array_equal(together[0], apart[0])
    changed = np.abs(together[1].astype(int) - apart[1]) > 2
    assert 0.001 < changed.mean() < 0.2


def test_scenes_are_those_of_their_seed_and_differ_from_pair_to_pair():
    rig = StereoRig(SMALL, SMALL, T)
    one, again, other = (shown(rig, "room", seed) for seed in (1, 1, 2))
    assert np.array_equal(one, again)
    assert np.abs(np.subtract(one, other, dtype=float)).mean() > 10
    scene = draw_textured_scene("street", rig, 3, np.random.default_rng(0))
    assert scene.n_pairs == 3 and len(scene.T_left_world.t) == 3
    assert not np.allclose(scene.movers[0][0].centre_m, scene.movers[1][0].centre_m)
    with pytest.raises(ValueError, match="unknown scene 'moon'; known: street, room"):
        draw_textured_scene("moon", rig, 1, np.random.default_rng(0))


def test_a_rig_without_a_length_sees_what_one_of_the_usual_baseline_sees():
    usual = 0.4  # the middle of a street's baselines
    metric = StereoRig(SMALL, SMALL, SE3(T.R, usual * T.t / np.linalg.norm(T.t)))
    plain = replace(metric, T_right_left=SE3(T.R, T.t / np.linalg.norm(T.t)), is_metric=False)
    images = [shown(rig, "street", noise_dn=0.0)[1].astype(float) for rig in (metric, plain)]
    assert np.mean(np.abs(images[0] - images[1]) > 2) < 1e-3


def test_a_fisheye_is_black_where_it_shows_nothing():
    camera = replace(FISHEYE, parameters=np.array([60.0, 60, 200, 150, 0, 0, 0, 0, 0]))
    scene = draw_textured_scene("room", StereoRig(camera, camera, T), 1, np.random.default_rng(0))
    image = render_scene_image(
        scene, 0, camera, scene.T_left_world[0], SceneOptions(noise_dn=0), np.random.default_rng(0)
    )
    assert not image[[0, 0, -1, -1], [0, -1, 0, -1]].any() and image[150, 200] > 0


def test_textures_repeat_have_mean_0_and_fade_where_they_are_too_fine():
    rng = np.random.default_rng(0)
    u, v = rng.uniform(0, 10, (2, 5000)).astype(np.float32)
    for texture, period_m in ((grain(rng, 4.0), 4.0), (slats(0.25), 0.25)):
        near = np.full(5000, 1e-4, dtype=np.float32)
        values = texture.sample(u, v, near)
        assert np.abs(texture.sample(u + np.float32(period_m), v, near) - values).max() < 0.12 * np.ptp(values)
        assert abs(values.mean()) < 0.1 and values.std() > 0.3
        assert np.abs(texture.sample(u, v, np.full(5000, 2 * period_m, dtype=np.float32))).max() < 1e-5
    constant = Texture.of_bitmap(np.full((8, 8), 3.0), 1.0)
    assert np.abs(constant.sample(u, v, near)).max() < 1e-6


@pytest.mark.usefixtures("unchecked_types")
def test_wrong_options_are_refused():
    for wrong in ({"blur_px": -1.0}, {"noise_dn": -1.0}, {"gap_s": np.inf}):
        with pytest.raises(ValueError):
            SceneOptions(**wrong)
