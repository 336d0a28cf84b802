"""A board on its sheet: the quiet border, two lines to measure along, scale bars, the SPEC as text and as QR code.

Left of the board and below it run two lines, A-B and A-C, whose ends are the board's own: they are what ``--measured`` takes.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from binocal.boards import Board, format_board
from binocal.boards.board import format_length
from binocal.boards.measured import measured_box_m
from binocal.printing.board_shapes import PrintStyle, board_shapes, board_size_mm, quiet_mm
from binocal.printing.drawing import ADVANCE, Area, Group, Page, Shape, Text, rectangles, trace_cells
from binocal.simulation.layout import printed_extent_m

MARGIN_MM = 10.0  # that printers leave white
LINE_STRIP_MM = 5.0  # for a line to measure along, with its letters
BAR_STRIP_MM = 6.0  # for the upright scale bar
FOOTER_MM = 20.0
QR_MM = 18.0
BARS_MM = (100.0, 50.0, 20.0, 10.0)  # the longest that the page has room for
FONT_MM = 2.8
LEAST_FONT_MM = 1.2
THIN_MM = 0.2


@dataclass(frozen=True, slots=True)
class SheetOptions:
    """How a board lies on its sheet; ``has_notes`` False leaves all away but the board and its quiet border."""

    margin_mm: float = MARGIN_MM
    has_notes: bool = True
    style: PrintStyle = field(default_factory=PrintStyle)


def sheet_size_mm(board: Board, options: SheetOptions) -> tuple[float, float]:
    """Width and height of the smallest sheet that has room for all."""
    left, top, right, bottom = _borders(board, options)
    width, height = board_size_mm(board)
    return left + width + right, top + height + bottom


def lay_out_sheet(board: Board, page_mm: tuple[float, float], options: SheetOptions) -> Page:
    """The board in the middle of what its notes leave of a page.

    Raises:
        ValueError: The page is too small, the board has no scale or cannot be drawn, or a SPEC cannot say it.
    """
    if not board.is_metric:
        raise ValueError("a printed board needs its size: give the length a unit, such as 20mm")
    need = sheet_size_mm(board, options)
    if need[0] > page_mm[0] + 1e-3 or need[1] > page_mm[1] + 1e-3:
        raise ValueError(f"the board needs a page of {need[0]:.0f} x {need[1]:.0f} mm")
    left, top, _, _ = _borders(board, options)
    x, y = left + (page_mm[0] - need[0]) / 2, top + (page_mm[1] - need[1]) / 2
    shapes = board_shapes(board, options.style)
    groups = [Group("board", shapes, (x, y))]
    if options.has_notes:
        groups.append(Group("notes", (*_measuring_lines(board, x, y), *_footer(board, page_mm, options))))
    return Page(*page_mm, tuple(groups))


def _borders(board: Board, options: SheetOptions) -> tuple[float, float, float, float]:
    """What is kept free at the left, top, right and bottom of the print."""
    quiet, margin = quiet_mm(board), options.margin_mm
    # a printer that leaves its margin white may leave a white border's part of it, but not a black one's
    free = quiet + margin if options.style.is_inverted else max(quiet, margin)
    if not options.has_notes:
        return free, free, free, free
    return (
        margin + BAR_STRIP_MM + LINE_STRIP_MM + quiet,
        free,
        free,
        quiet + LINE_STRIP_MM + FOOTER_MM + margin,
    )


def distances_mm(board: Board) -> tuple[float, float]:
    """A-B and A-C: what a ruler finds if the print is true to scale."""
    x0, y0, x1, y1 = measured_box_m(board)
    return 1e3 * (x1 - x0), 1e3 * (y1 - y0)


def _measuring_lines(board: Board, x: float, y: float) -> list[Shape]:
    """Lines with end marks, A-B below the board and A-C left of it; the board's print begins at (x, y)."""
    _, height = board_size_mm(board)
    quiet = quiet_mm(board)
    extent, box = np.array(printed_extent_m(board)), np.array(measured_box_m(board))
    x0, y0, x1, y1 = 1e3 * (box - np.tile(extent[:2], 2)) + np.array([x, y, x, y])
    below, left = y + height + quiet, x - quiet
    mark, half = 3.0, THIN_MM / 2
    lines = rectangles(
        (x0 - half, below, x0 + half, below + mark),
        (x0 + half, below + mark / 2 - half, x1 - half, below + mark / 2 + half),
        (x1 - half, below, x1 + half, below + mark),
        (left - mark, y1 - half, left, y1 + half),
        (left - mark / 2 - half, y0 + half, left - mark / 2 + half, y1 - half),
        (left - mark, y0 - half, left, y0 + half),
    )
    size = 3.0
    letters = (
        Text(x0 - 2.6, below + mark, size, "A"),
        Text(x1 + 0.6, below + mark, size, "B"),
        Text(left - mark, y1 + 2.6, size, "A"),
        Text(left - mark, y0 - 0.6, size, "C"),
    )
    return [lines, *letters]


def _footer(board: Board, page_mm: tuple[float, float], options: SheetOptions) -> list[Shape]:
    """Scale bars, the SPEC, what to measure, and the QR code."""
    spec = format_board(board)
    across, along = (format_length(1e-3 * round(d, 3)) for d in distances_mm(board))
    margin = options.margin_mm
    x, y = margin + QR_MM + 2, page_mm[1] - margin - FOOTER_MM + 0.3
    room = page_mm[0] - margin - x
    lines = [
        spec + _style_words(options.style),
        "Printed at 100 %, the bars are as long as they say. Measure A-B and A-C:",
        f"A-B {across}: ________ mm    A-C {along}: ________ mm",
        "binocal calibrate ... --measured A-B,A-C such as " + f"{across},{along}",
    ]
    size = min(FONT_MM, room / (ADVANCE * max(map(len, lines))))
    if size < LEAST_FONT_MM:
        raise ValueError("the page is too narrow for the notes; take a wider one, or --no-notes")
    texts = [Text(x, y + 1.35 * FONT_MM * i + FONT_MM, size, line) for i, line in enumerate(lines)]
    bottom = page_mm[1] - margin
    flat = _scale_bar(room - 12.0)
    upright = _scale_bar(page_mm[1] - 2 * margin - FOOTER_MM - 4.0)
    foot = page_mm[1] - margin - FOOTER_MM
    return [
        _qr_code(spec, margin, page_mm[1] - margin - QR_MM),
        *texts,
        rectangles(*(_ruler(flat, x, bottom, is_upright=False))),
        Text(x + flat + 1.0, bottom, FONT_MM, f"{flat:g} mm"),
        rectangles(*(_ruler(upright, margin, foot, is_upright=True))),
        Text(margin, foot - upright - 1.0, 2.0, f"{upright:g} mm"),
    ]


def _style_words(style: PrintStyle) -> str:
    words = ["legacy layout"] * style.is_legacy_charuco + ["inverted"] * style.is_inverted
    return f" ({', '.join(words)})" if words else ""


def _scale_bar(room: float) -> float:
    """Length of the longest bar for the room there is."""
    return next((length for length in BARS_MM if length <= room), BARS_MM[-1])


def _ruler(length: float, x: float, y: float, *, is_upright: bool) -> list[tuple[float, float, float, float]]:
    """Boxes of a bar from (x, y) to the right or upwards, its outer edges ``length`` apart, with marks at every tenth."""
    marks = [0.0] + [length * i / 10 - THIN_MM / 2 for i in range(1, 10)] + [length - THIN_MM]
    boxes = [(0.0, 0.0, length, THIN_MM)]
    boxes += [(at, THIN_MM, at + THIN_MM, 2.0 if i % 5 else 3.0) for i, at in enumerate(marks)]
    if is_upright:
        return [(x + v0, y - u1, x + v1, y - u0) for u0, v0, u1, v1 in boxes]
    return [(x + u0, y - v1, x + u1, y - v0) for u0, v0, u1, v1 in boxes]


def _qr_code(text: str, x: float, y: float) -> Area:
    """A QR code of ``QR_MM`` a side, with its quiet border of four modules."""
    import cv2

    modules = np.asarray(cv2.QRCodeEncoder.create().encode(text)) == 0
    rows, columns = (np.flatnonzero(modules.any(axis=axis)) for axis in (1, 0))
    modules = modules[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    n = len(modules)
    edges = np.arange(n + 1.0) * QR_MM / (n + 8) + 4 * QR_MM / (n + 8)
    return trace_cells(modules.astype(int), x + edges, y + edges)
