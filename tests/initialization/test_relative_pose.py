from __future__ import annotations

import numpy as np
import pytest
from simulated_rigs import Rig, rotation_error_deg, simulate

from binocal.geometry import SE3, so3
from binocal.initialization.poses import BoardPoses, estimate_poses
from binocal.initialization.relative_pose import estimate_relative_pose
from binocal.initialization.symmetries import board_symmetries

VERGENT = SE3(so3.exp(np.array([0.02, 0.35, 0.03])), np.array([-0.3, 0.01, 0.05]))
VERTICAL = SE3(so3.exp(np.array([0.05, 0.01, 0.0])), np.array([0.002, -0.08, 0.0]))


def _poses(rig: Rig, left: np.ndarray | None = None, right: np.ndarray | None = None) -> tuple[BoardPoses, BoardPoses]:
    return (
        estimate_poses(rig.model, rig.parameters, rig.points, rig.left_px if left is None else left),
        estimate_poses(rig.model, rig.parameters, rig.points, rig.right_px if right is None else right),
    )


@pytest.mark.parametrize("T", [None, VERGENT, VERTICAL])
def test_clean_views_agree_on_the_rig(T: SE3 | None) -> None:
    rig = simulate(0) if T is None else simulate(0, T_right_left=T, tilt_deg=(5, 30))
    result = estimate_relative_pose(*_poses(rig))
    assert result.agrees.all()
    assert rotation_error_deg(result.T_right_left.R, rig.T_right_left.R) < 0.02  # measured 0.002 to 0.006
    np.testing.assert_allclose(result.T_right_left.t, rig.T_right_left.t, atol=3e-4)
    assert np.median(result.miss_px) == pytest.approx(0.28, rel=0.1)
    assert np.median(rotation_error_deg(result.R_left_board, rig.T_left_board.R)) < 0.1


def test_exact_views_give_the_exact_rig() -> None:
    rig = simulate(1, noise_px=0.0)
    result = estimate_relative_pose(*_poses(rig))
    assert rotation_error_deg(result.T_right_left.R, rig.T_right_left.R) < 1e-4
    np.testing.assert_allclose(result.T_right_left.t, rig.T_right_left.t, atol=1e-6)


def test_a_minority_of_mismatched_pairs_is_outvoted() -> None:
    rig = simulate(2)
    right = rig.right_px.copy()
    right[:8] = np.roll(right[:8], 1, axis=0)
    result = estimate_relative_pose(*_poses(rig, right=right))
    assert not result.agrees[:8].any() and result.agrees[8:].all()
    assert rotation_error_deg(result.T_right_left.R, rig.T_right_left.R) < 0.02


def test_reversed_corner_orders_are_found() -> None:
    rig = simulate(3)
    left = rig.left_px.copy()
    left[::3] = left[::3, ::-1]
    symmetries = board_symmetries(rig.points)
    result = estimate_relative_pose(*_poses(rig, left=left), symmetries.motions)
    assert result.agrees.all()
    assert [symmetries.names[k] for k in result.symmetry[:4]] == ["reversed (180 deg)", "", "", "reversed (180 deg)"]
    assert rotation_error_deg(result.T_right_left.R, rig.T_right_left.R) < 0.02


def test_views_of_one_camera_are_carried_along() -> None:
    rig = simulate(4)
    left, right = rig.left_px.copy(), rig.right_px.copy()
    left[0], right[1] = np.nan, np.nan
    result = estimate_relative_pose(*_poses(rig, left, right))
    assert result.symmetry[:2].tolist() == [-1, -1]
    assert rotation_error_deg(result.R_left_board[:2], rig.T_left_board.R[:2]).max() < 1.0
    np.testing.assert_allclose(result.t_left_board[:2], rig.T_left_board.t[:2], atol=5e-3)


def test_without_a_pair_there_is_no_consensus() -> None:
    rig = simulate(5, 4)
    left, right = rig.left_px.copy(), rig.right_px.copy()
    left[:2], right[2:] = np.nan, np.nan
    with pytest.raises(ValueError, match="no view has both images"):
        estimate_relative_pose(*_poses(rig, left, right))
