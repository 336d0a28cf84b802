"""The two distances of a printed board that a ruler measures, A-B along its rows and A-C along its columns, and what they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from binocal.boards.board import Board, format_length, parse_length

MOST_OFF = 0.05  # printers scale by a percent; more is another distance

_ENDS = {
    "chessboard": "over all its squares, from outer edge to outer edge",
    "charuco": "over all its squares, from outer edge to outer edge",
    "aprilgrid": "from the first tag's outer edge to the last one's, without the small squares outside",
    "circles": "from the first circle's centre to the last one's",
    "acircles": "from the first circle's centre to the farthest one's",
    "puzzleboard": "over all its print, from outer edge to outer edge (half a square beyond the outer corners)",
    "squares": "over all its squares, from outer edge to outer edge",
}


def measured_ends(board: Board) -> str:
    """Between what the two distances of a board are measured."""
    return _ENDS[board.kind]


def measured_box_m(board: Board) -> tuple[float, float, float, float]:
    """x0, y0, x1, y1 of the rectangle whose sides are measured, in the board frame, metres (pitches if not metric)."""
    if board.kind == "chessboard":
        box = np.array([-1.0, -1.0, board.columns, board.rows]) * board.pitch_m
    elif board.kind == "puzzleboard":
        box = np.array([-0.5, -0.5, board.columns - 0.5, board.rows - 0.5]) * board.pitch_m
    elif board.kind == "charuco":
        box = np.array([0.0, 0.0, board.columns, board.rows]) * board.pitch_m
    else:
        points = board.object_points_m[:, :2]
        box = np.r_[points.min(axis=0), points.max(axis=0)]
    return float(box[0]), float(box[1]), float(box[2]), float(box[3])


def parse_measured(text: str) -> tuple[float, float]:
    """Metres of two lengths with their units and a comma between: ``199.4mm,139.9mm``.

    Raises:
        ValueError: They are not.
    """
    parts = text.split(",")
    lengths = [parse_length(part) for part in parts] if len(parts) == 2 else []
    if not lengths or not all(has_unit for _, has_unit in lengths):
        raise ValueError(f"{text[:40]!r} is not two lengths with their units, A-B and A-C, such as 199.4mm,139.9mm")
    return lengths[0][0], lengths[1][0]


def board_as_measured(board: Board, measured_m: tuple[float, float]) -> tuple[Board, tuple[float, float]]:
    """The board, and by what its points are to be multiplied in x and y. A board without a scale gets its mean one from the ruler.

    Raises:
        ValueError: A distance is off by more than ``MOST_OFF``, so that another one must have been measured.
    """
    x0, y0, x1, y1 = measured_box_m(board)
    drawn = x1 - x0, y1 - y0
    if not board.is_metric:
        pitch_m = float(np.sqrt(measured_m[0] / drawn[0] * measured_m[1] / drawn[1]))
        board = replace(
            board, pitch_m=pitch_m, is_metric=True, marker_m=board.marker_m * pitch_m, gap_m=board.gap_m * pitch_m
        )
        drawn = drawn[0] * pitch_m, drawn[1] * pitch_m
    off = [measured / length - 1 for measured, length in zip(measured_m, drawn, strict=True)]
    if max(map(abs, off)) <= MOST_OFF:
        return board, (1 + off[0], 1 + off[1])
    crossed = measured_m[1] / drawn[0] - 1, measured_m[0] / drawn[1] - 1
    remedy = "are they exchanged?" if max(map(abs, crossed)) <= MOST_OFF else "measure them, or correct the SPEC."
    wrong = " and ".join(
        f"{name} measures {format_length(round(measured, 7))} and should have {format_length(round(length, 7))}"
        for name, measured, length, by in zip(("A-B", "A-C"), measured_m, drawn, off, strict=True)
        if abs(by) > MOST_OFF
    )
    raise ValueError(
        f"{wrong}, which is more than {100 * MOST_OFF:.0f} % off; A-B and A-C run {measured_ends(board)}: {remedy}"
    )
