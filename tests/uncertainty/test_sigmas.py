"""Stated uncertainty is true: over simulated rigs, over what a file carries, and for what asks too much."""

from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import TypeCheckError

from binocal.benchmark.uncertainty_cases import CASES, simulate_case, standardised_errors
from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.errors import DataError
from binocal.formats import rig_json
from binocal.simulation.noise import simulate_detections
from binocal.simulation.rigs import table2_rig
from binocal.simulation.scenes import StereoScene, sample_board_poses
from binocal.uncertainty import MeanBoardPose
from rigs import make_calibration

RIG, BOARD = table2_rig(), parse_board("chessboard:6x5:30mm")


@pytest.fixture(scope="module")
def calibration():
    rng = np.random.default_rng(3)
    scene = StereoScene(RIG, BOARD, sample_board_poses(RIG, BOARD, 12, rng))
    return calibrate(simulate_detections(scene, rng, noise_px=0.1), model="brown4", calibrator="lm")


@pytest.mark.usefixtures("many_calls")
def test_errors_are_as_large_as_stated():
    """30 rigs of 10 views; errors of one rig hang together, so a figure's shares scatter by 4 and 1.6 %, all figures' by 2 and 1."""
    case = replace(CASES["20 views"], n_views=10)
    pooled: dict[str, list[np.ndarray]] = {}
    for index in range(30):
        drawn = simulate_case(case, np.random.default_rng([7, index]))
        made = calibrate(drawn.detections, model="brown4", calibrator="lm")
        for figure, z in standardised_errors(drawn, made).items():
            pooled.setdefault(figure, []).append(z)
    assert set(pooled) >= {"left projection", "right projection at infinity", "depth at 1 m", "rows"}
    for figure, parts in pooled.items():
        z = np.abs(np.concatenate(parts))
        assert np.mean(z < 1) == pytest.approx(0.683, abs=0.13), figure
        assert np.mean(z < 2) == pytest.approx(0.954, abs=0.06), figure
    z = np.abs(np.concatenate([part for parts in pooled.values() for part in parts]))
    assert np.mean(z < 1) == pytest.approx(0.683, abs=0.06) and np.mean(z < 2) == pytest.approx(0.954, abs=0.03)


def test_projection_does_not_depend_on_how_far_the_boards_poses_and_the_camera_turn_together(calibration):
    # a principal point off by a pixel is nearly a turn: with the boards it is hardly seen, alone it is the whole of it
    sigma = calibration.covariance.sigma
    told = calibration.projection_sigma_px("left", np.array([640.0, 480.0]))
    assert told < 0.3 * np.hypot(sigma["left.cx"], sigma["left.cy"])


def test_uncertainty_grows_outside_what_the_boards_covered():
    rng = np.random.default_rng(5)
    scene = StereoScene(RIG, BOARD, sample_board_poses(RIG, BOARD, 30, rng))
    detections = simulate_detections(scene, rng, noise_px=0.1)
    is_left = detections.left_px[..., :1] < 700
    one_sided = replace(detections, left_px=np.where(is_left, detections.left_px, np.nan))
    made = calibrate(one_sided, model="brown4", calibrator="lm")
    inside, outside = made.projection_sigma_px("left", np.array([[300.0, 480.0], [1250.0, 480.0]]))
    assert outside > 2 * inside  # measured: 2.6


def test_a_file_carries_all_of_it(calibration, tmp_path):
    path = tmp_path / "rig.json"
    rig_json.write_calibration(path, calibration)
    back = rig_json.read_calibration(path)
    px = np.array([[0.0, 0.0], [640.0, 480.0]])
    for side in ("left", "right"):
        np.testing.assert_array_equal(
            back.projection_sigma_px(side, px, range_m=1.0), calibration.projection_sigma_px(side, px, range_m=1.0)
        )
    np.testing.assert_array_equal(back.row_sigma_px(px, range_m=2.0), calibration.row_sigma_px(px, range_m=2.0))
    assert back.depth_sigma(2.0, matching_px=0.2).total_m == calibration.depth_sigma(2.0, matching_px=0.2).total_m
    assert back.extra == {}


def test_a_range_is_a_point_in_the_middle_and_matching_grows_with_the_square_of_the_range(calibration):
    near, far = (calibration.depth_sigma(z, left_px=np.array([640.0, 480.0]), matching_px=0.25) for z in (1.0, 3.0))
    expected_m = 1.0**2 / (RIG.left.parameters[0] * RIG.baseline_m) * 0.25
    assert near.matching_m == pytest.approx(
        expected_m, rel=0.05
    )  # rays here are not quite perpendicular to the baseline
    assert far.matching_m / near.matching_m == pytest.approx(9.0, rel=0.05)
    assert near.total_m == pytest.approx(np.hypot(near.calibration_m, near.matching_m))
    assert near.board_m == 0


def test_the_boards_size_counts_where_it_was_measured(calibration):
    from binocal.result import BoardShape

    n = len(BOARD.object_points_m)
    shape = BoardShape(BOARD.object_points_m, np.zeros((n, 3)), 0.0, 0.0, 0.0, 0.0, 0.0, scale_sigma=0.001)
    told = replace(calibration, evidence=None, board_shape=shape).depth_sigma(2.0)
    assert told.board_m == pytest.approx(0.002)


def test_what_cannot_be_told_is_said(calibration):
    older = replace(calibration, mean_board_pose=None)
    with pytest.raises(DataError, match="board poses err"):
        older.projection_sigma_px("left", np.zeros(2))
    with pytest.raises(DataError, match="no covariance"):
        make_calibration().depth_sigma(1.0)
    for wrong in (0.0, -1.0, np.inf):
        with pytest.raises(ValueError, match=r"range"):
            calibration.depth_sigma(wrong)
    with pytest.raises((ValueError, TypeCheckError), match=r"range|type"):
        calibration.depth_sigma(np.zeros((2, 2)))
    with pytest.raises(ValueError, match="left and a right"):
        calibration.projection_sigma_px("middle", np.zeros(2))
    with pytest.raises(ValueError, match="six rows"):
        MeanBoardPose(np.eye(5), np.zeros((6, 3)))
    with pytest.raises(ValueError, match="parameters for a covariance"):
        MeanBoardPose(np.eye(6), np.zeros((6, 3))).joint(calibration.covariance)


def test_what_only_one_camera_sees_has_no_depth(calibration):
    aside = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    told = calibration.depth_sigma(aside)
    assert np.isfinite(told.calibration_m[0]) and np.isnan(told.calibration_m[1])
