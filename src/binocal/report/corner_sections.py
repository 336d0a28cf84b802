"""Sections about corners: where they were seen, and how far they lie from their predictions."""

from __future__ import annotations

import numpy as np

from binocal.report import corner_figures
from binocal.report.axes import image_height
from binocal.report.contents import ReportContents
from binocal.report.section import Picture, Section
from binocal.report.svg import WIDTH_INCHES, figure_svg
from binocal.validation.residuals import corner_residuals, smooth_residuals, solved_detections


def coverage_section(contents: ReportContents) -> Section | None:
    """Where corners were seen in both images."""
    if contents.calibration.evidence is None:
        return None
    detections = contents.calibration.evidence.detections
    pictures = []
    for side in ("left", "right"):
        px, size_wh = getattr(detections, f"{side}_px"), getattr(detections, f"{side}_size_wh")
        figure = figure_svg(
            lambda axes, px=px, size=size_wh, side=side: corner_figures.draw_coverage(axes, px, size, side),
            name=f"coverage-{side}",
            title=f"Corners of all used views in the image of the {side} camera",
            height=image_height(size_wh, WIDTH_INCHES),
        )
        n = int(np.isfinite(px[..., 0]).sum())
        pictures.append(Picture(figure, f"{n} corners in the {side} image."))
    return Section(
        "coverage",
        "Coverage",
        "Where in the images corners were seen. The lens is known where there were some; tinted parts had none, and are extrapolated.",
        tuple(pictures),
    )


def residual_section(contents: ReportContents) -> Section | None:
    """How far corners lie from where the rig predicts them: over the images, and along the sequence."""
    calibration = contents.calibration
    if calibration.evidence is None:
        return None
    detections = solved_detections(calibration)
    pictures, smooth = [], []
    for side, residuals in zip(("left", "right"), corner_residuals(calibration), strict=True):
        px, size_wh = getattr(detections, f"{side}_px"), getattr(detections, f"{side}_size_wh")
        figure = figure_svg(
            lambda axes, px=px, r=residuals, size=size_wh, side=side: corner_figures.draw_residuals(
                axes, px, r, size, side
            ),
            name=f"residuals-{side}",
            title=f"Residuals of the {side} camera's corners as arrows",
            height=image_height(size_wh, WIDTH_INCHES),
        )
        rms = getattr(calibration.rms, f"{side}_px")
        pictures.append(Picture(figure, f"RMS {rms:.3f} px in the {side} image."))
        smoothed = smooth_residuals(px, residuals, size_wh)
        figure = figure_svg(
            lambda axes, m=smoothed, size=size_wh, side=side: corner_figures.draw_smoothed(axes, m, size, side),
            name=f"smoothed-{side}",
            title=f"Mean residual over the image of the {side} camera",
            height=image_height(size_wh, WIDTH_INCHES),
        )
        usual = (
            float(np.sqrt(np.nanmean(smoothed.sigma_px**2))) if np.isfinite(smoothed.sigma_px).any() else float("nan")
        )
        smooth.append(
            Picture(
                figure, f"What neighbouring corners have in common; {usual:.2g} px would be left of independent ones."
            )
        )
    pictures += smooth
    white = contents.validation.whiteness
    if white is not None:
        points_m, unit = detections.object_points_m, calibration.rig.printed_unit
        figure = figure_svg(
            lambda axes: corner_figures.draw_board_points(axes, points_m, white.by_point_px, unit),
            name="residuals-points",
            title="Mean residual of every board point in both cameras",
        )
        caption = (
            f"Neighbours correlate by {white.correlation:+.2f} ± {white.sigma:.2f}: {white.common_px:.2g} px in common; 0 where residuals "
            "are white."
        )
        pictures.append(Picture(figure, caption))
    views = calibration.views
    along = figure_svg(
        lambda axes: corner_figures.draw_views(
            axes, [v.name for v in views], [v.left_rms_px for v in views], [v.right_rms_px for v in views]
        ),
        name="residuals-views",
        title="RMS of every view in both cameras, along the sequence",
        height=2.6,
    )
    pictures.append(Picture(along, "Views that stand out were taken with the board moving, or hold wrong corners."))
    if white is not None:
        means = figure_svg(
            lambda axes: corner_figures.draw_view_means(axes, [v.name for v in views], white.by_view_px),
            name="residuals-means",
            title="Mean residual of every view in both cameras, along the sequence",
            height=2.6,
        )
        pictures.append(Picture(means, "About 0 without order, where one rig explains all views."))
    return Section(
        "residuals",
        "Residuals",
        "How far corners were measured from where the rig predicts them. Arrows that point alike in one part of an image are what the "
        "model leaves unexplained; without order they are noise.",
        tuple(pictures),
    )
