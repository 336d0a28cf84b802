"""A calibration in a notebook: the verdict and figures where it is shown, and figures on Matplotlib's axes by name."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from binocal.errors import DataError, MissingExtraError
from binocal.report import corner_figures, rig_figures, sigma_figures
from binocal.report.headline import headline_of
from binocal.report.scene import rig_scene
from binocal.report.svg import LEFT, RIGHT, FigureSvg, figure_svg
from binocal.requirements.figures import usual_range
from binocal.result import StereoCalibration
from binocal.uncertainty.depth import MATCHING_PX
from binocal.uncertainty.maps import RangeMap, range_map
from binocal.validation.residuals import corner_residuals, solved_detections
from binocal.values import counted, with_sigma

if TYPE_CHECKING:
    from matplotlib.axes import Axes

N_RANGES = 9
SPAN = 0.5, 8.0  # times the boards' distance: the ranges that are drawn where none are given
_COLOURS = {
    "var(--ink)": "currentColor",
    "var(--faint)": "#8a939c",
    "var(--left)": LEFT,
    "var(--right)": RIGHT,
    "var(--good)": "#009e73",
    "var(--mark)": "#cc79a7",
}
_LEVELS = {"good": "#00795a", "care": "#8a5a00", "bad": "#b3261e"}


class CalibrationPlots:
    """``calibration.plot``: each method draws on the axes that are given, or on new ones, and returns them.

    Raises:
        MissingExtraError: Matplotlib is not installed.
    """

    def __init__(self, calibration: StereoCalibration) -> None:
        self._calibration = calibration

    def coverage(self, axes: Sequence[Axes] | None = None) -> tuple[Axes, Axes]:
        """Where corners were seen in both images; parts without any are tinted.

        Raises:
            DataError: The calibration holds no corners.
        """
        detections = self._calibration.corners.detections
        left, right = _two(axes)
        corner_figures.draw_coverage(left, detections.left_px, detections.left_size_wh, "left")
        corner_figures.draw_coverage(right, detections.right_px, detections.right_size_wh, "right")
        return left, right

    def residuals(self, axes: Sequence[Axes] | None = None) -> tuple[Axes, Axes]:
        """How far corners lie from their predictions, as enlarged arrows over both images.

        Raises:
            DataError: The calibration holds no corners.
        """
        residuals = corner_residuals(self._calibration)
        detections = solved_detections(self._calibration)
        left, right = _two(axes)
        corner_figures.draw_residuals(left, detections.left_px, residuals[0], detections.left_size_wh, "left")
        corner_figures.draw_residuals(right, detections.right_px, residuals[1], detections.right_size_wh, "right")
        return left, right

    def rig(self, axes: Axes | None = None) -> Axes:
        """Cameras, what they see, and the boards, from above."""
        axes = _one(axes)
        rig_figures.draw_rig(axes, rig_scene(self._calibration, _board_points(self._calibration)))
        return axes

    def depth(
        self,
        axes: Axes | None = None,
        *,
        ranges_m: tuple[float, float] | None = None,
        matching_px: float = MATCHING_PX,
    ) -> Axes:
        """The 95 % error of depth over range, by cause; by default about the boards' distance. Lengths are metres (board pitches).

        Raises:
            DataError: The calibration states no covariance, the range is not known, or the cameras see nothing in common there.
            ValueError: The range does not run from near to far.
        """
        maps = _ranges(self._calibration, ranges_m, matching_px)
        if not any(found.field.is_common.any() for found in maps):
            near, far = (f"{found.field.depth_m:.3g}" for found in (maps[0], maps[-1]))
            raise DataError(f"the cameras see nothing in common from {near} to {far} {_unit(self._calibration)}.")
        axes = _one(axes)
        sigma_figures.draw_depth_over_range(axes, maps, _unit(self._calibration))
        return axes


def calibration_html(calibration: StereoCalibration) -> str:
    """What a notebook shows of a calibration: the verdict, key figures and, where Matplotlib is installed, two figures."""
    ranges: tuple[RangeMap, ...] = ()
    at_boards = None
    range_m = usual_range(calibration)
    try:
        ranges = _ranges(calibration, None, MATCHING_PX)
        at_boards = range_map(
            calibration.rig, calibration.stated_covariance, range_m, board_scale_sigma=calibration.board_scale_sigma
        )
    except DataError:
        pass  # there is no covariance, or no board pose: the figure of depth is left out
    headline = headline_of(calibration, calibration.findings, (), at_boards)
    rig, sigma = calibration.rig, calibration.covariance.sigma
    unit, factor = rig.printed_unit
    rows = [("baseline", f"{with_sigma(factor * rig.baseline_m, factor * calibration.baseline_sigma_m)} {unit}")]
    for side, camera in (("left", rig.left), ("right", rig.right)):
        fx = with_sigma(float(camera.parameters[0]), sigma.get(f"{side}.fx", float("nan")))
        rows.append((f"{side} camera", f"{camera.model}, {camera.size_wh[0]} x {camera.size_wh[1]} px, fx {fx} px"))
    rows.append(("corners", f"RMS {calibration.rms.all_px:.3f} px, {counted(len(calibration.views), 'view')}"))
    table = "".join(f"<tr><th>{html.escape(a)}</th><td>{html.escape(b)}</td></tr>" for a, b in rows)
    points = "".join(f"<li>{html.escape(point)}</li>" for point in headline.points)
    figures = "".join(_coloured(figure.svg) for figure in _html_figures(calibration, ranges))
    return (
        f'<div><p style="color:{_LEVELS[headline.level]};font-size:120%"><b>{html.escape(headline.sentence)}</b></p>'
        f"<ul>{points}</ul><table>{table}</table>"
        f'<div style="display:flex;flex-wrap:wrap;gap:1em">{figures}</div></div>'
    )


def _html_figures(calibration: StereoCalibration, ranges: tuple[RangeMap, ...]) -> list[FigureSvg]:
    scene = rig_scene(calibration, _board_points(calibration))
    unit = _unit(calibration)
    try:
        figures = [
            figure_svg(lambda axes: rig_figures.draw_rig(axes, scene), name="nb-rig", title="The rig from above")
        ]
        if any(found.field.is_common.any() for found in ranges):
            figures.append(
                figure_svg(
                    lambda axes: sigma_figures.draw_depth_over_range(axes, ranges, unit),
                    name="nb-depth",
                    title="95 % error of depth over range",
                )
            )
    except MissingExtraError:
        return []
    return figures


def _coloured(svg: str) -> str:
    """A figure for where there is no style sheet: its colours as they are, and a width of its own."""
    for name, colour in _COLOURS.items():
        svg = svg.replace(name, colour)
    return svg.replace("<svg ", '<svg width="420" ', 1)


def _ranges(
    calibration: StereoCalibration, ranges_m: tuple[float, float] | None, matching_px: float
) -> tuple[RangeMap, ...]:
    if ranges_m is None:
        range_m = usual_range(calibration)
        if not np.isfinite(range_m):
            raise DataError("this calibration does not say where its boards were; give ranges_m=(nearest, farthest).")
        ranges_m = SPAN[0] * range_m, SPAN[1] * range_m
    near, far = ranges_m
    if not 0 < near < far < np.inf:
        raise ValueError(f"ranges_m is (nearest, farthest), both above 0; got {ranges_m}")
    return tuple(
        range_map(
            calibration.rig,
            calibration.stated_covariance,
            float(range_m),
            matching_px=matching_px,
            board_scale_sigma=calibration.board_scale_sigma,
        )
        for range_m in np.geomspace(near, far, N_RANGES)
    )


def _board_points(calibration: StereoCalibration) -> np.ndarray | None:
    if calibration.evidence is not None:
        return calibration.evidence.board_points_m
    return None if calibration.board_shape is None else calibration.board_shape.points_m


def _unit(calibration: StereoCalibration) -> str:
    return "m" if calibration.rig.is_metric else "board pitches"


def _one(axes: Axes | None) -> Axes:
    return axes if axes is not None else _new_axes(1)[0]


def _two(axes: Sequence[Axes] | None) -> tuple[Axes, Axes]:
    left, right = axes if axes is not None else _new_axes(2)
    return left, right


def _new_axes(n: int) -> list[Axes]:
    try:
        from matplotlib import pyplot
    except ImportError as error:
        raise MissingExtraError("a calibration's plots", "report") from error
    _, axes = pyplot.subplots(1, n, figsize=(5.0 * n, 3.8), layout="constrained", squeeze=False)
    return list(axes[0])
