"""Corners on a board as a ruler measured its print; see :mod:`binocal.boards.measured`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from binocal.boards import Board
from binocal.boards.measured import board_as_measured
from binocal.errors import DataError
from binocal.evidence import Detections


def scale_as_measured(
    detections: Detections, board: Board, measured_m: tuple[float, float]
) -> tuple[Detections, dict[str, Any]]:
    """The detections with the board's points as long and as wide as the ruler says, and the ruler's word for the provenance.

    Corners of a file may be of a measured board already: what counts is how long and wide they shall be.

    Raises:
        DataError: A distance is far from what the board has, or the corners are of another board.
    """
    board, scales = checked_board(board, measured_m)
    drawn = board.object_points_m
    if len(drawn) != len(detections.object_points_m):
        raise DataError(
            f"the corners are of {len(detections.object_points_m)} points, the board {detections.board_spec} has {len(drawn)}."
        )
    now = np.ptp(detections.object_points_m, axis=0)[:2]
    factors = np.append(np.ptp(drawn, axis=0)[:2] * scales / now, 1.0)
    measured = {"A-B_m": measured_m[0], "A-C_m": measured_m[1], "scale_x": scales[0], "scale_y": scales[1]}
    scaled = replace(detections, object_points_m=detections.object_points_m * factors, is_metric=True)
    return scaled, {"measured": measured}


def checked_board(board: Board, measured_m: tuple[float, float]) -> tuple[Board, tuple[float, float]]:
    """The board, with a scale if it had none, and by what its points are to be multiplied.

    Raises:
        DataError: A distance is far from what the board has.
    """
    try:
        return board_as_measured(board, measured_m)
    except ValueError as error:
        raise DataError(str(error)) from None
