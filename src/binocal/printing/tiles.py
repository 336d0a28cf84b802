"""A sheet that is larger than the paper, split over pages that overlap.

The marks in the margins lie on the middle of each overlap: one page is cut along them, and its cut edge laid on the marks of the next.
"""

from __future__ import annotations

import math
from dataclasses import replace

from binocal.printing.drawing import Group, Page, Text, rectangles

OVERLAP_MM = 10.0
LEAST_WINDOW_MM = 50.0
MOST_PAGES = 200
LABEL_MM = 2.4
THIN_MM = 0.2


def split_over_pages(sheet: Page, page_mm: tuple[float, float], margin_mm: float) -> tuple[Page, ...]:
    """The pages row by row, upright or turned as fewer are needed.

    Raises:
        ValueError: The pages are too small for the overlap, or would be too many.
    """
    layouts = [(_counts(sheet, size, margin_mm), size) for size in (page_mm, (page_mm[1], page_mm[0]))]
    (columns, rows), size = min(layouts, key=lambda layout: math.prod(layout[0]))
    if columns * rows > MOST_PAGES:
        raise ValueError(f"the board would need {columns} x {rows} pages; take larger ones")
    return tuple(
        _page(sheet, size, margin_mm, (column, row), (columns, rows))
        for row in range(rows)
        for column in range(columns)
    )


def _steps(page_mm: tuple[float, float], margin_mm: float) -> tuple[float, float]:
    """What each further page adds."""
    if min(page_mm) - 2 * margin_mm < LEAST_WINDOW_MM:
        raise ValueError(f"pages of {page_mm[0]:g} x {page_mm[1]:g} mm leave too little within their margins")
    return page_mm[0] - 2 * margin_mm - OVERLAP_MM, page_mm[1] - 2 * margin_mm - OVERLAP_MM


def _counts(sheet: Page, page_mm: tuple[float, float], margin_mm: float) -> tuple[int, int]:
    """Pages side by side, and one below the other."""
    step_x, step_y = _steps(page_mm, margin_mm)
    counts = (
        math.ceil((side - OVERLAP_MM) / step - 1e-9) for side, step in ((sheet.width, step_x), (sheet.height, step_y))
    )
    return tuple(max(count, 1) for count in counts)  # type: ignore[return-value]


def _page(
    sheet: Page, page_mm: tuple[float, float], margin: float, place: tuple[int, int], counts: tuple[int, int]
) -> Page:
    """One page: its part of the sheet, the marks in its margins, and which one it is."""
    steps = _steps(page_mm, margin)
    shift = margin - place[0] * steps[0], margin - place[1] * steps[1]
    ends = [min(page_mm[axis] - margin, side + shift[axis]) for axis, side in enumerate((sheet.width, sheet.height))]
    clip = (margin, margin, ends[0], ends[1])
    groups = [
        replace(group, shift=(group.shift[0] + shift[0], group.shift[1] + shift[1]), clip=clip)
        for group in sheet.groups
    ]
    half, near, far = THIN_MM / 2, 0.1 * margin, 0.9 * margin
    boxes = []
    for axis in (0, 1):
        across = page_mm[1 - axis]
        for seam in range(max(place[axis], 1), min(place[axis] + 2, counts[axis])):
            at = seam * steps[axis] + OVERLAP_MM / 2 + shift[axis]
            for v0, v1 in ((near, far), (across - far, across - near)):
                box = (at - half, v0, at + half, v1)
                boxes.append(box if axis == 0 else (box[1], box[0], box[3], box[2]))
    label = (
        f"row {place[1] + 1} of {counts[1]}, column {place[0] + 1} of {counts[0]}: cut along the marks, glue, measure"
    )
    shapes = (rectangles(*boxes),) if boxes else ()
    if margin >= 2 * LABEL_MM:
        shapes = (*shapes, Text(margin + OVERLAP_MM, page_mm[1] - 0.4 * margin, LABEL_MM, label))
    return Page(*page_mm, (*groups, Group("marks", shapes)))
