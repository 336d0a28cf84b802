from __future__ import annotations

import numpy as np
import pytest

from binocal.boards import BoardSet, parse_board


def test_points_of_several_boards_stand_in_one_list_and_keep_their_distances():
    boards = BoardSet.from_specs(["chessboard:7x5:90mm", "chessboard:11x7:60mm", "charuco:6x5:50mm:37mm:DICT_4X4_50"])
    points = boards.object_points_m
    assert points.shape == (7 * 5 + 11 * 7 + 5 * 4, 3) and not points[:, 2].any()
    for board, place in zip(boards.boards, boards.places, strict=True):
        moved = points[place] - points[place][0]
        np.testing.assert_allclose(moved, board.object_points_m - board.object_points_m[0], atol=1e-12)
    distance = np.linalg.norm(points[:, None] - points, axis=-1) + np.eye(len(points))
    assert distance.min() > 0.049  # no board lies on another
    assert BoardSet.from_specs(boards.spec) == boards


def test_one_board_has_its_own_points():
    board = parse_board("charuco:6x5:50mm:37mm:DICT_4X4_50")
    np.testing.assert_array_equal(BoardSet((board,)).object_points_m, board.object_points_m)


@pytest.mark.parametrize(
    ("specs", "told"),
    [
        (["chessboard:7x5:90mm", "chessboard:5x7:60mm"], "cannot be told apart in an image"),
        (["chessboard:7x5:90mm:marked", "chessboard:6x5:90mm"], "a part of a marked chessboard looks like another"),
        (["charuco:6x5:50mm:37mm:DICT_4X4_50", "charuco:5x5:50mm:37mm:DICT_4X4_50:10"], "ids overlap"),
        (["aprilgrid:2x2:88mm:0.3", "aprilgrid:2x2:88mm:0.3:tag36h11:3"], "another first id"),
        (["chessboard:7x5:90mm", "chessboard:11x7"], "its length"),
        ([], "at least one"),
    ],
)
def test_boards_that_cannot_be_told_apart_are_refused(specs, told):
    with pytest.raises(ValueError, match=told):
        BoardSet.from_specs(specs)


def test_markers_with_other_ids_or_families_are_told_apart():
    specs = [
        "charuco:6x5:50mm:37mm:DICT_4X4_50",
        "charuco:6x5:50mm:37mm:DICT_4X4_50:15",
        "charuco:6x5:50mm:37mm:DICT_5X5_50",
    ]
    specs += ["aprilgrid:2x2:88mm:0.3", "aprilgrid:2x2:88mm:0.3:4"]
    assert len(BoardSet.from_specs(specs).boards) == 5
