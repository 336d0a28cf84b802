"""Sections about the rig and its board: both in 3-D and from above, the board's shape."""

from __future__ import annotations

from binocal.report import rig_figures
from binocal.report.contents import ReportContents
from binocal.report.scene import rig_scene
from binocal.report.section import Picture, Section
from binocal.report.svg import figure_svg


def rig_section(contents: ReportContents) -> Section:
    """Cameras and boards in 3-D, and from above and aside."""
    calibration = contents.calibration
    scene = rig_scene(calibration, contents.board_points_m, contents.plans)
    pictures = []
    for seen_from in ("above", "the side"):
        figure = figure_svg(
            lambda axes, seen_from=seen_from: rig_figures.draw_rig(axes, scene, seen_from),
            name=f"rig-{seen_from.rpartition(' ')[2]}",
            title=f"Both cameras and all boards seen from {seen_from}",
        )
        pictures.append(Picture(figure, ""))
    unit, factor = calibration.rig.printed_unit
    lead = f"Both cameras, {factor * calibration.rig.baseline_m:.2f} {unit} apart, what they see, and where the board was shown."
    return Section("rig", "Rig", lead, tuple(pictures), scene=scene)
