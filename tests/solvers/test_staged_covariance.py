"""What stages make of corner errors, against small changes of real corners and against truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import binocal
from binocal.calibrators.base import CalibrationRequest
from binocal.calibrators.staged import diagnosed_views, solve_camera
from binocal.errors import DegenerateGeometryError
from binocal.geometry import so3
from binocal.simulation import StereoScene, random_rig, sample_board_poses, simulate_detections
from binocal.solvers.staged_covariance import influence_of_corners
from contracts import BOARD, make_corners

REQUEST = CalibrationRequest("brown4")


def errors(calibration, rig):
    """Estimate minus truth, in the covariance's order."""
    found = []
    for side in ("left", "right"):
        difference = getattr(calibration.rig, side).parameters - getattr(rig, side).parameters
        found.append(np.delete(difference, 4))
    turn = so3.log(calibration.rig.T_right_left.R @ rig.T_right_left.R.T)
    return np.concatenate([*found, turn, calibration.rig.T_right_left.t - rig.T_right_left.t])


def test_influence_is_what_a_moved_corner_does():
    evidence = make_corners(6, noise_px=0.02)
    stage, _, _ = solve_camera(diagnosed_views(evidence, REQUEST), 0, REQUEST)
    to_parameters, _, _ = influence_of_corners(stage, evidence.object_points_m)
    step_px = 0.01  # beside 0.02 px of noise no corner loses its weight; second order is 1e-4 of the change
    for view, corner in ((0, 3), (4, 80)):
        px = evidence.left_px.copy()
        px[view, corner, 1] += step_px
        moved, _, _ = solve_camera(diagnosed_views(replace(evidence, left_px=px), REQUEST), 0, REQUEST)
        change = (moved.parameters - stage.parameters)[stage.is_free] / step_px
        expected = to_parameters[view, :, 2 * corner + 1]
        assert np.abs(change - expected).max() < 0.02 * np.abs(expected).max()  # 0.004 measured


@pytest.mark.parametrize("name", ["opencv", "absolute-orientation"])
def test_errors_are_as_large_as_stated(name):
    # 30 rigs: the mean of e' C^-1 e / 22 scatters by sqrt(2 / (22 * 30)) = 0.055; 0.96 and 0.98 over 60 rigs, measured
    scores = []
    for seed in range(30):
        rng = np.random.default_rng([7, seed])
        rig = random_rig(rng, size_wh=(640, 480))
        scene = StereoScene(rig, BOARD, sample_board_poses(rig, BOARD, 10, rng))
        made = binocal.calibrate(simulate_detections(scene, rng, noise_px=0.15), calibrator=name, model="brown4")
        e = errors(made, rig)
        scores.append(e @ np.linalg.solve(made.covariance.matrix, e) / len(e))
    assert 0.8 < np.mean(scores) < 1.2


def test_views_that_disagree_widen_it():
    rng = np.random.default_rng(3)
    evidence = make_corners(16, noise_px=0.1)
    shift = rng.normal(0, 1.0, (16, 1, 2))  # of the right images against the left: exposures of other moments
    apart = replace(evidence, right_px=evidence.right_px + shift)
    one, other = (binocal.calibrate(e, calibrator="opencv", model="brown4") for e in (evidence, apart))
    factor = [made.provenance["views_in_common"]["sigma_factor"] for made in (one, other)]
    assert factor[0] < 1.1 and factor[1] > 2.0
    assert other.covariance.sigma["rotation.x"] > 3 * one.covariance.sigma["rotation.x"]


def test_a_camera_that_the_views_do_not_tell_is_refused():
    evidence = make_corners(6)
    stage, _, _ = solve_camera(diagnosed_views(evidence, REQUEST), 0, REQUEST)
    T = stage.T_camera_board
    same = replace(stage, T_camera_board=type(T)(np.repeat(np.eye(3)[None], 6, 0), np.repeat([[0, 0, 0.5]], 6, 0)))
    with pytest.raises(DegenerateGeometryError, match=r"parameters undetermined"):
        influence_of_corners(same, evidence.object_points_m)
