"""Paper that saturates: rendered pairs to a rig whose errors are as stated, with nothing to warn of."""

from __future__ import annotations

import cv2
import numpy as np

from binocal import app
from binocal.boards import parse_board
from binocal.cameras import Camera, StereoRig
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


def test_a_sharp_image_of_clipped_paper_gives_the_rig_and_no_warning(tmp_path):
    """Paper at 1.6 times the range: without clipping in the corners' model they lock to the pixels and are up to 0.06 px off."""
    render_set(tmp_path, RenderOptions(white_dn=410.0, blur_px=0.5, noise_dn=1.0), RenderOptions(noise_dn=1.0))
    run = app.calibrate_images(
        str(tmp_path / "left*"), str(tmp_path / "right*"), BOARD, app.CalibrationRequest("brown4")
    )
    calibration = run.calibration
    assert not [found.code for found in calibration.findings if "pixels" in found.text]
    assert calibration.n_iterations <= 12
    sigma = calibration.covariance.sigma
    error = calibration.rig.T_right_left.t - RIG.T_right_left.t
    assert np.abs(error / [sigma[f"translation.{axis}"] for axis in "xyz"]).max() < 3.5
    error = calibration.rig.right.parameters[:4] - RIG.right.parameters[:4]
    assert np.abs(error / [sigma[f"right.{name}"] for name in ("fx", "fy", "cx", "cy")]).max() < 3.5
    assert calibration.rms.right_px < 0.006
