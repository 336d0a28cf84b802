"""Corners without noise give the truth back, whatever the board, the lens and the number of views."""

import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.cameras import CAMERA_MODELS
from binocal.simulation import StereoScene, random_rig, sample_board_poses, simulate_detections

SCENES = [
    ("chessboard:11x8:20mm", 3),
    ("charuco:9x7:30mm:22mm:DICT_5X5_50", 5),
    ("aprilgrid:5x4:40mm:0.3", 10),
    ("circles:9x8:25mm", 20),
    ("acircles:4x11:20mm", 6),
]


@pytest.mark.parametrize("scene", range(len(SCENES)))
@pytest.mark.parametrize("model", list(CAMERA_MODELS))
def test_exact_corners_give_every_parameter(model, scene):
    spec, n_views = SCENES[scene]
    rng = np.random.default_rng([scene, len(model)])
    has_skew = scene % 2 == 1
    rig, board = random_rig(rng, model, has_skew=has_skew), parse_board(spec)
    poses = sample_board_poses(rig, board, n_views, rng)
    detections = simulate_detections(StereoScene(rig, board, poses), rng)
    calibration = calibrate(detections, model=model, skew=has_skew)
    for camera, truth, T, T_true in (
        (calibration.rig.left, rig.left, calibration.evidence.T_left_board, poses),
        (
            calibration.rig.right,
            rig.right,
            calibration.rig.T_right_left @ calibration.evidence.T_left_board,
            rig.T_right_left @ poses,
        ),
    ):
        difference = camera.project(T.apply(board.object_points_m)) - truth.project(T_true.apply(board.object_points_m))
        assert np.nanmax(np.abs(difference)) < 1e-8  # measured 1e-12 px
        if model != "brown8":  # numerator and denominator of its distortion trade against each other
            relative = (camera.parameters - truth.parameters) / np.maximum(np.abs(truth.parameters), 1e-3)
            assert np.abs(relative).max() < 1e-8  # measured 1e-10
    if model != "brown8":
        error_m = calibration.rig.T_right_left.t - rig.T_right_left.t
        assert np.abs(error_m).max() < 1e-8 * rig.baseline_m
        assert np.abs(calibration.rig.T_right_left.R - rig.T_right_left.R).max() < 1e-8
