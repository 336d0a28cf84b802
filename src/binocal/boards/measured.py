"""The two distances of a printed board that a ruler measures, and the board's points as they say."""

from __future__ import annotations

import numpy as np

from binocal.boards.board import Board

_ENDS = {
    "chessboard": "over all its squares, from outer edge to outer edge",
    "charuco": "over all its squares, from outer edge to outer edge",
    "aprilgrid": "from the first tag's outer edge to the last one's, without the small squares outside",
    "circles": "from the first circle's centre to the last one's",
    "acircles": "from the first circle's centre to the farthest one's",
}


def measured_ends(board: Board) -> str:
    """Between what the two distances of a board are measured."""
    return _ENDS[board.kind]


def measured_box_m(board: Board) -> tuple[float, float, float, float]:
    """x0, y0, x1, y1 of the rectangle whose sides are measured, in the board frame, metres (pitches if not metric)."""
    if board.kind == "chessboard":
        box = np.array([-1.0, -1.0, board.columns, board.rows]) * board.pitch_m
    elif board.kind == "charuco":
        box = np.array([0.0, 0.0, board.columns, board.rows]) * board.pitch_m
    else:
        points = board.object_points_m[:, :2]
        box = np.r_[points.min(axis=0), points.max(axis=0)]
    return float(box[0]), float(box[1]), float(box[2]), float(box[3])
