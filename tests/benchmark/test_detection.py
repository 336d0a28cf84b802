from __future__ import annotations

import numpy as np
import pytest

from binocal.benchmark.detection import (
    LEAST_SIDE_PER_BLUR,
    LEAST_SIDE_PX,
    DetectionScene,
    draw_detection_scene,
    is_in_place,
    run_detection_benchmark,
)
from binocal.boards import parse_board


def scene_of(spec):
    board = parse_board(spec)
    return DetectionScene(np.zeros((60, 80), np.uint8), board, 20 * board.object_points_m[:, :2] / 0.02, 20.0, "")


def test_corners_are_compared_in_the_orders_that_the_colours_allow():
    odd, even = scene_of("chessboard:4x3:20mm"), scene_of("chessboard:5x3:20mm")
    assert is_in_place(odd.corners_px, odd) and not is_in_place(odd.corners_px[::-1], odd)
    assert is_in_place(even.corners_px, even) and is_in_place(even.corners_px[::-1], even)
    assert not is_in_place(even.corners_px.reshape(3, 5, 2)[:, ::-1].reshape(-1, 2), even)
    square = scene_of("chessboard:3x3:20mm")
    assert is_in_place(np.rot90(square.corners_px.reshape(3, 3, 2)).reshape(-1, 2), square)


def test_one_misplaced_corner_makes_a_grid_wrong_and_a_missing_one_does_not():
    scene = scene_of("chessboard:4x3:20mm")
    points = scene.corners_px.copy()
    points[3] = np.nan
    assert is_in_place(points, scene)
    points[5] += 5.1
    assert not is_in_place(points, scene)
    assert not is_in_place(points, DetectionScene(scene.image, scene.board, None, np.inf, ""))


def test_scenes_keep_their_promises_and_come_back():
    scenes = [draw_detection_scene(3, index) for index in range(4)]
    assert np.array_equal(scenes[1].image, draw_detection_scene(3, 1).image)
    for scene in scenes:
        assert scene.image.shape == (960, 1280)
        if scene.corners_px is not None:
            blur_px = float(scene.text.split("blur ")[1].split(",")[0])
            assert scene.short_side_px >= max(LEAST_SIDE_PX, LEAST_SIDE_PER_BLUR * (blur_px - 0.01))


@pytest.mark.slow
def test_boards_are_found_and_clutter_is_not():
    table = run_detection_benchmark(images=24, peer_every=12, seed=5)
    ours, legacy, sector = table["rows"]
    assert ours["n_found"] == ours["n_boards"] > 15 and ours["wrong"] == [] == ours["missed"]
    assert ours["n_boards"] + ours["n_without_board"] == 24 and ours["no_board_ms"]["max"] > 0
    assert legacy["n_boards"] + legacy["n_without_board"] == 2 == sector["n_boards"] + sector["n_without_board"]
    assert "24 rendered images" in table["text"]
