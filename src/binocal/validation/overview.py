"""A calibration in ten lines: what was looked at, how large it is, and whether it is as it should be."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from binocal.errors import DataError
from binocal.findings import Finding, Severity
from binocal.requirements.figures import COVERAGE, usual_range
from binocal.result import StereoCalibration
from binocal.uncertainty.maps import RangeMap, range_map
from binocal.validation.checks import ValidationReport

POOR_DEPTH_PERCENT = 5.0  # 95 % error at the worst place in the common view: ordinary rigs have 0.2 to 3
SURE_SIGMAS = 3.0  # of a bow or stretch, to be named


@dataclass(frozen=True, slots=True)
class CheckLine:
    """One line: what was looked at, in words with its size; ``severity`` is that of its gravest finding, None where there is none."""

    name: str
    text: str
    severity: Severity | None = None
    codes: tuple[str, ...] = ()


_CODES = {
    "Views": (
        "rests-on-few-views", "few-different-poses", "views-copied", "many-views-left-out", "changed-from-view", "pairs-left-out",
    ),
    "Fit": ("attitudes-less-certain", "corners-without-weight", "corners-lock-to-pixels", "images-differ-in-noise"),
    "Board": ("board-not-as-drawn", "board-scale-uncertain", "aprilgrid-gap-wrong", "scale-doubtful"),
    "Exposures": ("exposures-apart", "rig-changed", "rig-drifts", "rig-has-two-states"),
    "Halves": ("halves-disagree",),
    "Lens": ("lens-of-another-kind", "lens-model-misfits", "model-choice-weak"),
    "Rays": ("lens-model-folds",),
    "Residuals": ("residuals-correlated",),
    "Depth": ("focal-length-uncertain",),
    "Rows": (),
}  # fmt: skip
"""Which findings belong to which line."""


def overview(calibration: StereoCalibration, report: ValidationReport) -> tuple[CheckLine, ...]:
    """The lines that can be said of this calibration, at most ten, in a fixed order."""
    told = _at_boards(calibration)
    texts = {
        "Views": _views(calibration),
        "Fit": _fit(calibration),
        "Board": _board(calibration),
        "Exposures": _exposures(calibration),
        **_of_report(calibration, report),
        **({} if told is None else _precision(calibration, told)),
    }
    found = (*calibration.findings, *report.warnings)
    lines = (_line(name, texts[name], found) for name in _CODES if texts.get(name))
    poor = {"Depth"} if told is not None and worst_percent(told) >= POOR_DEPTH_PERCENT else set()
    return tuple(replace(line, severity=Severity.WARNING) if line.name in poor else line for line in lines)


def worst_percent(at_boards: RangeMap) -> float:
    """The 95 % error of depth, relative, that the calibration leaves at its worst place; 0 where nothing is seen in common."""
    if not at_boards.field.is_common.any():
        return 0.0
    return float(np.nanmax(COVERAGE * 100 * at_boards.depth.calibration_m / at_boards.depth.depth_m))


def _line(name: str, text: str, findings: tuple[Finding, ...]) -> CheckLine:
    own = [found for found in findings if found.code in _CODES[name]]
    grave = next((s for s in (Severity.WARNING, Severity.NOTE) if any(found.severity is s for found in own)), None)
    return CheckLine(name, text, grave, tuple(dict.fromkeys(found.code for found in own)))


def _views(calibration: StereoCalibration) -> str:
    text = f"{len(calibration.views)} of {len(calibration.views) + len(calibration.rejected)} used"
    if calibration.evidence is None:
        return text
    shares = []
    detections = calibration.evidence.detections
    for px, size_wh in (
        (detections.left_px, detections.left_size_wh),
        (detections.right_px, detections.right_size_wh),
    ):
        seen = px[np.isfinite(px[..., 0])]
        cells, *_ = np.histogram2d(seen[:, 0], seen[:, 1], bins=(8, 6), range=((-0.5, size_wh[0]), (-0.5, size_wh[1])))
        shares.append(100 * float((cells > 0).mean()))
    return f"{text}, corners in {shares[0]:.0f} % of the left and {shares[1]:.0f} % of the right image"


def _fit(calibration: StereoCalibration) -> str:
    n_outliers, n = (sum(getattr(view, name) for view in calibration.views) for name in ("n_outliers", "n_corners"))
    return f"RMS {calibration.rms.all_px:.3f} px, corner noise {calibration.noise_px:.3f} px, {n_outliers} of {n} corners left out"


def _board(calibration: StereoCalibration) -> str:
    shape = calibration.board_shape
    if "rectangles" in calibration.provenance:
        return ""  # no board was seen
    if shape is None:
        return "as drawn, as far as the views say"
    unit, factor = calibration.rig.printed_unit
    is_bent = shape.bow_m > SURE_SIGMAS * shape.bow_sigma_m
    bow = (
        f"bow {factor * shape.bow_m:.2g} {unit}"
        if is_bent
        else f"flat to {factor * max(shape.bow_m, shape.bow_sigma_m):.2g} {unit}"
    )
    return f"measured along: {bow}, its size to {100 * shape.scale_sigma:.2g} %"


def _exposures(calibration: StereoCalibration) -> str:
    exposure = calibration.exposure
    if exposure is None:
        return ""
    how = "apart, right poses freed" if exposure.are_apart else "together"
    return f"{how}: each camera alone fits to {exposure.alone_px:.3f} px, the pair to {exposure.pair_px:.3f} px"


def _of_report(calibration: StereoCalibration, report: ValidationReport) -> dict[str, str]:
    lines = {}
    halves, lens, white = report.halves, report.lens, report.whiteness
    if halves is not None and not halves.failure:
        lines["Halves"] = (
            f"differ by {100 * halves.depth_rms:.2g} % in depth ({100 * halves.depth_stated:.2g} % stated; "
            f"{halves.depth_z:.1f} sigma) and {halves.rms_px:.2g} px in projection"
        )
    elif report.findings:
        found = next((f for f in report.findings if f.code == "halves-undetermined"), None)
        lines["Halves"] = "" if found is None else f"not compared: {found.figures['why']}"
    if lens is not None:
        lines["Lens"] = (
            f"a free radial profile changes rows of views left out by {-100 * lens.gain.share:+.1f} %, corners by up to "
            f"{lens.largest_px:.2g} px"
        )
    codes = {found.code for found in (*calibration.findings, *report.findings)}
    if "rays-everywhere" in codes:
        lines["Rays"] = "every pixel has one, the distortion rises all over both images"
    elif "lens-model-folds" in codes:
        share = max(f.figures["share_percent"] for f in calibration.findings if f.code == "lens-model-folds")
        lines["Rays"] = f"{share:.2g} % of an image have none"
    elif report.findings:
        lines["Rays"] = "a few pixels in a corner have none"
    if white is not None:
        lines["Residuals"] = (
            f"neighbours correlate by {white.correlation:+.2f} ± {white.sigma:.2f}: {white.common_px:.2g} px in common"
        )
    return lines


def _at_boards(calibration: StereoCalibration) -> RangeMap | None:
    """Depth and rows at the boards' distance; None where that, or the covariance, is not known."""
    range_m = usual_range(calibration)
    if not np.isfinite(range_m):
        return None
    try:
        told = range_map(
            calibration.rig, calibration.stated_covariance, range_m, board_scale_sigma=calibration.board_scale_sigma
        )
    except DataError:
        return None
    return told if told.field.is_common.any() else None


def _precision(calibration: StereoCalibration, told: RangeMap) -> dict[str, str]:
    range_m = usual_range(calibration)
    unit = "m" if calibration.rig.is_metric else "pitches"
    relative, middle, worst = COVERAGE * 100 * told.depth.relative, told.field.middle, told.worst
    x, y = told.field.left_px[worst]
    lines = {
        "Depth": f"95 % error {relative[middle]:.2g} % at {range_m:.2g} {unit} in the middle, {relative[worst]:.2g} % at ({x:.0f}, {y:.0f})"
    }
    rows, at = COVERAGE * told.row_px, told.worst_row
    if np.isfinite(rows[at]):
        x, y = told.field.left_px[at]
        lines["Rows"] = (
            f"95 % error {rows[middle]:.2g} px after rectification in the middle, {rows[at]:.2g} px at ({x:.0f}, {y:.0f})"
        )
    return lines
