"""Telephoto lenses with distortion: sound sets are solved, and say what was assumed of their principal points."""

from __future__ import annotations

import numpy as np
import pytest

from binocal import calibrate
from binocal.benchmark import sound
from binocal.boards import parse_board
from binocal.cameras import Camera, StereoRig, camera_model
from binocal.cameras.brown_conrady import step_parameters
from binocal.evidence import Detections
from binocal.geometry import SE3, so3

BOARD = parse_board("chessboard:9x6:20mm")
NAMES = [*(f"rotation.{axis}" for axis in "xyz"), *(f"translation.{axis}" for axis in "xyz")]


def long_camera(rng, size_wh, focal_px, distortion):
    """A lens that moves the corners of the image by the share ``distortion``."""
    half = np.hypot(*size_wh) / 2 / focal_px
    width, height = size_wh
    centre = width / 2 + rng.normal(0, 0.015 * width), height / 2 + rng.normal(0, 0.015 * height)
    f = focal_px * (1 + rng.normal(0, 0.01))
    return Camera("brown4", size_wh, np.array([f, f * 1.001, *centre, 0, distortion / half**2, 0, 0, 0]))


def long_rig(rng, widths):
    """Cameras whose focal length is that many image widths, turned towards a board that fills half of the image."""
    size = (1280, 960)
    focal_px = widths * size[0]
    left, right = (long_camera(rng, size, focal_px, rng.uniform(-0.05, 0.05)) for _ in range(2))
    distance = widths * 0.18 * 1.6
    baseline = 0.02 * distance
    turn = so3.exp(rng.normal(0, 0.03 / widths, 3) + [0, baseline / distance, 0])
    return StereoRig(left, right, SE3(turn, -turn @ [baseline, 0, 0])), distance


def views_of(rig, distance, n_views, rng):
    points = BOARD.object_points_m
    pixels = [], []
    while len(pixels[0]) < n_views:
        axis, tilt = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(10, 45))
        R = so3.exp(tilt * np.array([np.cos(axis), np.sin(axis), 0.0])) @ so3.exp(
            np.array([0, 0, rng.uniform(-0.4, 0.4)])
        )
        z = distance * rng.uniform(0.85, 1.25)
        place = rng.uniform(-0.25, 0.25, 2) * rig.left.size_wh / rig.left.parameters[0] * z
        in_left = (points - points.mean(axis=0)) @ R.T + [*place, z]
        seen = [rig.left.project(in_left), rig.right.project(rig.T_right_left.apply(in_left))]
        if all(((px > 2) & (px < np.array(rig.left.size_wh) - 3)).all() for px in seen):
            for kept, px in zip(pixels, seen, strict=True):
                kept.append(px)
    return [np.array(px) for px in pixels]


@pytest.mark.parametrize("widths", [3, 8, 15, 30])
def test_sound_sets_are_solved(widths):
    for seed in range(3):
        rng = np.random.default_rng([seed, widths])
        rig, distance = long_rig(rng, widths)
        left, right = (px + rng.normal(0, 0.15, px.shape) for px in views_of(rig, distance, 15, rng))
        calibration = calibrate(Detections.from_arrays(BOARD.object_points_m, left, right, (1280, 960)), model="brown4")
        T, truth = calibration.rig.T_right_left, rig.T_right_left
        error = np.concatenate([so3.log(T.R @ truth.R.T), T.t - truth.t])
        assert np.abs(error / [calibration.covariance.sigma[name] for name in NAMES]).max() < 3.5
        found = {f.code for f in calibration.findings}
        sigma_px = max(
            calibration.covariance.sigma[f"{side}.{axis}"] for side in ("left", "right") for axis in ("cx", "cy")
        )
        assert sigma_px < 0.05 * 1280
        if "principal-points-near-middle" not in found:
            assert sigma_px < 0.03 * 1280


def test_the_longest_lens_says_what_was_assumed():
    rng = np.random.default_rng(1)
    rig, distance = long_rig(rng, 25)
    left, right = (px + rng.normal(0, 0.25, px.shape) for px in views_of(rig, distance, 12, rng))
    detections = Detections.from_arrays(BOARD.object_points_m, left, right, (1280, 960))
    for model in ("brown4", "auto"):
        calibration = calibrate(detections, model=model)
        assert "principal-points-near-middle" in {f.code for f in calibration.findings}
    assert set(calibration.provenance["model_choice"]["held_out_row_rms_px"]) >= {"brown4", "brown5"}


@pytest.mark.parametrize("model", ["brown4", "brown5", "brown8"])
def test_a_step_of_the_principal_point_moves_corners_as_the_linear_step_does(model):
    """A shift by 60 px, compensated by a turn and the tangential terms, leaves the image where it was to 0.01 px; plainly 0.1."""
    width, f, k1 = 1920, 35000.0, 30.0
    parameters = np.zeros(camera_model(model).n_parameters)
    parameters[:6] = f, f, 960.0, 540.0, 0.0, k1
    shift = np.array([60.0, -35.0])
    step = np.zeros_like(parameters)
    step[2:4] = shift
    step[[8, 7]] = k1 * shift / f  # p2, p1
    x, y = np.meshgrid(np.linspace(-1, 1, 9) * width / 2 / f, np.linspace(-0.6, 0.6, 7) * width / 2 / f)
    ray = x.ravel(), y.ravel(), np.ones(x.size)
    turned = ray[0] - shift[0] / f, ray[1] - shift[1] / f, ray[2]
    project = camera_model(model).project
    before = np.array(project(parameters, *ray))

    def moved_px(after):
        difference = np.array(project(after, *turned)) - before
        return np.abs(difference - difference.mean(axis=1, keepdims=True)).max()

    assert moved_px(step_parameters(parameters, step)) < 0.3 * moved_px(parameters + step)


def test_steps_on_ordinary_lenses_are_plain_sums():
    parameters = np.array([800.0, 800, 320, 240, 0, -0.3, 0.1, 0.001, 0.001])
    step = np.linspace(0.1, 0.9, 9)
    np.testing.assert_array_equal(step_parameters(parameters, step), parameters + step)


def test_no_view_is_left_with_the_other_of_its_two_poses():
    """Three views ended so: a rig of good residuals whose focal lengths were off by 1.4 %, 47 standard deviations."""
    kind = "telephoto, 3 to 30 image widths"
    rig, detections = sound._noisy_set(kind, np.random.default_rng([4711, 14, len(kind)]))
    found = calibrate(detections, model="brown4")
    assert len(found.views) == 20 and not found.rejected
    assert np.abs(sound._standardised(found, rig)).max() < 3.5
