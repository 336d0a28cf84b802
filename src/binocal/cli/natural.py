"""What ``recalibrate`` and ``check`` print, as text and as a document."""

from __future__ import annotations

from typing import Any

import numpy as np

from binocal.app.natural import NaturalRun
from binocal.app.natural_drift import ANGLES, Drift
from binocal.formats import rig_json
from binocal.metrics.rows import RowFigures
from binocal.values import counted, with_sigma


def run_document(run: NaturalRun, **more: Any) -> dict[str, Any]:
    """The rig's document with rows before and after, and the drift."""
    return rig_json.calibration_document(run.calibration) | check_document(run) | more


def check_document(run: NaturalRun, **more: Any) -> dict[str, Any]:
    """Rows, drift, depth, and what they say."""
    return {
        "rows": {"given": _rows_document(run.before), "best": _rows_document(run.after)},
        "drift": drift_document(run.drift) | {"has_drifted": run.has_drifted, "rows_are_off": run.rows_are_off},
        "depth_error_percent": run.depth_error_percent,
        "n_matches": run.after.n_matches,
        "pairs": [view.name for view in run.calibration.views],
        "findings": [{"code": f.code, "severity": str(f.severity), "text": f.text} for f in run.calibration.findings],
        **more,
    }


def _rows_document(rows: RowFigures) -> dict[str, Any]:
    regions = [[None if np.isnan(v) else float(v) for v in row] for row in rows.by_region_px]
    return {"median_px": rows.median_px, "p95_px": rows.p95_px, "by_region_px": regions}


def drift_document(drift: Drift) -> dict[str, Any]:
    """Turns from what the rig is compared with, and whether it has drifted."""
    return {
        "against": drift.against,
        "has_drifted": drift.is_sure,
        **{f"{name}_deg": float(value) for name, value in zip(ANGLES, drift.turn_deg, strict=True)},
        **{f"{name}_sigma_deg": float(value) for name, value in zip(ANGLES, drift.sigma_deg, strict=True)},
        "direction_of_T_deg": drift.direction_deg,
        "direction_of_T_sigma_deg": float(drift.direction_sigma_deg)
        if np.isfinite(drift.direction_sigma_deg)
        else None,
    }


def recalibrate_text(run: NaturalRun, output: Any, kept: str = "") -> str:
    """The new pose, rows before and after, and what was written."""
    calibration, rig = run.calibration, run.calibration.rig
    lines = [f"warning: {text}" for text in calibration.warnings] + ([""] if calibration.warnings else [])
    sigma = calibration.covariance.sigma
    angles = zip(ANGLES, np.degrees(rig.euler_rad), ("x", "y", "z"), strict=True)
    turn = ", ".join(f"{name} {value:+.4f} ± {np.degrees(sigma[f'rotation.{a}']):.4f}" for name, value, a in angles)
    t = rig.T_right_left.t / np.linalg.norm(rig.T_right_left.t)
    lines.append(f"Turn     {turn} deg")
    unit, factor = rig.printed_unit
    length = ""
    if rig.is_metric:
        length = f": {with_sigma(factor * rig.baseline_m, factor * calibration.baseline_sigma_m)} {unit}"
    lines.append(
        f"Towards  ({t[0]:+.5f}, {t[1]:+.5f}, {t[2]:+.5f}), length from {calibration.provenance['length_from']}{length}"
    )
    led = calibration.provenance["agent"]
    if "agreeing" in led:
        lines.append(f"Led by   {led['won']}; {led['agreeing']} of {counted(len(led['costs']), 'solve')} ended there")
    lines += _common_lines(run)
    lines.append(f"Wrote    {output}{kept}")
    return "\n".join(lines)


def check_text(run: NaturalRun) -> str:
    """The verdict first, then what it rests on."""
    drift = run.drift
    worst = int(np.argmax(np.abs(drift.z)))
    if drift.is_sure and drift.direction_z > abs(drift.z[worst]):
        what = (
            f"the translation points {drift.direction_deg:.2f} deg away from {drift.against}, "
            f"{drift.direction_z:.0f} standard deviations"
        )
    elif drift.is_sure:
        what = f"{ANGLES[worst]} is {drift.turn_deg[worst]:+.3f} deg from {drift.against}, {abs(drift.z[worst]):.0f} standard deviations"
    else:
        what = (
            f"rows are off by {run.before.median_px:.2f} px by the rig as given, by {run.after.median_px:.2f} px by the best pose, though "
            "no angle has surely moved: a lens or an image's place on the sensor may have"
        )
    if run.has_drifted:
        verdict = f"drifted: {what}; run `binocal recalibrate`."
    else:
        most = max(np.abs(drift.z).max(), drift.direction_z)
        verdict = f"fine: nothing differs from {drift.against} by more than {most:.1f} standard deviations."
    warnings = [f"warning: {text}" for text in run.calibration.warnings]
    return "\n".join([verdict, *warnings, "", *_common_lines(run)])


def _common_lines(run: NaturalRun) -> list[str]:
    drift = run.drift
    turned = ", ".join(
        f"{name} {value:+.4f} ± {sigma:.4f}"
        for name, value, sigma in zip(ANGLES, drift.turn_deg, drift.sigma_deg, strict=True)
    )
    direction = f"{drift.direction_deg:.2f}"
    if np.isfinite(drift.direction_sigma_deg):
        direction += f" ± {drift.direction_sigma_deg:.2f}"
    lines = [
        f"Drift    {turned} deg, direction of T {direction} deg, against {drift.against}",
        f"Rows     median {run.before.median_px:.3f} px by the rig as given, {run.after.median_px:.3f} px by this one; "
        f"95 % within {run.before.p95_px:.2f} and {run.after.p95_px:.2f} px",
        "         by region of the left image, signed, as given (px):",
    ]
    for row in run.before.by_region_px:
        lines.append("           " + "  ".join("     -" if np.isnan(v) else f"{v:+6.2f}" for v in row))
    if run.depth_error_percent:
        depths = ", ".join(f"{percent:.2g} % at {depth} m" for depth, percent in run.depth_error_percent.items())
        lines.append(f"Depth    a yaw off by {abs(drift.turn_deg[1]):.3f} deg means {depths}")
    provenance = run.calibration.provenance
    lines.append(
        f"Matches  {provenance['n_right']} of {provenance['n_matches']} agree, noise {run.calibration.noise_px:.3f} px, "
        f"{counted(len(run.calibration.views), 'pair')}; "
        f"standard deviations of the intrinsics: {provenance['intrinsics_sigma']}"
    )
    return lines
