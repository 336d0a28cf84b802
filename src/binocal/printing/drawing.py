"""What is drawn on pages: black areas, discs and text, in millimetres from a page's top left corner, x right and y down."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.shapes import Float, Int

ADVANCE = 0.6  # width of a character of Courier over the size of the font


@dataclass(frozen=True, slots=True, eq=False)
class Area:
    """Ink within closed outlines of horizontal and vertical edges in turn. Each runs with the ink on its right (y down)."""

    outlines: tuple[Float[ndarray, "_ 2"], ...]


@dataclass(frozen=True, slots=True)
class Disc:
    """A black disc, a ring about a white one, or a white disc on what is black there."""

    x: float
    y: float
    radius: float
    hole: float = 0.0
    """Radius of the white disc inside."""
    is_black: bool = True


@dataclass(frozen=True, slots=True)
class Text:
    """A line in Courier; (x, y) is the left end of its baseline, ``size`` that of the font."""

    x: float
    y: float
    size: float
    text: str


Shape = Area | Disc | Text


@dataclass(frozen=True, slots=True)
class Group:
    """Shapes that belong together, moved by ``shift``. Nothing is drawn outside of ``clip``: x0, y0, x1, y1 on the page."""

    name: str
    shapes: tuple[Shape, ...]
    shift: tuple[float, float] = (0.0, 0.0)
    clip: tuple[float, float, float, float] | None = None


@dataclass(frozen=True, slots=True)
class Page:
    """A page and what is on it."""

    width: float
    height: float
    groups: tuple[Group, ...]


def rectangles(*boxes: tuple[float, float, float, float]) -> Area:
    """Black rectangles x0, y0, x1, y1 that do not overlap."""
    return Area(tuple(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], dtype=float) for x0, y0, x1, y1 in boxes))


def trace_cells(
    ink: Int[ndarray, "rows columns"],
    x_edges: Float[ndarray, "columns_and_one"],
    y_edges: Float[ndarray, "rows_and_one"],
) -> Area:
    """The outlines of the inked cells of a grid; cells that share an edge lie in one, those that share a corner do not.

    One outline instead of a square for each cell: no seams on the screen, one cut for a plotter.
    """
    padded = np.pad(ink != 0, 1)
    inside = padded[1:-1, 1:-1]
    # Edges by their start (column, row) and direction: 0 right, 1 down, 2 left, 3 up, the ink on the right.
    starts = {
        0: (inside & ~padded[:-2, 1:-1], 0, 0),
        1: (inside & ~padded[1:-1, 2:], 1, 0),
        2: (inside & ~padded[2:, 1:-1], 1, 1),
        3: (inside & ~padded[1:-1, :-2], 0, 1),
    }
    leaving: dict[tuple[int, int], list[int]] = defaultdict(list)
    for direction, (is_edge, right, down) in starts.items():
        for row, column in np.argwhere(is_edge):
            leaving[int(column) + right, int(row) + down].append(direction)
    outlines = []
    while leaving:
        start = place = next(iter(leaving))
        corners: list[tuple[int, int]] = []
        first = heading = leaving[place][0]
        while True:
            ways = leaving[place]
            # where two cells touch at a corner alone, the right turn stays with the cell
            turned = next(d for d in ((heading + 1) % 4, heading, (heading + 3) % 4) if d in ways) if corners else first
            ways.remove(turned)
            if not ways:
                del leaving[place]
            if turned != heading or not corners:
                corners.append(place)
            heading = turned
            place = place[0] + (1, 0, -1, 0)[heading], place[1] + (0, 1, 0, -1)[heading]
            if place == start and ((heading + 1) % 4 == first or start not in leaving):
                break
        outlines.append(np.array(corners))
    return Area(tuple(np.stack([x_edges[corners[:, 0]], y_edges[corners[:, 1]]], axis=-1) for corners in outlines))
