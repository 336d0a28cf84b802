from __future__ import annotations

import numpy as np

from binocal import calibrate
from binocal.boards import parse_board
from binocal.cameras import Camera
from binocal.evidence import Detections
from binocal.geometry import SE3
from binocal.geometry.homography import PlaneFrame
from binocal.geometry.so3 import exp
from binocal.initialization.distortion import estimate_lifting

BOARD = parse_board("charuco:19x26:5mm:4mm:DICT_4X4_250")  # 450 corners, of which a view shows a few
SIZE_WH = (1280, 960)


def part_of_a_board(rng, camera, poses, n_seen):
    """Pixels of a compact part of the board in each view, NaN elsewhere."""
    points = BOARD.object_points_m
    px = np.full((len(poses), len(points), 2), np.nan)
    for view, pose in enumerate(poses):
        seen = camera.project(pose.apply(points)) + rng.normal(0, 0.1, (len(points), 2))
        near = np.linalg.norm(points - points[rng.integers(len(points))], axis=1)
        kept = np.argsort(near, kind="stable")[:n_seen]
        inside = ((seen > 5) & (seen < np.array(SIZE_WH) - 5)).all(axis=1)
        px[view, kept] = np.where(inside[kept, None], seen[kept], np.nan)
    return px


def wide_rig(seed, n_views, n_seen):
    rng = np.random.default_rng(seed)
    points = BOARD.object_points_m
    f = np.hypot(*SIZE_WH) / 2 / np.radians(60)
    left = Camera("fisheye4", SIZE_WH, np.r_[f, f, 642, 478, 0, 0.02, -0.005, 0, 0])
    right = Camera("fisheye4", SIZE_WH, np.r_[f, f, 636, 481, 0, 0.02, -0.005, 0, 0])
    T_right_left = SE3(exp(np.array([0.01, 0.03, -0.01])), np.array([-0.04, 0.0, 0.001]))
    poses = []
    for _ in range(n_views):
        R = exp(rng.uniform(-0.6, 0.6, 3))
        poses.append(SE3(R, np.r_[rng.uniform(-0.05, 0.05, 2), rng.uniform(0.08, 0.14)] - R @ points.mean(axis=0)))
    pairs = (left, poses), (right, [T_right_left @ pose for pose in poses])
    return [part_of_a_board(rng, camera, of_camera, n_seen) for camera, of_camera in pairs], T_right_left


def test_the_profile_is_found_where_views_show_a_small_part_of_a_large_board():
    """Sixty points of 450 left a view three or four of its own: no homography, and no cost at all."""
    (left_px, _), _ = wide_rig(0, 12, 30)
    weights = np.isfinite(left_px[..., 0]).astype(float)
    u, v = np.nan_to_num(left_px[..., 0]), np.nan_to_num(left_px[..., 1])
    lifting = estimate_lifting(PlaneFrame.of(BOARD.object_points_m), u, v, weights, SIZE_WH)
    # equidistant, 60 degrees of half field: g = theta / tan(theta) = 1 - (theta r)^2 / 3 ...
    assert -0.7 < lifting.l1 < -0.2


def test_a_large_charuco_board_seen_in_part_calibrates_a_wide_lens():
    for seed in range(3):
        (left_px, right_px), T_right_left = wide_rig(seed, 14, 40)
        detections = Detections.from_arrays(BOARD.object_points_m, left_px, right_px, SIZE_WH)
        calibration = calibrate(detections, model="fisheye4")
        off = calibration.rig.baseline_m - np.linalg.norm(T_right_left.t)
        assert abs(off) < 3.5 * calibration.baseline_sigma_m


def test_a_view_beyond_every_candidates_horizon_spoils_no_cost():
    (left_px, _), _ = wide_rig(1, 6, 30)
    weights = np.isfinite(left_px[..., 0]).astype(float)
    weights[2] = 0.0
    weights[2, np.flatnonzero(np.isfinite(left_px[2, :, 0]))[:3]] = 1.0  # three corners have no homography
    u, v = np.nan_to_num(left_px[..., 0]), np.nan_to_num(left_px[..., 1])
    lifting = estimate_lifting(PlaneFrame.of(BOARD.object_points_m), u, v, weights, SIZE_WH)
    assert -0.7 < lifting.l1 < -0.2 and np.isfinite(lifting.sigma_centre).all()
