from __future__ import annotations

import numpy as np
import pytest
from simulated_rigs import TABLE2, rotation_error_deg, simulate

from binocal.geometry import SE3, so3
from binocal.initialization.poses import estimate_pose_candidates, estimate_poses
from binocal.initialization.relative_pose import transfer_px

FISHEYE_220 = np.array([285, 285, 635, 486, 0, 0.02, -0.005, 0.001, 0])


@pytest.mark.parametrize(("model", "parameters"), [("brown4", TABLE2), ("fisheye4", FISHEYE_220)])
def test_exact_views_give_exact_poses_even_behind_the_image_plane(model: str, parameters: np.ndarray) -> None:
    rig = simulate(0, model=model, parameters=parameters, noise_px=0.0)
    poses = estimate_poses(model, parameters, rig.points, rig.left_px)
    assert poses.is_usable.all()
    assert rotation_error_deg(poses.R, rig.T_left_board.R).max() < 1e-4  # measured 1e-6
    np.testing.assert_allclose(poses.t, rig.T_left_board.t, atol=1e-6)
    assert poses.rms_px.max() < 1e-3


def test_the_quadratic_form_predicts_pixels() -> None:
    rig = simulate(0)
    left = estimate_poses("brown4", TABLE2, rig.points, rig.left_px)
    right = estimate_poses("brown4", TABLE2, rig.points, rig.right_px)
    assert np.median(left.rms_px) == pytest.approx(0.2 * np.sqrt(2), rel=0.1)
    assert np.max(transfer_px(rig.T_right_left, left, right, SE3.identity())) < 1.0
    shifted = SE3(np.eye(3), np.array([0.02, 0, 0]))  # one column: the spacing in the image is 30 to 90 px
    assert np.min(transfer_px(rig.T_right_left, left, right, shifted)) > 15


def test_far_boards_have_two_candidates_and_the_better_comes_first() -> None:
    rig = simulate(3, tilt_deg=(15, 30), distance_m=(4, 6), noise_px=0.1)
    first, second = estimate_pose_candidates("brown4", TABLE2, rig.points, rig.left_px)
    assert np.all(first.rms_px <= second.rms_px + 1e-6)
    best = np.minimum(rotation_error_deg(first.R, rig.T_left_board.R), rotation_error_deg(second.R, rig.T_left_board.R))
    assert np.median(best) < 6
    distinct = np.degrees(so3.angle_rad(np.swapaxes(first.R, -1, -2) @ second.R)) > 10
    assert distinct.sum() > 5  # where the second valley exists, it was found and differs
    assert (
        np.median(second.rms_px[distinct] / first.rms_px[distinct]) < 2
    )  # and fits almost alike: that is the ambiguity


def test_a_view_with_three_corners_has_no_pose() -> None:
    rig = simulate(0, 3)
    px = rig.left_px.copy()
    px[1, 3:] = np.nan
    poses = estimate_poses("brown4", TABLE2, rig.points, px)
    assert poses.is_usable.tolist() == [True, False, True]
    assert np.isnan(poses.R[1]).all() and np.isnan(poses.rms_px[1])
