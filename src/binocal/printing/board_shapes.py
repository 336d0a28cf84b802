"""A board as shapes in millimetres, from the top left corner of its print."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from binocal.boards import Board
from binocal.printing.drawing import Disc, Shape, trace_cells
from binocal.simulation.layout import cell_print, disc_print, printed_extent_m

MOST_QUIET_MM = 25.0  # of a border, however large the squares are


@dataclass(frozen=True, slots=True)
class PrintStyle:
    """What a SPEC leaves open: ChArUco's layout, and the bits of black around an AprilGrid's tags (Kalibr: 2, AprilTag's own: 1)."""

    is_legacy_charuco: bool = False
    april_border_bits: int = 2


def board_size_mm(board: Board) -> tuple[float, float]:
    """Width and height of the print."""
    x0, y0, x1, y1 = printed_extent_m(board)
    return 1e3 * (x1 - x0), 1e3 * (y1 - y0)


def quiet_mm(board: Board) -> float:
    """The white border that a board needs at least: a third of a square, half a spacing of circles, an AprilGrid's gap."""
    share = {"aprilgrid": board.tag_gap_ratio, "chessboard": 1 / 3, "charuco": 1 / 3, "puzzleboard": 1 / 3}.get(
        board.kind, 0.5
    )
    return min(1e3 * board.pitch_m * share, MOST_QUIET_MM)


def board_shapes(board: Board, style: PrintStyle | None = None) -> tuple[Shape, ...]:
    """What is printed of a board.

    Raises:
        ValueError: The dictionary has too few markers, or neighbouring circles would touch.
    """
    style = style or PrintStyle()
    x0, y0, _, _ = printed_extent_m(board)
    pitch = 1e3 * board.pitch_m
    if board.kind in ("circles", "acircles"):
        discs = disc_print(board)
        row, column = np.divmod(np.arange(board.columns * board.rows), board.columns)
        x = (discs.step_x * column + discs.stagger * (row % 2)) * pitch - 1e3 * x0
        y = row * pitch - 1e3 * y0
        sizes = zip(x, y, discs.outer.ravel() * pitch, discs.hole.ravel() * pitch, strict=True)
        return tuple(Disc(float(u), float(v), float(radius), float(hole)) for u, v, radius, hole in sizes)
    cells = cell_print(board, is_legacy_charuco=style.is_legacy_charuco, april_border_bits=style.april_border_bits)
    area = trace_cells(cells.ink, cells.x_edges * pitch - 1e3 * x0, cells.y_edges * pitch - 1e3 * y0)
    discs = (
        Disc(float(x * pitch - 1e3 * x0), float(y * pitch - 1e3 * y0), float(radius * pitch), is_black=bool(ink))
        for x, y, radius, ink in cells.discs
    )
    return (area, *discs)
