"""What is compared between two halves, each against a case worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from binocal.benchmark.halves import (
    Estimate,
    baseline_sigma_without_board_scale,
    depth_scores,
    differences,
    differences_by_split,
    held_out_rows,
    rms,
    split_halves,
    stated_sigmas,
    summarise_depth,
    summarise_z,
    z_scores,
)
from binocal.calibrators import calibrate
from binocal.cameras import Camera, StereoRig
from binocal.evidence import Detections
from binocal.geometry import SE3, so3
from binocal.metrics.image import row_differences
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig

FOCAL_PX, BASELINE_M = 800.0, 0.1


def ideal_rig(*, focal_px=FOCAL_PX, turn_rad=(0.0, 0.0, 0.0), t_m=(-BASELINE_M, 0.0, 0.0), right=None):
    """Two cameras without distortion, 640x480, side by side."""
    centre = (319.5, 239.5)
    left = Camera("brown4", (640, 480), np.r_[focal_px, focal_px, centre, np.zeros(5)])
    return StereoRig(left, left if right is None else right, SE3(so3.exp(np.array(turn_rad)), np.array(t_m)))


def seen_by(rig, shift_px=(0.0, 0.0)):
    """Three points in two views, as the rig sees them; the right corners of the second view are shifted."""
    points = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]])
    in_left = np.stack([points + [0.0, 0.0, z] for z in (0.8, 1.2)])
    right = rig.right.project(rig.T_right_left.apply(in_left)) + np.array([np.zeros(2), shift_px])[:, None]
    return Detections.from_arrays(points, rig.left.project(in_left), right, (640, 480))


def test_halves_are_disjoint_complete_and_repeatable():
    used = np.array([0, 2, 3, 5, 6, 7, 9])
    splits = split_halves(10, used, 4, (1, 2))
    for a, b in splits:
        assert len(a) == 3 and len(b) == 4 and sorted([*a, *b]) == list(range(7))
    again = split_halves(10, used, 4, (1, 2))
    assert all(np.array_equal(x, y) for s, t in zip(splits, again, strict=True) for x, y in zip(s, t, strict=True))
    other = split_halves(10, used, 4, (1, 3))
    assert any(not np.array_equal(x, y) for s, t in zip(splits, other, strict=True) for x, y in zip(s, t, strict=True))


def test_a_view_less_moves_one_view_to_the_other_half_at_most():
    every = np.arange(20)
    for (a, _), (c, _) in zip(split_halves(20, every, 6, (0,)), split_halves(20, every[1:], 6, (0,)), strict=True):
        assert len(set(a) - {0} - set(every[1:][c])) <= 1


def test_differences_are_first_minus_second_in_the_order_of_the_groups():
    moved = Camera("brown4", (640, 480), np.r_[802.0, 797.0, 320.5, 235.5, np.zeros(5)])
    a = ideal_rig(turn_rad=(0.0, 0.003, 0.0), t_m=(-0.102, 0.0, 0.0), right=moved)
    expected = [0.002, 0.0, 0.003, 0.0, 0.0, 0.0, 2.0, -3.0, 0.0, 0.0, 1.0, -4.0]
    assert differences(a, ideal_rig()) == pytest.approx(expected, abs=1e-12)


def test_differences_of_a_split_whose_half_failed_are_nan():
    a = ideal_rig(focal_px=801.0, turn_rad=(0.0, np.radians(0.3), np.radians(0.4)), t_m=(-0.102, 0.0, 0.0))
    good, b = Estimate(a), Estimate(ideal_rig(t_m=(-0.098, 0.0, 0.0)))
    found = differences_by_split([(good, b), (good, Estimate(failure="no minimum"))])
    assert found["rotation_deg"][0] == pytest.approx(0.5) and found["baseline_percent"][0] == pytest.approx(4.0)
    assert found["focal_centre_px"][0] == pytest.approx(np.sqrt(0.5))  # four of eight differ by 1 px
    assert all(np.isnan(values[1]) for values in found.values())
    assert rms(found["baseline_percent"]) == pytest.approx(4.0) and np.isnan(rms(np.array([np.nan])))


def test_rows_of_the_right_rig_agree_and_a_shift_is_found():
    rig = ideal_rig(turn_rad=(0.02, -0.1, 0.03))
    assert np.abs(row_differences(rig, seen_by(rig))).max() < 1e-9
    straight = ideal_rig()
    found = held_out_rows(straight, seen_by(straight, (5.0, 0.3)))  # one of two views by 0.3 px
    assert found.rms_px == pytest.approx(0.3 / np.sqrt(2)) and found.median_view_px == pytest.approx(0.15)
    assert found.n_without_ray == 0


def test_rows_see_a_roll_that_the_corners_do_not_have():
    rig, rolled = ideal_rig(), ideal_rig(turn_rad=(0.001, 0.0, 0.0))  # f * angle = 0.8 px at the image's centre
    assert abs(row_differences(rolled, seen_by(rig))[0, 0]) == pytest.approx(0.8, rel=1e-3)


def test_cameras_one_above_the_other_are_compared_by_columns():
    rig = ideal_rig(t_m=(0.0, -BASELINE_M, 0.0))
    assert held_out_rows(rig, seen_by(rig, (0.3, 5.0))).median_view_px == pytest.approx(0.15)


def test_rows_skip_corners_of_one_camera_and_count_those_without_a_ray():
    strong = Camera("brown4", (640, 480), np.r_[FOCAL_PX, FOCAL_PX, 319.5, 239.5, 0.0, -2.0, 0.0, 0.0, 0.0])
    rig = ideal_rig(right=strong)  # its radius ends at 1 / sqrt(6) * 2 / 3 of the focal length: 218 px
    seen = seen_by(ideal_rig())
    right = seen.right_px.copy()
    right[0, 1], right[1, 2] = np.nan, (639.0, 479.0)
    detections = Detections.from_arrays(seen.object_points_m, seen.left_px, right, (640, 480))
    assert held_out_rows(rig, detections).n_without_ray == 1


def test_a_rig_that_cannot_be_rectified_has_no_rows():
    found = held_out_rows(ideal_rig(t_m=(0.0, 0.0, -0.1)), seen_by(ideal_rig()))
    assert np.isnan(found.rms_px) and np.isnan(found.median_view_px)


def test_scores_are_differences_over_the_sigma_of_the_difference():
    a, b = ideal_rig(t_m=(-0.105, 0.0, 0.0)), ideal_rig()
    sigma = np.full(12, 0.003), np.full(12, 0.004)
    pairs = [(Estimate(a, sigma[0]), Estimate(b, sigma[1])), (Estimate(a, sigma[0]), Estimate(failure="none"))]
    scores = z_scores(pairs)
    assert scores.shape == (1, 12) and scores[0, 0] == pytest.approx(1.0) and np.all(scores[0, 1:] == 0)


def test_shares_and_rms_of_scores():
    scores = np.zeros((2, 12))
    scores[:, 0], scores[0, 1:4], scores[1, 1:4] = [3.0, -4.0], [0.5, -1.5, np.nan], [2.5, 0.0, 0.0]
    summary = summarise_z(scores)
    assert summary["baseline"] == {"rms": pytest.approx(np.sqrt(12.5)), "within_1": 0.0, "within_2": 0.0, "n": 2}
    rotation = summary["rotation"]
    assert (
        rotation["n"] == 5 and rotation["within_1"] == pytest.approx(0.6) and rotation["within_2"] == pytest.approx(0.8)
    )
    assert rotation["rms"] == pytest.approx(np.sqrt((0.25 + 2.25 + 6.25) / 5))
    assert summary["all"]["n"] == 23 and summary["all"]["within_2"] == pytest.approx(20 / 23)
    assert np.isnan(summarise_z(np.zeros((0, 12)))["all"]["rms"])


def test_depth_scores_are_those_of_the_same_pixels_through_both_rigs():
    from dataclasses import replace

    from binocal.boards import parse_board

    rng, rig, board = np.random.default_rng(4), table2_rig(), parse_board("chessboard:8x6:25mm")
    scene = StereoScene(rig, board, sample_board_poses(rig, board, 8, rng))
    calibration = calibrate(simulate_detections(scene, rng, noise_px=0.1), model="brown4")
    T = calibration.rig.T_right_left
    longer = replace(
        calibration, rig=replace(calibration.rig, T_right_left=SE3(T.R, 1.01 * T.t))
    )  # all depths 1 % more
    a, b = (Estimate(c.rig, calibration=c) for c in (calibration, longer))
    (z,) = depth_scores([(a, b), (a, Estimate(failure="none"))])
    assert np.all(z > 0) and len(z) > 200
    told = calibration.depth_sigma(float(np.median(np.linalg.norm(calibration.T_left_board.t, axis=1))))
    assert 0.01 / (np.sqrt(2) * told.calibration_m / told.depth_m) == pytest.approx(z[: len(z) // 2].max(), rel=0.2)
    assert summarise_depth([np.array([1.0, 1.0]), np.array([0.0])])["rms"] == pytest.approx(np.sqrt(0.5))
    assert np.isnan(summarise_depth([])["rms"])


def test_stated_sigmas_stand_in_the_order_of_the_groups():
    rng, rig = np.random.default_rng(4), table2_rig()
    from binocal.boards import parse_board

    board = parse_board("chessboard:8x6:25mm")
    scene = StereoScene(rig, board, sample_board_poses(rig, board, 8, rng))
    calibration = calibrate(simulate_detections(scene, rng, noise_px=0.1), model="brown4")
    sigma = calibration.covariance.sigma
    names = ["rotation.x", "rotation.y", "rotation.z", "left.fx", "left.fy", "right.fx", "right.fy"]
    names += ["left.cx", "left.cy", "right.cx", "right.cy"]
    assert stated_sigmas(calibration)[1:] == pytest.approx([sigma[name] for name in names])
    assert stated_sigmas(calibration)[0] == baseline_sigma_without_board_scale(calibration) > 0
