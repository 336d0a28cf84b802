"""Corners on Matplotlib's axes: where they were seen, and how far they lie from their predictions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray

from binocal.report.axes import draw_dots, draw_map, draw_strokes, image_axes
from binocal.report.svg import FAINT, LEFT, RIGHT, WARN, Tip
from binocal.shapes import Float
from binocal.validation import SmoothedResiduals

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SIDES = {"left": LEFT, "right": RIGHT}
CELLS = 8, 6  # columns and rows in which corners are counted
MOST_ARROWS, MOST_DOTS = 1500, 4000  # of one camera; cells are counted over all corners
MOST_BARS = 60  # views; of more, a line takes less room
MOST_TIPS = 300  # of one figure
ARROW_SHARE = 0.04  # of the image's diagonal: the length of an arrow that only one in twenty exceeds


def draw_coverage(axes: Axes, px: Float[ndarray, "views n 2"], size_wh: tuple[int, int], side: str) -> Sequence[Tip]:
    """The corners of all views in one camera's image, and the cells of it that have none."""
    from matplotlib.patches import Rectangle

    image_axes(axes, size_wh, f"{side} camera")
    seen = px[np.isfinite(px[..., 0])]
    counts, xs, ys = np.histogram2d(
        seen[:, 0], seen[:, 1], bins=CELLS, range=((-0.5, size_wh[0] - 0.5), (-0.5, size_wh[1] - 0.5))
    )
    xs, ys = xs.tolist(), ys.tolist()
    tips = []
    for i, j in np.ndindex(counts.shape):
        n = int(counts[i, j])
        tips.append(Tip((xs[i] + xs[i + 1]) / 2, (ys[j] + ys[j + 1]) / 2, f"{n} corner{'' if n == 1 else 's'} here"))
        if n == 0:
            cell = Rectangle((xs[i], ys[j]), xs[i + 1] - xs[i], ys[j + 1] - ys[j], color=WARN, alpha=0.18, linewidth=0)
            axes.add_patch(cell)
    draw_dots(axes, seen[:: max(1, -(-len(seen) // MOST_DOTS))], SIDES[side], size=1.6)
    return tips


def draw_residuals(
    axes: Axes,
    px: Float[ndarray, "views n 2"],
    residuals: Float[ndarray, "views n 2"],
    size_wh: tuple[int, int],
    side: str,
) -> Sequence[Tip]:
    """Residuals of one camera as arrows at their corners, enlarged; the factor stands in the title."""
    image_axes(axes, size_wh, f"{side} camera")
    known = np.isfinite(residuals[..., 0]) & np.isfinite(px[..., 0])
    start, off = px[known], residuals[known]
    if not len(start):
        return ()
    every = max(1, -(-len(start) // MOST_ARROWS))
    start, off = start[::every], off[::every]
    factor = enlargement(off, size_wh)
    draw_strokes(axes, start, start + factor * off, SIDES[side])
    draw_dots(axes, start, FAINT, size=0.8)
    few = "" if every == 1 else f", one in {every}"
    axes.set_title(f"{side} camera: residuals x {factor:.3g}{few}")
    return [
        Tip(x, y, f"({dx:+.3f}, {dy:+.3f}) px at ({x:.0f}, {y:.0f})")
        for (x, y), (dx, dy) in zip(
            start[:: max(1, len(start) // MOST_TIPS)].tolist(),
            off[:: max(1, len(start) // MOST_TIPS)].tolist(),
            strict=True,
        )
    ]


def draw_smoothed(axes: Axes, smoothed: SmoothedResiduals, size_wh: tuple[int, int], side: str) -> Sequence[Tip]:
    """What residuals of one camera have in common over its image: their mean's length by colour, its direction by arrows."""
    image_axes(axes, size_wh, f"{side} camera: mean residual")
    tips = draw_map(axes, smoothed.px, np.linalg.norm(smoothed.mean_px, axis=-1), "px")
    known = np.isfinite(smoothed.sigma_px)
    if known.any():
        start, off = smoothed.px[known], smoothed.mean_px[known]
        draw_strokes(axes, start, start + enlargement(off, size_wh) * off, "white", width=0.9)
    return tips


def draw_board_points(
    axes: Axes, points_m: Float[ndarray, "n 3"], by_point_px: Float[ndarray, "n 4"], unit: tuple[str, float]
) -> Sequence[Tip]:
    """The mean residual of every board point over all views, in both cameras, as arrows on the board; ``unit`` prints lengths."""
    xy = unit[1] * points_m[:, :2]
    axes.set(xlabel=f"x ({unit[0]})", ylabel=f"y ({unit[0]})")
    axes.set_aspect("equal", adjustable="datalim")
    usual = np.nanquantile(np.abs(by_point_px), 0.95) if np.isfinite(by_point_px).any() else 0.0
    apart = np.linalg.norm(xy[:, None] - xy[None], axis=-1)
    spacing = float(apart[apart > 0].min(initial=np.inf))
    factor = 0.6 * spacing / usual if usual > 0 and np.isfinite(spacing) else 1.0
    draw_dots(axes, xy, FAINT, size=2.0)
    tips = []
    for side, columns in (("left", slice(0, 2)), ("right", slice(2, 4))):
        off = by_point_px[:, columns]
        known = np.isfinite(off).all(axis=-1)
        draw_strokes(axes, xy[known], xy[known] + factor * off[known], SIDES[side], width=1.1, label=side)
    for (x, y), (a, b, c, d) in zip(xy.tolist(), by_point_px.tolist(), strict=True):
        tips.append(Tip(x, y, f"left ({a:+.3f}, {b:+.3f}) px, right ({c:+.3f}, {d:+.3f}) px"))
    axes.invert_yaxis()
    axes.set_title(f"Mean residual by board point (95 % below {usual:.2g} px)")
    axes.margins(0.12)
    axes.legend(loc="lower right", ncols=2)
    return tips


def enlargement(off: Float[ndarray, "n 2"], size_wh: tuple[int, int]) -> float:
    """A round factor by which arrows are long enough to be seen: all but one in twenty stay below a share of the diagonal."""
    usual = float(np.quantile(np.linalg.norm(off, axis=-1), 0.95))
    if not usual > 0:
        return 1.0
    wanted = ARROW_SHARE * float(np.hypot(*size_wh)) / usual
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(max(step * power for step in (1, 2, 5) if step * power <= wanted))


def draw_views(axes: Axes, names: Sequence[str], left_px: Sequence[float], right_px: Sequence[float]) -> Sequence[Tip]:
    """The RMS of every view in both cameras, along the sequence."""
    place = np.arange(len(names), dtype=float)
    for values, side, shift in ((left_px, "left", -0.2), (right_px, "right", 0.2)):
        if len(names) <= MOST_BARS:
            axes.bar(place + shift, np.nan_to_num(values), 0.38, color=SIDES[side], label=side)
        else:
            axes.plot(place, values, color=SIDES[side], linewidth=0.8, label=side)
    axes.set(title="RMS of each view", xlabel="view, in the sequence", ylabel="RMS (px)", xlim=(-0.6, len(names) - 0.4))
    axes.legend(loc="upper right", ncols=2)
    top = np.nanmax([*left_px, *right_px], initial=0.0)
    axes.set_ylim(0, 1.25 * top if top > 0 else 1.0)
    tips = [
        Tip(x, max(np.nan_to_num([a, b])), f"view {name}: left {_px(a)}, right {_px(b)}")
        for x, name, a, b in zip(place.tolist(), names, left_px, right_px, strict=True)
    ]
    return tips[:: max(1, -(-len(tips) // MOST_TIPS))]


def draw_view_means(axes: Axes, names: Sequence[str], by_view_px: Float[ndarray, "views 4"]) -> Sequence[Tip]:
    """The mean residual of every view in both cameras (left x, y, right x, y), along the sequence: noise where they are white."""
    place = np.arange(len(names), dtype=float)
    axes.axhline(0, color=FAINT, linewidth=0.6)
    for column, (side, axis) in enumerate((side, axis) for side in SIDES for axis in "xy"):
        style = "-" if axis == "x" else ":"
        axes.plot(place, by_view_px[:, column], style, color=SIDES[side], linewidth=1.1, label=f"{side} {axis}")
    axes.set(title="Mean residual of each view", xlabel="view, in the sequence", ylabel="mean (px)")
    axes.margins(y=0.25)
    axes.legend(loc="upper right", ncols=4, handlelength=1.3, columnspacing=0.9)
    tips = []
    for x, name, (a, b, c, d) in zip(place.tolist(), names, by_view_px.tolist(), strict=True):
        text = f"view {name}: left ({a:+.3f}, {b:+.3f}) px, right ({c:+.3f}, {d:+.3f}) px"
        tips.append(Tip(x, float(np.nan_to_num([a, b, c, d]).max()), text))
    return tips[:: max(1, -(-len(tips) // MOST_TIPS))]


def _px(value: float) -> str:
    return f"{value:.3f} px" if np.isfinite(value) else "not seen"
