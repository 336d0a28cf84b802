"""Sections about uncertainty: of projection over each image, and of depth over range and over the image."""

from __future__ import annotations

import numpy as np

from binocal.report import sigma_figures
from binocal.report.axes import image_height
from binocal.report.contents import ReportContents
from binocal.report.numbers import three_digits, two_digits
from binocal.report.section import Picture, Section, Table
from binocal.report.svg import WIDTH_INCHES, figure_svg
from binocal.requirements.figures import COVERAGE
from binocal.uncertainty.field import image_grid


def projection_section(contents: ReportContents) -> Section | None:
    """Where each camera's lens is known how well, whether two halves of the views agree, and whether the lens model suffices."""
    rig, validation = contents.calibration.rig, contents.validation
    pictures = []
    for at in contents.projection:
        size_wh = getattr(rig, at.side).size_wh
        figure = figure_svg(
            lambda axes, at=at, size=size_wh: sigma_figures.draw_projection_map(axes, at, size),
            name=f"projection-{at.side}",
            title=f"Standard deviation of projection over the image of the {at.side} camera",
            height=image_height(size_wh, WIDTH_INCHES),
        )
        known = at.sigma_px[np.isfinite(at.sigma_px)]
        span = f"{known.min():.2g} to {known.max():.2g} px" if known.size else "unknown"
        pictures.append(Picture(figure, f"{span}, at the boards' distance, in the worst direction."))
    halves = validation.halves
    if halves is not None and not halves.failure:
        for side, off_px in (("left", halves.left_px), ("right", halves.right_px)):
            camera = getattr(rig, side)
            px = image_grid(camera, off_px.shape[::-1])
            figure = figure_svg(
                lambda axes, px=px, off=off_px, size=camera.size_wh, side=side: sigma_figures.draw_halves(
                    axes, px, off, size, side
                ),
                name=f"halves-{side}",
                title=f"Difference of two rigs from halves of the views over the image of the {side} camera",
                height=image_height(camera.size_wh, WIDTH_INCHES),
            )
            pictures.append(
                Picture(figure, "Two rigs, each from every other view, turned onto each other where corners were.")
            )
    if validation.lens is not None:
        lens = validation.lens
        figure = figure_svg(
            lambda axes: sigma_figures.draw_lens_profile(axes, lens),
            name="lens-profile",
            title="What a free radial profile of the lens would change, over the radius, for both cameras",
            height=2.8,
        )
        pictures.append(
            Picture(figure, f"It would change squared rows of views left out by {-100 * lens.gain.share:+.1f} %.")
        )
    if not pictures:
        return None
    return Section(
        "projection",
        "Lens",
        "How well it is known where each camera sees a thing. Outside the corners the lens model is extrapolated, and less sure.",
        tuple(pictures),
    )


def depth_section(contents: ReportContents) -> Section | None:
    """Depth error over range and over the image, split into what calibration and matching leave."""
    seen = [m for m in contents.ranges if m.field.is_common.any()]
    at = contents.at_boards
    if at is None or not seen:
        return None
    rig = contents.calibration.rig
    unit = "m" if rig.is_metric else "board pitches"
    over_range = figure_svg(
        lambda axes: sigma_figures.draw_depth_over_range(axes, seen, unit),
        name="depth-range",
        title="95 % error of depth over range, by cause",
        height=image_height(rig.left.size_wh, WIDTH_INCHES),
    )
    over_image = [
        figure_svg(
            lambda axes, at=at, cause=cause: sigma_figures.draw_depth_map(axes, at, rig.left.size_wh, unit, cause),
            name=f"depth-{cause}",
            title=f"95 % error of depth over the left image, the part of {cause}",
            height=image_height(rig.left.size_wh, WIDTH_INCHES),
        )
        for cause in ("calibration", "matching")
    ]
    rows = []
    for m in seen:
        middle, worst, row = m.field.middle, m.worst, m.row_px[m.field.middle]
        percent = [
            100 * COVERAGE * float(values[place]) / m.field.depth_m
            for values, place in (
                (m.depth.calibration_m, middle),
                (m.depth.matching_m, middle),
                (m.depth.total_m, middle),
                (m.depth.total_m, worst),
            )
        ]
        rows.append(
            (
                f"{three_digits(m.field.depth_m)} {unit}",
                *(f"{two_digits(value)} %" for value in percent),
                f"{two_digits(COVERAGE * float(row))} px" if np.isfinite(row) else "unknown",
            )
        )
    head = ("range", "calibration", "matching", "all", "all, worst place", "row error")
    return Section(
        "depth",
        "Depth",
        f"What depth will be off by, in 95 of 100 cases: the calibration's part is one error for all images, that of matching "
        f"(a disparity good to {contents.matching_px:g} px is assumed) another in every pixel.",
        (
            Picture(over_range, "In the middle of what both cameras see, and at its worst place."),
            Picture(over_image[0], "95 %, what the calibration leaves; blank where only one camera sees."),
            Picture(over_image[1], f"95 %, what matching to {contents.matching_px:g} px leaves."),
        ),
        (Table(head, tuple(rows), "95 % errors in the middle of the common view"),),
    )
