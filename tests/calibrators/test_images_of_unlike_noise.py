"""Images of unlike noise: sound sets calibrate in few steps, each image counts by its own noise, and images alike change nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from binocal import calibrate
from binocal.boards import parse_board
from binocal.calibrators import CalibrationRequest
from binocal.calibrators.joint import joint_problem
from binocal.evidence import Detections
from binocal.geometry import so3
from binocal.simulation import StereoScene, random_rig, sample_board_poses, simulate_detections
from binocal.solvers.board_views import BundleEstimate
from binocal.solvers.covariance import cramer_rao_bound
from binocal.solvers.image_noise import estimate_image_noise, shrink, with_image_noise
from binocal.solvers.whitening import corner_weights

N_VIEWS = 20
NAMES = [*(f"rotation.{axis}" for axis in "xyz"), *(f"translation.{axis}" for axis in "xyz")]


def noises(kind, rng):
    """Noise of each image, left then right."""
    if kind == "half":
        return np.tile(rng.permutation(np.repeat([0.05, 0.5], N_VIEWS // 2)), (2, 1))
    if kind == "half, low":
        return np.tile(rng.permutation(np.repeat([0.01, 0.06], N_VIEWS // 2)), (2, 1))
    if kind == "one camera":
        return np.repeat([[0.03], [0.4]], N_VIEWS, axis=1)
    return np.exp(rng.uniform(np.log(0.01), np.log(0.5), (2, N_VIEWS)))


def views(seed, kind, model="brown4", spec="chessboard:9x6:30mm"):
    rng = np.random.default_rng([seed, 3])
    rig, board = random_rig(rng, model), parse_board(spec)
    scene = StereoScene(rig, board, sample_board_poses(rig, board, N_VIEWS, rng))
    exact, sigma = simulate_detections(scene, rng), noises(kind, rng)
    left, right = (
        px + s[:, None, None] * rng.normal(size=px.shape)
        for px, s in zip((exact.left_px, exact.right_px), sigma, strict=True)
    )
    return scene, replace(exact, left_px=left, right_px=right), sigma


def with_covariances(detections, sigma):
    n = len(detections.object_points_m)
    left, right = (np.repeat(s[:, None, None, None] ** 2 * np.eye(2), n, axis=1) for s in sigma)
    return replace(detections, left_covariance_px2=left, right_covariance_px2=right)


def errors(calibration, rig):
    T, truth = calibration.rig.T_right_left, rig.T_right_left
    return np.concatenate([so3.log(T.R @ truth.R.T), T.t - truth.t])


@pytest.mark.parametrize("kind", ["half", "half, low", "one camera", "any"])
@pytest.mark.parametrize("is_known", [False, True])
def test_sound_sets_of_unlike_images_are_solved_in_few_steps(kind, is_known):
    iterations, scores = [], []
    for seed, model in enumerate(("brown4", "brown5", "fisheye4")):
        scene, detections, sigma = views(seed, kind, model)
        calibration = calibrate(with_covariances(detections, sigma) if is_known else detections, model=model)
        iterations.append(calibration.n_iterations)
        scores.append(errors(calibration, scene.rig) / [calibration.covariance.sigma[name] for name in NAMES])
        assert not calibration.rejected
        found = {f.code for f in calibration.findings}
        assert ("images-differ-in-noise" in found) == (not is_known)
        assert found <= {"images-differ-in-noise", "rests-on-few-views", "lens-model-folds"}
    assert np.median(iterations) <= 12  # 8 to 10; alike weights took 28 to 100, and a third of the sets was refused
    assert np.abs(scores).max() < 3.5


@pytest.mark.slow
def test_errors_sit_on_the_bound_of_known_noise():
    # 60 rigs x 6 figures: the RMS scatters by 5 %; measured 1.02 and coverage 69 and 96 %
    ratios, scores = [], []
    for seed in range(60):
        scene, detections, sigma = views(seed, "any")
        weights = corner_weights(with_covariances(detections, sigma))
        seen = {"left_is_seen": detections.left_is_seen, "right_is_seen": detections.right_is_seen}
        points, T = scene.board.object_points_m, scene.T_left_board
        bound = cramer_rao_bound(scene.rig, points, T, weights.unit_px, weights=weights, **seen).sigma
        calibration = calibrate(detections, model="brown4")
        ratios.append(errors(calibration, scene.rig) / [bound[name] for name in NAMES])
        scores.append(errors(calibration, scene.rig) / [calibration.covariance.sigma[name] for name in NAMES])
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1.0, abs=0.15)
    assert np.mean(np.abs(scores) < 1) == pytest.approx(0.683, abs=0.07)


@pytest.mark.parametrize("spec", ["chessboard:5x4:60mm", "chessboard:11x8:25mm"])
def test_the_noise_of_images_is_found_from_a_rough_solution(spec):
    scene, detections, sigma = views(1, "any", spec=spec)
    problem = joint_problem(detections, CalibrationRequest(model="brown4"))
    truth = BundleEstimate.of_rig(scene.rig, scene.T_left_board)
    rough = tuple(values * 1.01 for values in truth.parameters)
    found = estimate_image_noise(problem, replace(truth, parameters=rough))
    many = len(detections.object_points_m) > 50
    assert np.median(np.abs(np.log(found.sigma_px / sigma))) < (0.1 if many else 0.3)
    assert shrink(found.sigma_px, found.freedom) is not None


def test_corners_far_off_do_not_make_an_image_noisy():
    scene, detections, _ = views(2, "one camera")
    left = detections.left_px.copy()
    left[3, 10] += 40.0
    problem = joint_problem(replace(detections, left_px=left), CalibrationRequest(model="brown4"))
    found = estimate_image_noise(problem, BundleEstimate.of_rig(scene.rig, scene.T_left_board))
    assert found.sigma_px[0, 3] == pytest.approx(0.03, rel=0.3)


def test_a_view_that_contradicts_the_others_does_not_pass_for_a_noisy_one():
    rng = np.random.default_rng(4)
    rig, board = random_rig(rng), parse_board("chessboard:9x6:30mm")
    scene = StereoScene(rig, board, sample_board_poses(rig, board, N_VIEWS, rng))
    detections = simulate_detections(scene, rng, noise_px=0.1)
    right = detections.right_px.copy()
    right[7] += [30.0, 20.0]
    calibration = calibrate(replace(detections, right_px=right), model="brown4")
    assert [view.name for view in calibration.rejected] == [detections.names[7]]


def test_images_that_are_alike_are_left_alone():
    rng = np.random.default_rng(5)
    rig, board = random_rig(rng), parse_board("chessboard:9x6:30mm")
    scene = StereoScene(rig, board, sample_board_poses(rig, board, N_VIEWS, rng))
    detections = simulate_detections(scene, rng, noise_px=0.2)
    problem = joint_problem(detections, CalibrationRequest(model="brown4"))
    truth = BundleEstimate.of_rig(rig, scene.T_left_board)
    same = with_image_noise(detections, problem, truth, problem.residual_lengths2(truth))
    assert isinstance(same, Detections) and same is detections
    given = calibrate(detections, model="brown4").provenance["corner_weights"]
    assert given == {"covariances": False, "image_noise": False, "misfit_px": 0.0}


def test_few_images_or_few_corners_say_nothing():
    assert shrink(np.array([0.01, 1.0, np.nan]), np.array([90.0, 90.0, 0.0])) is None
    sigma = np.full(20, 0.1)
    sigma[0] = 0.13  # by chance
    assert shrink(sigma, np.full(20, 80.0)) is None


@pytest.mark.parametrize(("seed", "low_px", "n_high"), [(245, 0.05, 7), (257, 0.03, 3)])
def test_models_are_compared_with_each_image_weighed_by_its_own_noise(seed, low_px, n_high):
    """With all corners alike no Brown model came to a minimum here, and fisheye4 was taken, 15 and 5 standard deviations off."""
    n_views, rng = 14, np.random.default_rng([9, seed])
    rig, board = random_rig(rng, "brown4"), parse_board("chessboard:9x6:30mm")
    exact = simulate_detections(StereoScene(rig, board, sample_board_poses(rig, board, n_views, rng)), rng)
    sigma = rng.permutation(np.r_[np.full(n_views - n_high, low_px), np.full(n_high, 0.5)])[:, None, None]
    left, right = (px + sigma * rng.normal(size=px.shape) for px in (exact.left_px, exact.right_px))
    calibration = calibrate(replace(exact, left_px=left, right_px=right), model="auto")
    choice = calibration.provenance["model_choice"]
    assert calibration.rig.left.model == "brown4" and not choice["failures"], choice["reason"]
    stated = [calibration.covariance.sigma[name] for name in NAMES]
    assert np.abs(errors(calibration, rig) / stated).max() < 4
