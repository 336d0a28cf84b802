"""Pages as PDF: vector shapes and the standard font Courier, nothing embedded.

Source: ISO 32000-1:2008, chapters 7.5 (file), 8.4 and 8.5 (graphics), 9.6.2 (standard fonts), 12.2 (viewer preferences).
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import numpy as np

from binocal.printing.drawing import Area, Disc, Group, Page, Shape

POINTS_PER_MM = 72 / 25.4
N_ARCS = 8  # of a circle; its cubic curves are then off by 4e-6 of the radius


def pdf_content(pages: Sequence[Page], title: str) -> bytes:
    """A document of the pages, which asks viewers not to scale it when they print."""
    objects: list[bytes] = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"",
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Courier /Encoding /WinAnsiEncoding >>",
        b"<< /Title (" + _escaped(title) + b") /Creator (binocal) >>",
    ]
    kids = []
    for page in pages:
        stream = zlib.compress(_commands(page).encode("latin-1", "replace"), 9)
        contents = len(objects) + 2
        kids.append(len(objects) + 1)
        box = " ".join(_number(POINTS_PER_MM * side) for side in (0.0, 0.0, page.width, page.height))
        objects.append(
            f"<< /Type /Page /Parent 2 0 R /MediaBox [{box}] /Contents {contents} 0 R "
            "/Resources << /Font << /F1 3 0 R >> >> >>".encode()
        )
        objects.append(f"<< /Length {len(stream)} /Filter /FlateDecode >>\nstream\n".encode() + stream + b"\nendstream")
    names = " ".join(f"{kid} 0 R" for kid in kids)
    objects[1] = f"<< /Type /Pages /Kids [{names}] /Count {len(kids)} >>".encode()
    return _file(objects)


def _file(objects: list[bytes]) -> bytes:
    """The objects, numbered from 1, with their table of offsets; the first is the catalogue, the fourth the information."""
    content = bytearray(b"%PDF-1.6\n%\xe2\xe3\xcf\xd3\n")
    offsets = []
    for number, body in enumerate(objects, start=1):
        offsets.append(len(content))
        content += b"%d 0 obj\n" % number + body + b"\nendobj\n"
    start = len(content)
    content += b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1)
    content += b"".join(b"%010d 00000 n \n" % offset for offset in offsets)
    content += b"trailer\n<< /Size %d /Root 1 0 R /Info 4 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (len(objects) + 1, start)
    return bytes(content)


def _commands(page: Page) -> str:
    """The page's content in millimetres, y down: what is drawn is mirrored once, text once more."""
    scale = _number(POINTS_PER_MM)
    return "\n".join(
        [
            f"{scale} 0 0 -{scale} 0 {_number(POINTS_PER_MM * page.height)} cm 0 g",
            *(_group(group) for group in page.groups),
        ]
    )


def _group(group: Group) -> str:
    lines = ["q"]
    if group.clip is not None:
        x0, y0, x1, y1 = group.clip
        lines.append(f"{_number(x0)} {_number(y0)} {_number(x1 - x0)} {_number(y1 - y0)} re W n")
    lines.append(f"1 0 0 1 {_number(group.shift[0])} {_number(group.shift[1])} cm")
    return "\n".join([*lines, *(_shape(shape) for shape in group.shapes), "Q"])


def _shape(shape: Shape) -> str:
    if isinstance(shape, Area):
        outlines = [
            " ".join(f"{_number(x)} {_number(y)} {'l' if i else 'm'}" for i, (x, y) in enumerate(outline)) + " h"
            for outline in shape.outlines
        ]
        return "\n".join([*outlines, "f"])
    if isinstance(shape, Disc):
        return _circle(shape) if shape.is_black else f"1 g {_circle(shape)} 0 g"
    text = _escaped(shape.text).decode("latin-1")
    return f"BT /F1 {_number(shape.size)} Tf 1 0 0 -1 {_number(shape.x)} {_number(shape.y)} Tm ({text}) Tj ET"


def _circle(disc: Disc) -> str:
    """A disc, or what lies between two circles."""
    if not disc.hole:
        return _path(disc.x, disc.y, disc.radius) + " f"
    return f"{_path(disc.x, disc.y, disc.radius)} {_path(disc.x, disc.y, disc.hole)} f*"


def _path(x: float, y: float, radius: float) -> str:
    """A circle of cubic curves; each tangent handle is 4/3 tan of a quarter of the arc's angle, radii."""
    step = 2 * np.pi / N_ARCS
    handle = 4 / 3 * np.tan(step / 4)
    parts = []
    for i in range(N_ARCS):
        a, b = i * step, (i + 1) * step
        at = np.array(
            [
                [np.cos(a) - handle * np.sin(a), np.sin(a) + handle * np.cos(a)],
                [np.cos(b) + handle * np.sin(b), np.sin(b) - handle * np.cos(b)],
                [np.cos(b), np.sin(b)],
            ]
        )
        parts.append(" ".join(map(_number, (radius * at + [x, y]).ravel())) + " c")
    return f"{_number(x + radius)} {_number(y)} m " + " ".join(parts)


def _escaped(text: str) -> bytes:
    return text.encode("latin-1", "replace").replace(b"\\", b"\\\\").replace(b"(", b"\\(").replace(b")", b"\\)")


def _number(value: float) -> str:
    """To a tenth of a micrometre; PDF knows no exponents."""
    return f"{value:.7f}".rstrip("0").rstrip(".")
