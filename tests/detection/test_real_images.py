"""Real sets, each with the board of its row; the numbers beside the sets are what was measured."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.datasets import list_pairs
from binocal.detection import detect_pairs
from binocal.errors import DetectionError

pytestmark = [pytest.mark.data, pytest.mark.slow]

SETS = {  # glob of the left, of the right, board, whole views, RMS (left, right; 5 coefficients) of the classic finder
    "opencv_bouguet": ("left*", "right*", "chessboard:9x6:30mm", 13, 0.230, 0.244),  # measured 0.158, 0.154
    "boof_bumblebee2_chess": ("left*", "right*", "chessboard:6x4:30mm", 11, 0.082, 0.079),  # 0.069, 0.072
    "sourishg_webcam_640": ("left*", "right*", "chessboard:9x6:24.23mm", 29, 0.170, 0.166),  # 0.145, 0.140
    "sourishg_webcam_270x180": ("left*", "right*", "chessboard:9x6:24.23mm", 28, 0.148, 0.153),  # 0.096, 0.093
    "presentcjn_cb11x8": ("left*", "right*", "chessboard:11x8:12mm", 29, 0.187, 0.181),  # 0.175, 0.169
    "stereopi_fisheye": ("left*", "right*", "chessboard:9x6:25mm", 25, 0.160, 0.160),  # 0.101, 0.121
    "nico_tablet_a": ("imageL*", "imageR*", "chessboard:9x6", 6, 0.105, 0.100),  # 0.096, 0.078
    "barry_swapped": ("left*", "right*", "chessboard:9x6", 24, 0.153, 0.206),  # 0.111, 0.105
    "rursprung_charuco": ("left/", "right/", "charuco:11x8:30mm:22mm:DICT_5X5_50", 30, 0.325, 0.313),  # 0.269, 0.278
}


@pytest.mark.parametrize("name", SETS)
def test_every_view_is_found_and_corners_fit_a_camera_as_well_as_the_classic_ones(data_dir, name):
    left, right, spec, n_views, *classic_rms_px = SETS[name]
    board = parse_board(spec)
    found = detect_pairs(list_pairs(str(data_dir / name / left), str(data_dir / name / right)), board)
    detections = found.detections
    whole = detections.left_is_seen.any(axis=1) & detections.right_is_seen.any(axis=1)
    assert whole.sum() >= n_views, found.rejected
    for points_px, size_wh, classic_px in zip(
        (detections.left_px, detections.right_px),
        (detections.left_size_wh, detections.right_size_wh),
        classic_rms_px,
        strict=True,
    ):
        seen = [np.isfinite(view[:, 0]) for view in points_px]
        views = [
            (board.object_points_m[mask].astype(np.float32), view[mask].astype(np.float32))
            for view, mask in zip(points_px, seen, strict=True)
            if mask.sum() >= 6
        ]
        rms_px = cv2.calibrateCamera([v[0] for v in views], [v[1] for v in views], size_wh, None, None)[0]
        assert rms_px < 1.03 * classic_px


def test_a_room_of_boards_is_recognised(data_dir):
    folder = data_dir / "kitti_calib_room"
    for spec in ("chessboard:11x7:99.5mm", "chessboard:7x5:99.5mm"):
        with pytest.raises(DetectionError, match="more than one board"):
            detect_pairs(list_pairs(str(folder / "left*"), str(folder / "right*")), parse_board(spec))


def test_scenes_without_a_board_are_refused(data_dir):
    folder = data_dir / "boof_bumblebee2_scenes"
    with pytest.raises(DetectionError, match="no chessboard") as caught:
        detect_pairs(list_pairs(str(folder / "*left*"), str(folder / "*right*")), parse_board("chessboard:9x6:30mm"))
    assert len(caught.value.reasons) == 16
