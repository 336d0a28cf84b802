"""A board as shapes in millimetres, from the top left corner of its print."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from binocal.boards import Board
from binocal.printing.drawing import Area, Disc, Shape, rectangles, trace_cells
from binocal.simulation.layout import cell_print, disc_print, printed_extent_m

MOST_QUIET_MM = 25.0  # of a border, however large the squares are


@dataclass(frozen=True, slots=True)
class PrintStyle:
    """What a SPEC leaves open: ChArUco's layout, the bits of black around an AprilGrid's tags (Kalibr: 2, AprilTag's own: 1), colours."""

    is_legacy_charuco: bool = False
    april_border_bits: int = 2
    is_inverted: bool = False
    """White on black, the quiet border too."""


def board_size_mm(board: Board) -> tuple[float, float]:
    """Width and height of the print."""
    x0, y0, x1, y1 = printed_extent_m(board)
    return 1e3 * (x1 - x0), 1e3 * (y1 - y0)


def quiet_mm(board: Board) -> float:
    """The border, white (of an inverted board black), that a board needs at least.

    A third of a square, half a spacing of circles, an AprilGrid's gap.
    """
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
    shapes = _black_shapes(board, style)
    return _inverted(shapes, board_size_mm(board), quiet_mm(board)) if style.is_inverted else shapes


def _inverted(shapes: tuple[Shape, ...], size_mm: tuple[float, float], quiet: float) -> tuple[Shape, ...]:
    """The same with its colours swapped, on a black ground that reaches over the quiet border."""
    (width, height), ground = size_mm, []
    discs: list[Shape] = []
    for shape in shapes:
        if isinstance(shape, Area):
            ground += [outline[::-1] for outline in shape.outlines]
        elif isinstance(shape, Disc):
            discs.append(replace(shape, hole=0.0, is_black=not shape.is_black))
            if shape.hole:
                discs.append(replace(shape, radius=shape.hole, hole=0.0))
    outer = rectangles((-quiet, -quiet, width + quiet, height + quiet))
    return (Area((*outer.outlines, *ground)), *discs)


def _black_shapes(board: Board, style: PrintStyle) -> tuple[Shape, ...]:
    """What is black of a board that is not inverted."""
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
