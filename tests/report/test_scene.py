"""The rig in 3-D: cameras and boards where they are, in the left camera's frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.cameras import Camera
from binocal.report.scene import board_corners, rig_scene
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig

RIG, BOARD = table2_rig(), parse_board("chessboard:6x5:30mm")


@pytest.fixture(scope="module")
def calibration():
    rng = np.random.default_rng(3)
    scene = StereoScene(RIG, BOARD, sample_board_poses(RIG, BOARD, 6, rng))
    return calibrate(
        simulate_detections(scene, rng, noise_px=0.05), model="brown4", calibrator="lm", board_shape="flat"
    )


def test_outlines_are_seen_where_they_lie(calibration):
    scene = rig_scene(calibration, BOARD.object_points_m)
    left, right = scene.cameras
    assert np.linalg.norm(right.centre - left.centre) == pytest.approx(calibration.rig.baseline_m)
    # the corner of what the right camera sees is the corner of its image
    px = calibration.rig.right.project(calibration.rig.T_right_left.apply(right.outline))
    assert np.abs(px[0]).max() < 1e-3
    first = calibration.corners.detections
    px = calibration.rig.left.project(scene.boards[0].outline)
    assert np.linalg.norm(px[0] - first.left_px[0, 0]) < 2  # a noise of 0.05 px, at most
    assert scene.unit == "m" and not any(board.is_suggested for board in scene.boards)
    document = scene.document()
    assert len(document["boards"]) == 6 and document["cameras"][0]["at"] == [0.0, 0.0, 0.0]


def test_without_a_board_there_are_cameras(calibration):
    assert rig_scene(calibration, None).boards == ()


def test_a_lens_that_sees_aside_is_drawn_on_a_sphere(calibration):
    wide = Camera("fisheye4", (640, 480), np.array([200.0, 200, 319.5, 239.5, 0, 0, 0, 0, 0]))
    rig = replace(calibration.rig, left=wide)
    outline = rig_scene(replace(calibration, rig=rig, evidence=None), None).cameras[0].outline
    assert np.ptp(np.linalg.norm(outline, axis=-1)) < 1e-9


def test_the_corners_of_a_board_hold_its_points():
    corners = board_corners(BOARD.object_points_m)
    assert np.ptp(corners, axis=0) == pytest.approx(np.ptp(BOARD.object_points_m, axis=0))
