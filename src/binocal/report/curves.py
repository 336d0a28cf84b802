"""A figure of curves over iterations, readable in grey."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from binocal.errors import MissingExtraError

SIZE_INCHES = (8.0, 4.8)
LOOKS = (
    *(("o", "-", "#0072b2"), ("s", "--", "#d55e00"), ("^", "-.", "#4d4d4d"), ("v", ":", "#009e73")),
    *(("D", "-", "#8c5a00"), ("X", "--", "#b0558f"), ("P", "-.", "#000000"), ("*", ":", "#56b4e9")),
)
NEW_STAGE = 3.0  # times the value before: no step of a solver, but the start of a method's next stage
SAME = 0.01  # curves that differ by no more, relatively, are one curve with several names


@dataclass(frozen=True, slots=True)
class Curve:
    """What a method came to after so many iterations."""

    label: str
    iterations: tuple[int, ...]
    values: tuple[float, ...]


def draw_curves(curves: Sequence[Curve], axis: str, title: str, marked: Mapping[str, float] | None = None) -> str:
    """Values on a logarithmic axis over iterations on one that is wider at its start; ``marked`` are vertical lines by name. SVG.

    Raises:
        ValueError: There is nothing to draw.
        MissingExtraError: Matplotlib is not installed.
    """
    if not curves:
        raise ValueError("nothing to draw")
    try:
        import matplotlib
        from matplotlib.backends.backend_svg import FigureCanvasSVG
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError("figures", "report") from error

    figure = Figure(figsize=SIZE_INCHES, layout="constrained")
    FigureCanvasSVG(figure)
    axes = figure.subplots()
    for place, (curve, names) in enumerate(_grouped(curves)):
        mark, line, colour = LOOKS[place % len(LOOKS)]
        axes.plot(*_broken(curve), line, marker=mark, color=colour, markersize=4, label=", ".join(names))
    axes.set_xscale("function", functions=(lambda x: np.sqrt(np.maximum(x, 0)), np.square))
    axes.set_yscale("log")
    last = max(curve.iterations[-1] for curve in curves)
    axes.set_xticks([n for n in (0, 1, 2, 5, 10, 20, 30, 40, 50, 60, 70, 80, 100) if n <= last])
    axes.set(xlabel="iterations", ylabel=axis, title=title, xlim=(0, last))
    for name, at in (marked or {}).items():
        axes.axvline(at, color="0.35", linewidth=1, linestyle=(0, (1, 2)))
        axes.annotate(
            name, (at, 0.97), (-4, 0), xycoords=axes.get_xaxis_transform(), textcoords="offset points", rotation=90,
            va="top", ha="right", bbox={"facecolor": "white", "edgecolor": "none", "pad": 1},
        )  # fmt: skip
    axes.grid(color="0.9", linewidth=0.6)
    figure.legend(loc="outside lower center", ncols=2, fontsize="small", frameon=False)
    content = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": title}):
        figure.savefig(content, format="svg", metadata={"Date": None, "Title": title})
    return content.getvalue()


def _broken(curve: Curve) -> tuple[list[float], list[float]]:
    """The curve in pieces, with a gap before each value that is so much larger than the one before it."""
    x, y = [float(curve.iterations[0])], [curve.values[0]]
    for before, at, value in zip(curve.values, curve.iterations[1:], curve.values[1:], strict=False):
        if value > NEW_STAGE * before:
            x.append(float("nan"))
            y.append(float("nan"))
        x.append(float(at))
        y.append(value)
    return x, y


def _grouped(curves: Sequence[Curve]) -> list[tuple[Curve, list[str]]]:
    """Curves that lie on each other as one."""
    groups: list[tuple[Curve, list[str]]] = []
    for curve in curves:
        for known, names in groups:
            if known.iterations == curve.iterations and np.allclose(known.values, curve.values, rtol=SAME, atol=0):
                names.append(curve.label)
                break
        else:
            groups.append((curve, [curve.label]))
    return groups
