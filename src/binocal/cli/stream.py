"""What ``check --stream`` prints, as text and as a document."""

from __future__ import annotations

from typing import Any

import numpy as np

from binocal.app.natural_drift import ANGLES
from binocal.app.stream import StreamRun
from binocal.cli.natural import drift_document
from binocal.findings import Severity, finding_document
from binocal.values import counted


def stream_document(run: StreamRun) -> dict[str, Any]:
    """Summary, jumps, and for every measurement what it measured and the running estimate."""
    track = run.track
    return {
        "has_drifted": run.has_drifted,
        "drift": drift_document(run.drift),
        "rate_deg_per_hour": _by_angle(track.rate_deg_per_hour),
        "rate_sigma_deg_per_hour": _by_angle(track.rate_sigma_deg_per_hour),
        "depth_error_percent": run.depth_error_percent,
        "jumps": [
            {
                "angle": ANGLES[jump.angle],
                "pair": run.turns[jump.at].name,
                "told_at": run.turns[jump.told_at].name,
                "size_deg": jump.size_deg,
                "sigma_deg": jump.sigma_deg,
            }
            for jump in track.jumps
        ],
        "series": [
            {
                "pair": turn.name,
                "time_s": turn.time_s,
                "measured_deg": turn.turn_deg.tolist(),
                "measured_sigma_deg": turn.sigma_deg.tolist(),
                "estimate_deg": level.tolist(),
                "estimate_sigma_deg": sigma.tolist(),
            }
            for turn, level, sigma in zip(run.turns, track.level_deg, track.level_sigma_deg, strict=True)
        ],
        "skipped": [{"pair": name, "reason": reason} for name, reason in run.skipped],
        "findings": [finding_document(one) for one in run.findings],
    }


def _by_angle(values: Any) -> dict[str, float | None]:
    return {name: float(v) if np.isfinite(v) else None for name, v in zip(ANGLES, values, strict=True)}


def stream_text(run: StreamRun) -> str:
    """The verdict first, then the drift, its rate and what was skipped."""
    drift, track = run.drift, run.track
    worst = int(np.argmax(np.abs(drift.z)))
    if drift.is_sure:
        verdict = (
            f"drifted: {ANGLES[worst]} is {drift.turn_deg[worst]:+.3f} deg from {drift.against} at the end, "
            f"{abs(drift.z[worst]):.0f} standard deviations; run `binocal recalibrate`."
        )
    elif track.jumps:
        first = track.jumps[0]
        verdict = (
            f"drifted: {ANGLES[first.angle]} jumped by {first.size_deg:+.3f} deg at pair {run.turns[first.at].name}."
        )
    else:
        verdict = f"fine: no jump, and no angle differs from {drift.against} by more than {np.abs(drift.z).max():.1f} standard deviations."
    labels = {Severity.WARNING: "warning", Severity.NOTE: "note"}
    lines = [verdict, *(f"{labels[one.severity]}: {one.text}" for one in run.findings), ""]
    lines.append(f"Drift    {_angles(drift.turn_deg, drift.sigma_deg, 4)} deg at the end, against {drift.against}")
    if np.isfinite(track.rate_deg_per_hour).any():
        lines.append(f"Rate     {_angles(track.rate_deg_per_hour, track.rate_sigma_deg_per_hour, 3)} deg per hour")
    else:
        lines.append("Rate     not told: the stream is too short, or has no times")
    if run.depth_error_percent:
        depths = ", ".join(f"{percent:.2g} % at {depth} m" for depth, percent in run.depth_error_percent.items())
        lines.append(f"Depth    a yaw off by {abs(drift.turn_deg[1]):.3f} deg means {depths}")
    sigmas = ", ".join(f"{s:.4f}" for s in np.median([turn.sigma_deg for turn in run.turns], axis=0))
    lines.append(
        f"Pairs    {counted(len(run.turns), 'measurement')}, each to {sigmas} deg (median); {len(run.skipped)} skipped"
    )
    return "\n".join(lines)


def _angles(values: Any, sigmas: Any, digits: int) -> str:
    return ", ".join(
        f"{name} {value:+.{digits}f} ± {sigma:.{digits}f}" if np.isfinite(value) else f"{name} not told"
        for name, value, sigma in zip(ANGLES, values, sigmas, strict=True)
    )
