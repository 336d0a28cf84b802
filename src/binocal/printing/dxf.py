"""A page as DXF for cutters, engravers and CAD: closed polylines and circles in millimetres, y up.

Written as release 12 (AC1009), which every program reads. Layers: BOARD has what is to be cut or etched, NOTES the scale bars and
texts, SHEET the outline of the page. A disc in the middle of an outline's edge is an arc of that outline, not a circle across it.
Source: Autodesk, "DXF Reference", release 12.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy import ndarray

from binocal.printing.drawing import Area, Disc, Page, Text
from binocal.shapes import Float

LAYERS = ("SHEET", "BOARD", "NOTES")
MILLIMETRES = 4  # of $INSUNITS


def dxf_text(page: Page) -> str:
    """The page as a DXF document.

    Raises:
        ValueError: The page shows a part of a sheet: outlines cannot be cut off here.
    """
    if any(group.clip is not None for group in page.groups):
        raise ValueError("a DXF file holds the whole sheet; it is not split over pages")
    pairs: list[tuple[int, object]] = [
        (0, "SECTION"), (2, "HEADER"), (9, "$ACADVER"), (1, "AC1009"), (9, "$INSUNITS"), (70, MILLIMETRES),
        (9, "$MEASUREMENT"), (70, 1), (9, "$EXTMIN"), (10, 0.0), (20, 0.0), (30, 0.0),
        (9, "$EXTMAX"), (10, page.width), (20, page.height), (30, 0.0), (0, "ENDSEC"),
        (0, "SECTION"), (2, "TABLES"), (0, "TABLE"), (2, "LAYER"), (70, len(LAYERS)),
    ]  # fmt: skip
    for colour, name in enumerate(LAYERS, start=5):
        pairs += [(0, "LAYER"), (2, name), (70, 0), (62, colour), (6, "CONTINUOUS")]
    pairs += [(0, "ENDTAB"), (0, "ENDSEC"), (0, "SECTION"), (2, "ENTITIES")]
    corners = [(0.0, 0.0), (page.width, 0.0), (page.width, page.height), (0.0, page.height)]
    pairs += _polyline("SHEET", [(x, y, 0.0) for x, y in corners])
    for group in page.groups:
        layer, discs = group.name.upper(), {_key(s.x, s.y): s for s in group.shapes if isinstance(s, Disc)}
        for outline in (outline for shape in group.shapes if isinstance(shape, Area) for outline in shape.outlines):
            pairs += _polyline(layer, _with_arcs(outline, discs, group.shift, page.height))
        for shape in group.shapes:
            if isinstance(shape, Text) or (isinstance(shape, Disc) and _key(shape.x, shape.y) in discs):
                pairs += _entities(shape, layer, group.shift, page.height)
    pairs += [(0, "ENDSEC"), (0, "EOF")]
    return "".join(f"{code}\n{_value(value)}\n" for code, value in pairs)


def _key(x: float, y: float) -> tuple[float, float]:
    return round(float(x), 6), round(float(y), 6)


def _with_arcs(
    outline: Float[ndarray, "n 2"], discs: dict[tuple[float, float], Disc], shift: tuple[float, float], height: float
) -> list[tuple[float, float, float]]:
    """The outline's vertices on the page, each with the bulge of the way to the next one: 1 is half a circle to the right, -1 to the left.

    Discs in the middle of its edges are taken from ``discs``. The ink is on the right: white ones turn there, black ones away.
    """
    places: list[tuple[float, float, float]] = []
    for start, end in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        middle = (start + end) / 2
        vertices = [(start, 0.0)]
        if (disc := discs.pop(_key(*middle), None)) is not None:
            reach = disc.radius / float(np.abs(end - start).sum()) * (end - start)
            vertices += [(middle - reach, -1.0 if disc.is_black else 1.0), (middle + reach, 0.0)]
        places += [(float(x) + shift[0], height - float(y) - shift[1], bulge) for (x, y), bulge in vertices]
    return places


def _entities(
    shape: Disc | Text, layer: str, shift: tuple[float, float], height: float
) -> Iterator[tuple[int, object]]:
    x, y = shift
    if isinstance(shape, Disc):
        for radius in (shape.radius, shape.hole):
            if radius:
                yield from [(0, "CIRCLE"), (8, layer), (10, shape.x + x), (20, height - shape.y - y), (30, 0.0)]
                yield (40, radius)
    else:
        yield from [(0, "TEXT"), (8, layer), (10, shape.x + x), (20, height - shape.y - y), (30, 0.0)]
        yield from [(40, 0.7 * shape.size), (1, shape.text)]


def _polyline(layer: str, points: list[tuple[float, float, float]]) -> list[tuple[int, object]]:
    pairs: list[tuple[int, object]] = [(0, "POLYLINE"), (8, layer), (66, 1), (10, 0.0), (20, 0.0), (30, 0.0), (70, 1)]
    for x, y, bulge in points:
        pairs += [(0, "VERTEX"), (8, layer), (10, x), (20, y), (30, 0.0), *([(42, bulge)] if bulge else [])]
    return [*pairs, (0, "SEQEND"), (8, layer)]


def _value(value: object) -> str:
    return f"{value:.6f}" if isinstance(value, float) else str(value)
