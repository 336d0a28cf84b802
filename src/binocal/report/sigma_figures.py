"""Uncertainty on Matplotlib's axes: projection over an image, depth over range and over an image, halves and the lens's profile."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray

from binocal.report.axes import draw_map, image_axes
from binocal.report.corner_figures import SIDES
from binocal.report.numbers import three_digits, two_digits
from binocal.report.svg import FAINT, GOOD, INK, LEFT, RIGHT, Tip
from binocal.requirements.figures import COVERAGE
from binocal.shapes import Float
from binocal.uncertainty.maps import ProjectionMap, RangeMap
from binocal.validation import LensAdequacy

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_depth_over_range(axes: Axes, ranges: Sequence[RangeMap], unit: str) -> Sequence[Tip]:
    """The 95 % error of depth over range: in the middle of the common view, split by cause, and at its worst place."""
    seen = [m for m in ranges if m.field.is_common.any()]
    depth = [m.field.depth_m for m in seen]
    causes = {
        "calibration": (LEFT, "-", [m.depth.calibration_m[m.field.middle] for m in seen]),
        "matching": (RIGHT, "-", [m.depth.matching_m[m.field.middle] for m in seen]),
        "size of the board": (GOOD, "-", [m.depth.board_m[m.field.middle] for m in seen]),
        "all, in the middle": (INK, "-", [m.depth.total_m[m.field.middle] for m in seen]),
        "all, at the worst place": (INK, "--", [m.depth.total_m[m.worst] for m in seen]),
    }
    axes.set(title="95 % error of depth over range", xlabel=f"range ({unit})", ylabel="of the range (%)")
    axes.set(xscale="log", yscale="log")
    tips = []
    for name, (colour, style, sigma) in causes.items():
        percent = 100 * COVERAGE * np.array(sigma) / np.array(depth)
        if not (np.isfinite(percent) & (percent > 0)).any():
            continue
        axes.plot(depth, percent, linestyle=style, color=colour, linewidth=1.5, label=name)
        tips += [
            Tip(d, p, f"{name}: {two_digits(p)} % at {three_digits(d)} {unit}")
            for d, p in zip(depth, percent.tolist(), strict=True)
            if p > 0
        ]
    axes.grid(True, which="major")
    if tips:
        axes.legend(loc="best")
        _plain_ticks(axes)
    return tips


def draw_depth_map(axes: Axes, at: RangeMap, size_wh: tuple[int, int], unit: str, cause: str) -> Sequence[Tip]:
    """The 95 % error of depth by one cause (calibration, matching) over the left image at one range; blank where one camera sees."""
    image_axes(axes, size_wh, f"depth at {three_digits(at.field.depth_m)} {unit}, {cause}")
    sigma_m = at.depth.calibration_m if cause == "calibration" else at.depth.matching_m
    percent = 100 * COVERAGE * sigma_m / at.depth.depth_m
    return draw_map(axes, at.field.left_px, np.where(at.field.is_common, percent, np.nan), "%")


def draw_projection_map(axes: Axes, at: ProjectionMap, size_wh: tuple[int, int]) -> Sequence[Tip]:
    """Standard deviation of a camera's projection over its image."""
    image_axes(axes, size_wh, f"{at.side} camera: sigma of projection")
    return draw_map(axes, at.px, at.sigma_px, "px")


def draw_halves(
    axes: Axes,
    px: Float[ndarray, "rows columns 2"],
    off_px: Float[ndarray, "rows columns"],
    size_wh: tuple[int, int],
    side: str,
) -> Sequence[Tip]:
    """How far apart two rigs, each from every other view, see one direction, over one camera's image."""
    image_axes(axes, size_wh, f"{side} camera: difference of halves")
    return draw_map(axes, px, off_px, "px")


def draw_lens_profile(axes: Axes, lens: LensAdequacy) -> Sequence[Tip]:
    """How far outwards of the model's prediction corners lie, by their distance from the principal point."""
    axes.set(title="What a free lens profile would change", xlabel="radius (px)", ylabel="outwards (px)")
    axes.axhline(0, color=FAINT, linewidth=0.6)
    tips = []
    for side, radius, profile in zip(("left", "right"), lens.radius_px, lens.profile_px, strict=True):
        axes.plot(radius, profile, color=SIDES[side], linewidth=1.5, label=side)
        tips += [
            Tip(r, p, f"{side}: {p:+.3f} px at {r:.0f} px from the middle")
            for r, p in zip(radius.tolist(), profile.tolist(), strict=True)
            if np.isfinite(p)
        ]
    axes.legend(loc="best")
    return tips


def _plain_ticks(axes: Axes) -> None:
    """Numbers as they are said, not as powers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
        axis.set_minor_locator(LogLocator(subs=()))
