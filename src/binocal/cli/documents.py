"""What ``--json`` prints: results as dictionaries, units in the keys."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from binocal.app import CalibrationRun, DemoCase, ImageEvaluation, TrainedAgent, TruthEvaluation
from binocal.findings import finding_document
from binocal.formats import rig_json
from binocal.requirements.agreement import Agreement


def calibration_run_document(run: CalibrationRun, output: Path, max_rms_px: float | None) -> dict[str, Any]:
    """The ``rig.json`` document, and what became of the files."""
    rms_px = run.calibration.rms.all_px
    document = rig_json.calibration_document(run.calibration)
    return document | {
        "output": str(output),
        "ignored": [{"path": path, "reason": reason} for path, reason in run.ignored],
        "notes": run.notes,
        "elapsed_s": run.elapsed_s,
        "quality": {"max_rms_px": max_rms_px, "is_met": max_rms_px is None or rms_px <= max_rms_px},
    }


def truth_evaluation_document(evaluation: TruthEvaluation) -> dict[str, Any]:
    """Errors against the truth."""
    c = evaluation.comparison
    return {
        "rotation_error_deg": c.rotation_error_deg,
        "rotation_bound_deg": c.rotation_bound_deg,
        "translation_error_mm": c.translation_error_mm,
        "translation_bound_mm": c.translation_bound_mm,
        "baseline_error_mm": c.baseline_error_mm,
        "focal_error_px": c.focal_error_px,
        "principal_point_error_px": c.principal_point_error_px,
        "parameter_accuracy_percent": c.parameter_accuracy_percent,
        "n_correct": c.n_correct,
        "n_parameters": len(c.parameters),
        "has_bound": c.has_bound,
        "noise_px": evaluation.noise_px,
        "criteria": [
            {"name": c.name, "unit": c.unit, "value": c.value, "bound": c.bound, "ratio": c.ratio}
            for c in evaluation.criteria
        ],
        "parameters": [
            {
                "name": p.name,
                "truth": p.truth,
                "value": p.value,
                "error": p.error,
                "sigma": p.sigma,
                "bound": p.bound,
                "error_per_bound": p.error_per_bound,
                "is_correct": p.is_correct,
            }
            for p in c.parameters
        ],
        "notes": evaluation.notes,
    }


def images_document(evaluation: ImageEvaluation) -> dict[str, Any]:
    """Criteria on images."""
    pixel, row, length = evaluation.pixel_error, evaluation.row_error, evaluation.length_error
    return {
        "pixel_error_px": {"left": pixel.left_px, "right": pixel.right_px, "all": pixel.all_px},
        "n_corners": pixel.n_corners,
        "row_error_px": None if row is None else {"rms": row.rms_px, "median": row.median_px},
        "relative_length_error_percent": {"rms": length.scale_rms_percent, "mean": length.scale_mean_percent},
        "n_views": length.n_views,
        "single_side_error_percent": length.side_rms_percent if length.n_sides else None,
        "n_sides": length.n_sides,
        "views": [
            {"name": name, "rms_px": rms_px, "length_error_percent": percent}
            for name, rms_px, percent in zip(
                evaluation.names, pixel.view_rms_px, length.view_scale_percent, strict=True
            )
        ],
        "rejected": [{"name": view.name, "reason": view.reason} for view in evaluation.rejected],
        "ignored": [{"path": path, "reason": reason} for path, reason in evaluation.ignored],
        "notes": evaluation.notes,
        "agreement": agreement_document(evaluation.agreement),
        "common_rows": None if evaluation.common_rows is None else asdict(evaluation.common_rows),
        "findings": [finding_document(found) for found in evaluation.findings],
    }


def demo_document(cases: Sequence[DemoCase]) -> dict[str, Any]:
    """Every board's comparison with the truth."""
    return {
        "cases": [
            {
                "board": case.name,
                "folder": str(case.folder),
                "n_views": len(case.run.calibration.views),
                "rms_px": case.run.calibration.rms.all_px,
                "elapsed_s": dict(case.run.elapsed_s),
                "rejected": [{"name": v.name, "reason": v.reason} for v in case.run.calibration.rejected],
            }
            | truth_evaluation_document(case.evaluation)
            for case in cases
        ]
    }


def training_document(trained: TrainedAgent) -> dict[str, Any]:
    """A training run: where it lies, how it went, its evaluation table."""
    run = trained.run
    half = trained.test_half
    return {
        "output": str(run.folder),
        "agent": run.policy.card["agent"],
        "n_steps": run.n_steps,
        "elapsed_s": run.elapsed_s,
        "is_complete": run.is_complete,
        "was_resumed": run.was_resumed,
        "checks": [asdict(check) for check in run.checks],
        "rows": [asdict(row) for row in run.rows],
        "figure": None if trained.figure is None else str(trained.figure),
        "test_half": None if half is None else rig_json.calibration_document(half),
    }


def agreement_document(agreement: Agreement | None) -> dict[str, Any] | None:
    """The comparison with the rig as plain data; None where the rig states no covariance."""
    if agreement is None:
        return None
    cause = agreement.cause
    return {
        "agrees": agreement.agrees,
        "p_value": agreement.p_value,
        "statistic": agreement.statistic,
        "n_directions": agreement.freedom,
        "shift": dict(zip(agreement.names, agreement.shift.tolist(), strict=True)),
        "cause": None
        if cause is None
        else {
            "code": cause.code,
            "text": cause.words,
            "size": cause.size,
            "sigma": cause.sigma,
            "unit": cause.unit,
            "share": cause.share,
        },
    }
