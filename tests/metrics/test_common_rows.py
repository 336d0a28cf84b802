"""The row error that views have in common: its size and p-value, where the rig is right and where it has turned."""

from dataclasses import replace

import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.geometry import SE3, so3
from binocal.metrics.common_rows import common_rows
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig

RIG, BOARD = table2_rig(), parse_board("chessboard:6x5:30mm")


def seen(n_views, seed, apart_m=0.0):
    rng = np.random.default_rng([n_views, seed])
    poses = sample_board_poses(RIG, BOARD, n_views, rng)
    left = simulate_detections(StereoScene(RIG, BOARD, poses), rng, noise_px=0.2)
    later = SE3(poses.R, poses.t + rng.normal(0, apart_m, (n_views, 3)))
    return replace(left, right_px=simulate_detections(StereoScene(RIG, BOARD, later), rng, noise_px=0.2).right_px)


@pytest.mark.parametrize(("n_views", "apart_m"), [(5, 0.0), (9, 3e-4)])
def test_the_p_value_is_that_of_chance(n_views, apart_m):
    p = np.array([common_rows(RIG, seen(n_views, seed, apart_m)).p_value for seed in range(40)])
    assert 0.3 < np.mean(p < 0.5) < 0.7 and np.mean(p < 0.05) < 0.15 and p.min() > 1e-4


@pytest.mark.parametrize("turn_deg", [(0.05, 0, 0), (0, 0, 0.2)])
def test_a_turn_of_a_camera_shows_in_all_views_alike(turn_deg):
    T = RIG.T_right_left
    turned = replace(RIG, T_right_left=SE3(so3.exp(np.radians(turn_deg)) @ T.R, T.t))
    found = common_rows(turned, seen(10, 0))
    assert found.is_off and found.finding.code == "rows-off"
    assert found.common_px > 3 * found.rest_px  # 1.4 against 0.3 px
    right = common_rows(RIG, seen(10, 0))
    assert not right.is_off and right.finding is None and right.common_px < 0.05


def test_few_views_tell_nothing_and_unsynchronised_ones_say_so():
    assert common_rows(RIG, seen(3, 0)) is None
    T = RIG.T_right_left
    turned = replace(RIG, T_right_left=SE3(so3.exp(np.radians([0.01, 0, 0])) @ T.R, T.t))
    apart = common_rows(turned, seen(6, 0, apart_m=2e-3))
    assert apart.common_px > 1 and apart.p_value > 0.01 and not apart.is_off  # each view is off by another amount
