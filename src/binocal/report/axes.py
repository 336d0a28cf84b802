"""What several figures share: axes of an image, dots and strokes as one path, a map with contours."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray

from binocal.report.numbers import two_digits
from binocal.report.svg import MAP_COLOURS, Tip
from binocal.shapes import Float

if TYPE_CHECKING:
    from matplotlib.axes import Axes

N_LEVELS = 9


def image_axes(axes: Axes, size_wh: tuple[int, int], title: str) -> None:
    """Axes of an image's pixels, y down, with a border."""
    width, height = size_wh
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), title=title, xlabel="x (px)", ylabel="y (px)")
    axes.set_aspect("equal")
    axes.locator_params(nbins=6)
    for spine in axes.spines.values():
        spine.set_visible(True)


def image_height(size_wh: tuple[int, int], width: float) -> float:
    """The height of a figure, inches, of which the axes fit an image of that size; neither flat nor towering."""
    return float(np.clip(0.74 * width * size_wh[1] / size_wh[0] + 0.75, 2.0, 6.0))


def draw_dots(axes: Axes, px: Float[ndarray, "n 2"], colour: str, *, size: float = 2.0, **options: Any) -> None:
    """Points as one path: a thousand markers would each be an element of the file."""
    draw_strokes(axes, px, px + 1e-3, colour, width=size, **options)


def draw_strokes(
    axes: Axes,
    start: Float[ndarray, "n 2"],
    end: Float[ndarray, "n 2"],
    colour: str,
    *,
    width: float = 0.6,
    **options: Any,
) -> None:
    """Lines from here to there as one path."""
    apart = np.full((len(start), 2), np.nan)
    line = np.stack([start, end, apart], axis=1).reshape(-1, 2)
    axes.plot(line[:, 0], line[:, 1], color=colour, linewidth=width, solid_capstyle="round", **options)


def draw_map(
    axes: Axes, px: Float[ndarray, "rows columns 2"], values: Float[ndarray, "rows columns"], unit: str
) -> tuple[Tip, ...]:
    """A map over an image by filled contours, with a bar of its colours and a tip at every place; blank where it is NaN.

    The unit joins the title of the axes.
    """
    axes.set_title(f"{axes.get_title()} ({unit})")
    known = np.isfinite(values)
    if not known.any():
        axes.text(0.5, 0.5, "nothing to show here", transform=axes.transAxes, ha="center", va="center")
        return ()
    low, high = float(values[known].min()), float(values[known].max())
    shown = np.ma.masked_invalid(values)
    if known.sum() >= 4 and min(values.shape) > 1:
        levels = _levels(low, high)
        norm = _norm(levels)
        drawn = axes.contourf(px[..., 0], px[..., 1], shown, levels=levels, cmap=MAP_COLOURS, norm=norm)
        bar = axes.figure.colorbar(drawn, cax=axes.inset_axes((1.03, 0.0, 0.035, 1.0)))
        bar.outline.set_visible(False)
        bar.ax.set_yticks(levels[::2], [two_digits(level) for level in levels[::2]])
    return tuple(
        Tip(float(x), float(y), f"{value:.3g} {unit} at ({x:.0f}, {y:.0f})")
        for (x, y), value in zip(px[known].tolist(), values[known].tolist(), strict=True)
    )


def _levels(low: float, high: float) -> Float[ndarray, "k"]:
    """Levels of a map in even steps, or in even ratios where the largest is far above the least."""
    if high - low <= 1e-9 * max(abs(low), abs(high), 1e-12):
        low, high = low - max(abs(low), 1e-12) * 0.05, high + max(abs(high), 1e-12) * 0.05
    levels = np.geomspace(low, high, N_LEVELS) if low > 0 and high / low > 3 else np.linspace(low, high, N_LEVELS)
    margin = 1e-6 * (high - low)
    levels[0], levels[-1] = levels[0] - min(margin, 0.5 * abs(low) or margin), levels[-1] + margin
    return levels


def _norm(levels: Float[ndarray, "k"]) -> Any:
    from matplotlib.colors import BoundaryNorm

    return BoundaryNorm(levels, 256)
