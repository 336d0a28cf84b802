"""Matplotlib's figures as SVG that stands within a page and takes its colours from there, light or dark.

A page under a strict content security policy has no style attributes: they become attributes of their own (``fill``, ``stroke``), and
the colours of :data:`THEMED` become variables of the page's style sheet.
"""

from __future__ import annotations

import html
import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from binocal.errors import MissingExtraError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LEFT, RIGHT, GOOD, WARN = (
    "#0072b2",
    "#d55e00",
    "#009e73",
    "#cc79a7",
)  # distinct to every colour vision (Okabe & Ito 2008)
INK, FAINT = "#010203", "#010204"  # stand for the page's text and lines
THEMED = {
    INK: "var(--ink)",
    FAINT: "var(--faint)",
    LEFT: "var(--left)",
    RIGHT: "var(--right)",
    GOOD: "var(--good)",
    WARN: "var(--mark)",
}
WIDTH_INCHES = 4.6  # two stand side by side on a wide screen, and text stays readable on one of 400 pixels
MAP_COLOURS = "cividis"  # rises evenly in lightness, for every colour vision
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "binocal",
    "path.simplify": False,
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.titley": 1.0,  # looking for a free place takes a quarter of the time
    "axes.labelsize": 8.5,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.edgecolor": FAINT,
    "xtick.color": FAINT,
    "ytick.color": FAINT,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "grid.color": FAINT,
    "grid.linewidth": 0.4,
    "grid.alpha": 0.5,
}  # fmt: skip

Draw = Callable[["Axes"], "Sequence[Tip] | None"]


@dataclass(frozen=True, slots=True)
class Tip:
    """What is shown for the place (x, y) of a figure, in its data's coordinates."""

    x: float
    y: float
    text: str


@dataclass(frozen=True, slots=True)
class FigureSvg:
    """A figure for a page: SVG text, and the tips as (x, y, text) in the SVG's own coordinates."""

    svg: str
    tips: tuple[tuple[float, float, str], ...] = ()


def figure_svg(draw: Draw, *, name: str, title: str, height: float = 3.2, width: float = WIDTH_INCHES) -> FigureSvg:
    """What a function draws on axes, with its tips; ``title`` is read to whoever does not see it, ``name`` is unique in the page.

    Raises:
        MissingExtraError: Matplotlib is not installed.
    """
    try:
        import matplotlib
        from matplotlib.backends.backend_svg import FigureCanvasSVG
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError("the report", "report") from error
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(width, height), dpi=72)
        FigureCanvasSVG(figure)
        axes = figure.subplots()
        tips = draw(axes) or ()
        right = 0.84 if axes.child_axes else 0.97  # a bar of colours stands beside the axes
        figure.subplots_adjust(left=0.17, right=right, bottom=0.42 / height, top=1 - 0.28 / height)
        content = io.BytesIO()
        figure.savefig(content, format="svg", metadata={"Date": None})
        places = axes.transData.transform([(tip.x, tip.y) for tip in tips]) if tips else ()
    shown = tuple(
        (round(float(x), 1), round(72 * height - float(y), 1), tip.text)
        for (x, y), tip in zip(places, tips, strict=True)
    )
    return FigureSvg(themed(content.getvalue().decode(), name=name, title=title), shown)


def themed(svg: str, *, name: str, title: str) -> str:
    """Matplotlib's SVG text as an element of a page: without style attributes, ids of its own, named for screen readers."""
    body = svg[svg.index("<svg") :]
    body = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>", "", body, flags=re.DOTALL)
    body = re.sub(r'style="([^"]*)"', _attributes, body)
    body = re.sub(r'\bd="([^"]*)"', _rounded, body)
    body = re.sub(r'(<(?:g|text)\b[^>]*?) id="[^"]*"', r"\1", body)
    body = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', body)
    body = re.sub(r"url\(#([^)]+)\)", rf"url(#{name}-\1)", body)
    body = re.sub(r'(?:xlink:)?href="#([^"]+)"', rf'href="#{name}-\1"', body)
    body = re.sub(r'\stransform="rotate\(-?0 [^)]*\)"', "", body)
    body = re.sub(r">\s+<", "><", body)
    found = re.match(r'<svg[^>]*viewBox="([^"]*)"[^>]*>', body)
    assert found, "Matplotlib writes an svg element with a viewBox"
    label = html.escape(title, quote=True)
    return f'<svg viewBox="{found[1]}" role="img" aria-label="{label}">{body[found.end() :]}'.strip()


def _attributes(found: re.Match[str]) -> str:
    """A style attribute's declarations as presentation attributes; the font is the page's."""
    parts = []
    for declaration in found[1].split(";"):
        key, _, value = declaration.partition(":")
        key, value = key.strip(), value.strip()
        if not value or key == "font-family":
            continue
        if key == "font":  # of mathematical text: style, size and family in one
            size = re.search(r"([\d.]+)px", value)
            key, value = "font-size", f"{size[1]}px" if size else "9px"
        parts.append(f'{key}="{html.escape(THEMED.get(value, value), quote=True)}"')
    return " ".join(parts)


def _rounded(found: re.Match[str]) -> str:
    """A path with coordinates to a hundredth of a point."""
    text = re.sub(r"-?\d+\.\d{3,}", lambda number: f"{float(number[0]):.2f}", found[1])
    return f'd="{" ".join(text.split())}"'
