"""A page as SVG, in millimetres. Source: W3C, SVG 1.1 (Second Edition)."""

from __future__ import annotations

from xml.sax.saxutils import escape

from binocal.printing.drawing import ADVANCE, Area, Disc, Group, Page, Shape


def svg_text(page: Page, title: str) -> str:
    """The page as an SVG document of its own size."""
    width, height = _number(page.width), _number(page.height)
    return "\n".join(
        [
            '<?xml version="1.0" encoding="UTF-8"?>',
            f'<svg xmlns="http://www.w3.org/2000/svg" version="1.1" width="{width}mm" height="{height}mm" '
            f'viewBox="0 0 {width} {height}">',
            f"<title>{escape(title)}</title>",
            f'<rect width="{width}" height="{height}" fill="#fff"/>',
            *(_group(group, i) for i, group in enumerate(page.groups)),
            "</svg>",
            "",
        ]
    )


def _group(group: Group, index: int) -> str:
    lines = []
    clip = ""
    if group.clip is not None:
        x0, y0, x1, y1 = group.clip
        box = f'x="{_number(x0)}" y="{_number(y0)}" width="{_number(x1 - x0)}" height="{_number(y1 - y0)}"'
        lines.append(f'<clipPath id="clip{index}"><rect {box}/></clipPath>')
        clip = f' clip-path="url(#clip{index})"'
    x, y = map(_number, group.shift)
    lines.append(f'<g id="{group.name}{index}" fill="#000"{clip}><g transform="translate({x} {y})">')
    return "\n".join([*lines, *map(_shape, group.shapes), "</g></g>"])


def _shape(shape: Shape) -> str:
    if isinstance(shape, Area):
        outlines = (
            "M" + "L".join(f"{_number(x)} {_number(y)}" for x, y in outline) + "Z" for outline in shape.outlines
        )
        return f'<path fill-rule="evenodd" d="{" ".join(outlines)}"/>'
    if isinstance(shape, Disc) and shape.hole:
        middle, width = 0.5 * (shape.radius + shape.hole), shape.radius - shape.hole
        centre = f'cx="{_number(shape.x)}" cy="{_number(shape.y)}"'
        return f'<circle {centre} r="{_number(middle)}" fill="none" stroke="#000" stroke-width="{_number(width)}"/>'
    if isinstance(shape, Disc):
        fill = "" if shape.is_black else ' fill="#fff"'
        return f'<circle cx="{_number(shape.x)}" cy="{_number(shape.y)}" r="{_number(shape.radius)}"{fill}/>'
    length = _number(ADVANCE * shape.size * len(shape.text))
    return (
        f'<text x="{_number(shape.x)}" y="{_number(shape.y)}" font-family="Courier, monospace" '
        f'font-size="{_number(shape.size)}" textLength="{length}" xml:space="preserve">{escape(shape.text)}</text>'
    )


def _number(value: float) -> str:
    return f"{value:.6f}".rstrip("0").rstrip(".")
