"""Sections that show images: a pair before and after rectification with its depth, and every view with its corners."""

from __future__ import annotations

import base64

import numpy as np
from numpy import ndarray

from binocal.evidence import Detections
from binocal.report.contents import ReportContents, ViewImages
from binocal.report.numbers import two_digits
from binocal.report.section import Photo, Section, Table, ViewCard
from binocal.result import StereoCalibration, ViewResult
from binocal.shapes import Float

MOST_SHOWN = 150  # corners of one image
MOST_ROWS = 200  # of a table of views: of more, those of the largest RMS


def rectified_section(contents: ReportContents) -> Section | None:
    """A pair before and after rectification, with lines along rows, and its depth."""
    shown = contents.rectified
    if shown is None:
        return None
    unit = "m" if contents.calibration.rig.is_metric else "board pitches"
    lines = "columns" if shown.is_vertical else "rows"
    depth = f"{100 * shown.measured:.0f} % of the left image have a depth"
    if np.isfinite(shown.near):
        depth += f": near is red, {two_digits(shown.near)} {unit}, far is blue, {two_digits(shown.far)} {unit}"
    name = shown.name
    photos = (
        Photo(
            _data(shown.before_jpeg),
            f"View {name} as taken, with lines along {lines}",
            "As taken: what lies on a line on the left need not on the right.",
        ),
        Photo(
            _data(shown.after_jpeg),
            f"View {name} rectified, with lines along {lines}",
            f"Rectified ({shown.projection}): matching points share {lines}.",
        ),
        Photo(
            _data(shown.depth_jpeg),
            f"Depth of view {name} as colours",
            f"{depth}. Black: no match, as on surfaces without texture.",
        ),
    )
    lead = f"View {shown.name} brought to common {lines}. Follow a line from the left image to the right one: it must cross the same things."
    return Section("rectified", "Rectified", lead, photos=photos)


def view_section(contents: ReportContents) -> Section:
    """Every view: its figures, its images where they are at hand, and why it was rejected where it was."""
    calibration = contents.calibration
    results = {view.name: view for view in calibration.views}
    reasons = {view.name: view.reason for view in calibration.rejected}
    cards = tuple(
        _card(images, results.get(images.name), reasons.get(images.name, ""), contents.detections, calibration)
        for images in contents.images
    )
    listed = calibration.views
    if len(listed) > MOST_ROWS:
        worst = {v.name for v in sorted(listed, key=lambda v: -np.nan_to_num(v.rms_px))[:MOST_ROWS]}
        listed = tuple(v for v in listed if v.name in worst)
    rows = tuple(
        (v.name, _px(v.left_rms_px), _px(v.right_rms_px), f"{v.n_corners}", f"{v.n_outliers}", v.note) for v in listed
    )
    caption = _views(len(calibration.views), "used")
    caption += f"; the {len(rows)} of the largest RMS" if len(rows) < len(calibration.views) else ""
    tables = [Table(("view", "RMS left", "RMS right", "corners", "left out", "note"), rows, caption)]
    if reasons:
        tables.insert(
            0,
            Table(
                ("view", "why it was not used"), tuple(reasons.items())[:MOST_ROWS], _views(len(reasons), "rejected"), 9
            ),
        )
    lead = (
        "Dots are the corners that were found, rings those left out as outliers."
        if cards
        else "What became of every view."
    )
    return Section("views", "Views", lead, tables=tuple(tables), cards=cards)


def _views(n: int, kind: str) -> str:
    return f"{n} {kind} view{'' if n == 1 else 's'}"


def _card(
    images: ViewImages,
    view: ViewResult | None,
    reason: str,
    detections: Detections | None,
    calibration: StereoCalibration,
) -> ViewCard:
    sides = []
    for side, jpeg, size_wh in zip(
        ("left", "right"), (images.left_jpeg, images.right_jpeg), images.sizes_wh, strict=True
    ):
        px = np.zeros((0, 2))
        if detections is not None and images.name in detections.names:
            px = getattr(detections, f"{side}_px")[detections.names.index(images.name)]
        outliers = np.zeros((0, 2))
        if view is not None and calibration.evidence is not None:
            solved = calibration.evidence.detections
            own = getattr(solved, f"{side}_px")[solved.names.index(images.name)]
            outliers = own[[o.corner for o in view.outliers if o.camera == side and o.corner < len(own)]]
        seen = px[np.isfinite(px).all(axis=-1)]
        sides.append((side, _data(jpeg), size_wh, _dots(seen), _rounded(outliers)))
    if view is None:
        return ViewCard(images.name, "not used: " + reason, False, tuple(sides))
    note = f"; {view.note}" if view.note else ""
    text = f"RMS {_px(view.left_rms_px)} left, {_px(view.right_rms_px)} right, {view.n_outliers} of {view.n_corners} corners left out{note}"
    return ViewCard(images.name, text, True, tuple(sides))


def _dots(px: Float[ndarray, "n 2"]) -> str:
    """Corners as one path of dots: lines without length, with round ends."""
    return "".join(f"M{x:.0f} {y:.0f}h0" for x, y in px[:: max(1, -(-len(px) // MOST_SHOWN))].tolist())


def _rounded(px: Float[ndarray, "n 2"]) -> tuple[tuple[int, int], ...]:
    return tuple((round(x), round(y)) for x, y in px[np.isfinite(px).all(axis=-1)].tolist())


def _px(value: float) -> str:
    return f"{value:.3f} px" if np.isfinite(value) else "not seen"


def _data(jpeg: bytes) -> str:
    return "data:image/jpeg;base64," + base64.b64encode(jpeg).decode()
