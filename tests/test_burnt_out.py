"""Paper that saturates makes corners lock to the pixels: rendered pairs to findings that name the cause."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from binocal import app
from binocal.boards import parse_board
from binocal.cameras import Camera, StereoRig
from binocal.detection.measuring.refinement import is_burnt_out
from binocal.geometry import SE3, so3
from binocal.simulation import RenderOptions, render_image

BOARD = parse_board("chessboard:9x6:20mm")
RIG = StereoRig(
    *(Camera("brown4", (480, 360), np.r_[520.0, 520.0, cx, 180.0, 0.0, -0.1, 0.02, 0.0, 0.0]) for cx in (241.0, 238.0)),
    SE3(np.eye(3), np.array([-0.02, 0.0, 0.0])),
    True,
)
TILTS = [(0.35, -0.2, 0.1), (-0.3, 0.35, 0.0), (0.1, 0.4, -0.1), (-0.4, -0.1, 0.2), (0.3, 0.3, 0.1), (0.0, -0.4, -0.2)]


def render_set(folder, of_right, of_left):
    """Pairs of images; left and right cameras have their own light."""
    points = BOARD.object_points_m
    for i, tilt in enumerate(TILTS):
        R = so3.exp(np.array(tilt))
        T_left_board = SE3(R, np.array([0.01, 0.0, 0.26]) - R @ points.mean(axis=0))
        sides = (
            ("left", RIG.left, T_left_board, of_left),
            ("right", RIG.right, RIG.T_right_left @ T_left_board, of_right),
        )
        for j, (side, camera, T, options) in enumerate(sides):
            shot = render_image(camera, T, BOARD, options, np.random.default_rng(2 * i + j))
            cv2.imwrite(str(folder / f"{side}{i}.png"), shot.image)


def test_saturated_paper_is_named_of_the_camera_whose_it_is(tmp_path):
    """Paper at 1.6 times the range and a sharp lens: without the finding's own cause it read "not resized or enlarged"."""
    render_set(tmp_path, RenderOptions(white_dn=410.0, blur_px=0.5, noise_dn=1.0), RenderOptions(noise_dn=1.0))
    run = app.calibrate_images(
        str(tmp_path / "left*"), str(tmp_path / "right*"), BOARD, app.CalibrationRequest("brown4")
    )
    (found,) = [found for found in run.calibration.findings if "pixels" in found.text]
    assert found.code == "corners-burnt-out" and found.figures["camera"] == "right"
    assert found.figures["images_percent"] == 100 and found.figures["period_px"] == 1
    assert "expose less" in found.text and "resized" not in found.text
    assert run.calibration.rig.baseline_m == pytest.approx(0.02, rel=0.01)


def test_white_paper_within_the_range_and_white_surroundings_are_not_burnt_out():
    points = BOARD.object_points_m
    T = SE3(np.eye(3), np.array([0.0, 0.0, 0.26]) - points.mean(axis=0))

    def look(**options):
        shot = render_image(RIG.left, T, BOARD, RenderOptions(**options), np.random.default_rng(0))
        return is_burnt_out(shot.image, shot.corners_px)

    assert look(white_dn=330.0) and not look(white_dn=210.0)
    assert not look(white_dn=210.0, background_dn=400.0)
