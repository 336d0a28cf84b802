"""All checks of a calibration on its own corners, each a finding with a size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from binocal.calibrators.base import CalibrationRequest
from binocal.cameras.ray_coverage import pixels_without_ray
from binocal.findings import Finding, Severity, finding
from binocal.result import StereoCalibration
from binocal.validation.halves import MIN_VIEWS, CrossValidation, cross_validate
from binocal.validation.lens import LensAdequacy, measure_lens_adequacy
from binocal.validation.residuals import Whiteness, measure_whiteness

LARGEST_Z = 3.0  # RMS of depth's difference over its sigma: halves of nine real recordings reach 1.9, with a model too plain 2.6
GAIN_ERRORS, GAIN_SHARE = 3.0, 0.05  # of a free lens profile, standard errors and share of the squared rows
LARGEST_CORRELATION = 0.2  # of neighbours' residuals that no standard deviation counts


@dataclass(frozen=True, slots=True, eq=False)
class ValidationReport:
    """The checks' findings, notes and warnings, and what they were made from; None where there was too little for a check."""

    findings: tuple[Finding, ...] = ()
    halves: CrossValidation | None = None
    lens: LensAdequacy | None = None
    whiteness: Whiteness | None = None

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """Those that are no notes."""
        return tuple(found for found in self.findings if found.severity is Severity.WARNING)


def validate(calibration: StereoCalibration, request: CalibrationRequest | None = None) -> ValidationReport:
    """All checks of a calibration that holds its corners; nothing of one that does not.

    Raises:
        CancelledError: The request's ``should_stop`` said so.
    """
    if calibration.evidence is None:
        return ValidationReport()
    halves = cross_validate(calibration, request)
    lens = measure_lens_adequacy(calibration)
    whiteness = measure_whiteness(calibration)
    findings = (
        _of_halves(calibration, halves),
        *(() if lens is None else (_of_lens(calibration, lens),)),
        *_of_rays(calibration),
        *(() if whiteness is None else (_of_whiteness(calibration, whiteness),)),
    )
    return ValidationReport(findings, halves, lens, whiteness)


def _of_halves(calibration: StereoCalibration, halves: CrossValidation | None) -> Finding:
    n_views = len(calibration.views)
    if halves is None:
        why = f"{MIN_VIEWS} views are needed"
        return finding("halves-undetermined", n_views=n_views, why=why)
    if halves.failure:
        return finding("halves-undetermined", n_views=n_views, why=halves.failure.rstrip("."))
    unit, factor = ("m", 1.0) if calibration.rig.is_metric else ("board pitches", 1.0)
    code = "halves-disagree" if halves.depth_z > LARGEST_Z else "halves-agree"
    return finding(
        code,
        projection_px=halves.rms_px,
        depth_percent=100 * halves.depth_rms,
        stated_percent=100 * halves.depth_stated,
        range=factor * halves.fields[0].depth_m,
        unit=unit,
        over_sigma=halves.depth_z,
    )


def _of_lens(calibration: StereoCalibration, lens: LensAdequacy) -> Finding:
    misfits = lens.gain.standard_errors > GAIN_ERRORS and lens.gain.share > GAIN_SHARE
    return finding(
        "lens-model-misfits" if misfits else "lens-model-suffices",
        model=calibration.rig.left.model,
        profile_px=lens.largest_px,
        share_percent=100 * lens.gain.share,
        standard_errors=lens.gain.standard_errors,
    )


def _of_rays(calibration: StereoCalibration) -> tuple[Finding, ...]:
    """A note where every pixel has a ray; where not, ``lens-model-folds`` of the rules has said so, if it is more than a corner."""
    found = [pixels_without_ray(camera) for camera in (calibration.rig.left, calibration.rig.right)]
    share = 100 * max((f.share for f in found if f is not None), default=0.0)
    return () if share > 0 else (finding("rays-everywhere"),)


def _of_whiteness(calibration: StereoCalibration, whiteness: Whiteness) -> Finding:
    factor = float(calibration.provenance.get("views_in_common", {}).get("sigma_factor", 1.0))
    is_counted = factor > 1 or not whiteness.correlation > LARGEST_CORRELATION
    return finding(
        "residuals-checked" if is_counted else "residuals-correlated",
        correlation=whiteness.correlation,
        sigma=whiteness.sigma,
        common_px=whiteness.common_px,
        sigma_factor=factor,
        worst_point_px=_largest(whiteness.by_point_px),
    )


def _largest(values: np.ndarray) -> float:
    return float(np.nanmax(np.abs(values), initial=0.0)) if np.isfinite(values).any() else 0.0
