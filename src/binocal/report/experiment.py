"""Figures of an experiment: what each method came to, with its spread, readable in grey."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from binocal.errors import MissingExtraError

WIDTH_INCHES, FRAME_INCHES = 8.0, 1.35
ROW_INCHES, CASE_INCHES = 0.18, 0.16  # of a method, and of each of its cases
MARKS = (
    *(("o", "#0072b2"), ("s", "#d55e00"), ("^", "#4d4d4d"), ("v", "#56b4e9"), ("P", "#8c5a00"), ("X", "#999999")),
    *(("<", "#009e73"), (">", "#b0558f"), ("*", "#000000"), ("p", "#6a6a6a"), ("h", "#0072b2"), ("d", "#d55e00")),
)
"""Shape and colour of each case: the shapes tell them apart in grey (colours of Okabe & Ito 2008 and greys)."""


@dataclass(frozen=True, slots=True)
class Span:
    """One method on one case: median, least and greatest, and what the paper prints of it."""

    label: str
    case: str
    median: float
    low: float
    high: float
    paper: float | None = None


def draw_spans(spans: Sequence[Span], axis: str, title: str, *, is_log: bool = False) -> str:
    """A row for each method, a mark for each case with a line from least to greatest; hollow diamonds are the paper's. SVG.

    Raises:
        ValueError: There is nothing to draw.
        MissingExtraError: Matplotlib is not installed.
    """
    if not spans:
        raise ValueError("nothing to draw")
    try:
        import matplotlib
        from matplotlib.backends.backend_svg import FigureCanvasSVG
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError("figures", "report") from error

    labels, cases = (list(dict.fromkeys(getattr(span, key) for span in spans)) for key in ("label", "case"))
    figure = Figure(
        figsize=(WIDTH_INCHES, FRAME_INCHES + len(labels) * (ROW_INCHES + CASE_INCHES * len(cases))),
        layout="constrained",
    )
    FigureCanvasSVG(figure)
    axes = figure.subplots()
    offsets = 0.4 * (np.arange(len(cases)) * 2 - len(cases) + 1) / len(cases)
    for place, case in enumerate(cases):
        shape, colour = MARKS[place % len(MARKS)]
        some = [span for span in spans if span.case == case]
        y = [labels.index(span.label) + offsets[place] for span in some]
        axes.hlines(y, [s.low for s in some], [s.high for s in some], color=colour, linewidth=1.2)
        axes.plot([s.median for s in some], y, shape, color=colour, markersize=5, label=case, linestyle="none")
        printed = [(s.paper, at) for s, at in zip(some, y, strict=True) if s.paper is not None]
        if printed:
            x, at = zip(*printed, strict=True)
            axes.plot(x, at, "D", markerfacecolor="white", color=colour, markersize=5, linestyle="none")
    if any(span.paper is not None for span in spans):
        axes.plot([], [], "D", markerfacecolor="white", color="0.2", linestyle="none", label="printed in the paper")
    axes.set_yticks(range(len(labels)), labels)
    axes.set_ylim(len(labels) - 0.5, -0.5)
    axes.set(xlabel=axis, title=title)
    if is_log:
        axes.set_xscale("log")
        low, high = axes.get_xlim()
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.xaxis.set_minor_formatter(
            lambda value, _: f"{value:g}" if high < 100 * low and f"{value:e}"[0] in "246" else ""
        )
    axes.grid(axis="x", color="0.88", linewidth=0.6)
    for at in np.arange(0.5, len(labels) - 1):
        axes.axhline(at, color="0.93", linewidth=0.6)
    figure.legend(loc="outside lower center", ncols=3, fontsize="small", frameon=False)
    content = io.StringIO()
    # text stays text, the same rows give the same bytes, and names differ between the figures of a page
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": title}):
        figure.savefig(content, format="svg", metadata={"Date": None, "Title": title})
    return content.getvalue()
