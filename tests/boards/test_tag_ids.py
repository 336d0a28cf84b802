import numpy as np

from binocal.boards import Board, parse_board


def test_ids_grow_to_the_right_and_upward_from_the_bottom_left_tag():
    board = Board("aprilgrid", 3, 2, 0.088, first_tag_id=10)
    # points go row by row from the top, so the first three tags are the top row
    assert board.tag_ids.tolist() == [13, 14, 15, 10, 11, 12]
    corners = board.object_points_m.reshape(-1, 4, 3)
    bottom_left = corners[np.flatnonzero(board.tag_ids == 10)[0]]
    assert bottom_left[:, 0].min() == 0
    assert bottom_left[:, 1].max() == board.object_points_m[:, 1].max()


def test_other_boards_have_no_tags():
    assert parse_board("chessboard:9x6:30mm").tag_ids.size == 0
