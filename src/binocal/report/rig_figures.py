"""The rig and its board on Matplotlib's axes: seen from above, and the board's height above its mean plane."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray

from binocal.cameras import StereoRig
from binocal.planning import ViewPlan
from binocal.report.axes import draw_dots, image_axes
from binocal.report.corner_figures import SIDES
from binocal.report.numbers import three_digits
from binocal.report.scene import RigScene, board_corners
from binocal.report.svg import FAINT, GOOD, MAP_COLOURS, Tip
from binocal.result import BoardShape
from binocal.shapes import Float

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LENGTH_SCALE = {"x": 0, "y": 1, "z": 2}


def draw_plan(axes: Axes, plan: ViewPlan, points_m: Float[ndarray, "n 3"], rig: StereoRig) -> Sequence[Tip]:
    """Outlines of the boards to show next, in the left image, numbered in the order in which they help."""
    image_axes(axes, rig.left.size_wh, "left image")
    corners = board_corners(points_m)
    edge = np.concatenate([np.linspace(corners[i], corners[(i + 1) % 4], 6)[:-1] for i in range(4)])
    unit, factor = rig.printed_unit
    tips = []
    for number, view in enumerate(plan.views, start=1):
        px = rig.left.project(view.T_left_board.apply(np.concatenate([edge, edge[:1]])))
        axes.plot(px[:, 0], px[:, 1], color=GOOD, linewidth=1.2)
        axes.text(px[0, 0], px[0, 1], f"{number}", color=GOOD, fontsize=9, ha="right", va="bottom", clip_on=True)
        away = f", {view.away} side farther" if view.away else ""
        text = f"view {number}: {three_digits(factor * view.distance_m)} {unit} away, tilted by {view.tilt_deg:.0f} deg{away}"
        tips.append(Tip(*view.left_px, text))
    return tips


def draw_rig(axes: Axes, scene: RigScene, seen_from: str = "above") -> Sequence[Tip]:
    """Both cameras, what they see, and every board, from above (x right, z up) or from the side (z right, y down)."""
    across, along = ("x", "z") if seen_from == "above" else ("z", "y")
    a, b = LENGTH_SCALE[across], LENGTH_SCALE[along]
    axes.set(title=f"Seen from {'above' if seen_from == 'above' else 'the side'}")
    axes.set(xlabel=f"{across} ({scene.unit})", ylabel=f"{along} ({scene.unit})")
    axes.set_aspect("equal", adjustable="datalim")
    tips = []
    for board in scene.boards:
        closed = np.concatenate([board.outline, board.outline[:1]])
        colour, width = (GOOD, 1.4) if board.is_suggested else (FAINT, 0.9)
        axes.plot(closed[:, a], closed[:, b], color=colour, linewidth=width)
        middle = board.outline.mean(axis=0)
        tips.append(Tip(float(middle[a]), float(middle[b]), board.text))
    for camera in scene.cameras:
        colour = SIDES[camera.side]
        for point in camera.outline[:: max(len(camera.outline) // 4, 1)]:
            axes.plot([camera.centre[a], point[a]], [camera.centre[b], point[b]], color=colour, linewidth=0.8)
        closed = np.concatenate([camera.outline, camera.outline[:1]])
        axes.plot(closed[:, a], closed[:, b], color=colour, linewidth=0.8)
        axes.plot(
            [camera.centre[a]], [camera.centre[b]], "o", color=colour, markersize=4, label=f"{camera.side} camera"
        )
    (xl, yl), (xr, yr) = ((c.centre[a], c.centre[b]) for c in scene.cameras)
    axes.plot([xl, xr], [yl, yr], color=FAINT, linewidth=1.5)
    if seen_from != "above":
        axes.invert_yaxis()
    axes.legend(loc="best")
    return tips


def draw_board(axes: Axes, shape: BoardShape, unit: tuple[str, float]) -> Sequence[Tip]:
    """The board's height above its mean plane over its points; ``unit`` prints lengths, z is away from the cameras."""
    points = unit[1] * shape.points_m
    height = points[:, 2] - points[:, 2].mean()
    axes.set(title=f"Height above the mean plane ({unit[0]})", xlabel=f"x ({unit[0]})", ylabel=f"y ({unit[0]})")
    axes.set_aspect("equal", adjustable="datalim")
    if len(points) >= 4 and np.ptp(height) > 0:
        drawn = axes.tricontourf(points[:, 0], points[:, 1], height, levels=9, cmap=MAP_COLOURS)
        bar = axes.figure.colorbar(drawn, cax=axes.inset_axes((1.03, 0.0, 0.035, 1.0)))
        bar.outline.set_visible(False)
    draw_dots(axes, points[:, :2], FAINT, size=2.0)
    axes.invert_yaxis()
    sigma = unit[1] * shape.sigma_m[:, 2]
    return [
        Tip(x, y, f"{h:+.3g} ± {s:.2g} {unit[0]}")
        for (x, y, _), h, s in zip(points.tolist(), height.tolist(), sigma.tolist(), strict=True)
    ]
