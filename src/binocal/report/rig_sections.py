"""Sections about the rig and its board: both in 3-D and from above, the board's shape."""

from __future__ import annotations

from binocal.report import rig_figures
from binocal.report.contents import ReportContents
from binocal.report.scene import rig_scene
from binocal.report.section import Picture, Section, Table
from binocal.report.svg import figure_svg
from binocal.values import with_sigma


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


def board_section(contents: ReportContents) -> Section | None:
    """The board as it is, where it was measured along with the rig."""
    shape = contents.calibration.board_shape
    if shape is None:
        return None
    unit = contents.calibration.rig.printed_unit
    figure = figure_svg(
        lambda axes: rig_figures.draw_board(axes, shape, unit),
        name="board-shape",
        title="Height of the board's points above their mean plane",
    )
    rows = (
        ("bow, highest less lowest", f"{with_sigma(unit[1] * shape.bow_m, unit[1] * shape.bow_sigma_m)} {unit[0]}"),
        ("x over y stretched by", f"{with_sigma(100 * shape.stretch, 100 * shape.stretch_sigma)} %"),
        ("points off the drawing, in the plane", f"{unit[1] * shape.in_plane_rms_m:.2g} {unit[0]} RMS"),
        ("size, as far as the print tells", f"to {100 * shape.scale_sigma:.2g} %"),
    )
    return Section(
        "board",
        "Board",
        "The board as the views show it: it was measured along with the rig, whose lengths are as uncertain as its size.",
        (
            Picture(
                figure, "A board that is bent is no fault of the rig, once it is measured; a flat one is known better."
            ),
        ),
        (Table(("board", "estimate ± standard deviation"), rows),),
    )
