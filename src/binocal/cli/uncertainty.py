"""What ``binocal uncertainty`` prints: a table for people, a document for programs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from binocal.app.uncertainty import UncertaintyRun
from binocal.cli.exits import one_line
from binocal.cli.tables import format_table
from binocal.uncertainty.maps import ProjectionMap, RangeMap


def uncertainty_text(run: UncertaintyRun) -> str:
    """Depth by range in the middle and at the worst place, split by cause; rows; projection."""
    unit, factor, long_unit = ("mm", 1e3, "m") if run.is_metric else ("pitches", 1.0, "pitches")
    head = ("range", "place", "", "calibration", "matching", "board", "together", "of the range", "row error")
    rows = []
    for m in run.ranges:
        if not m.field.is_common.any():
            continue
        for place, (row, column) in (("middle", m.field.middle), ("worst", m.worst)):
            x, y = m.field.left_px[row, column]
            total = m.depth.total_m[row, column]
            causes = (m.depth.calibration_m, m.depth.matching_m, m.depth.board_m)
            row_place = m.field.middle if place == "middle" else m.worst_row
            rows.append(
                (
                    f"{m.field.depth_m:.3g} {long_unit}" if place == "middle" else "",
                    place,
                    f"({x:.0f}, {y:.0f})",
                    *(_length(factor * cause[row, column], unit) for cause in (*causes, m.depth.total_m)),
                    f"{100 * total / m.depth.depth_m[row, column]:.2g} %",
                    _px(m.row_px[row_place]),
                )
            )
    lines = [f"note: {one_line(note)}" for note in run.notes]
    lines += [
        f"standard deviations of depth (matching to {run.matching_px:g} px) and of the row error after rectification",
        format_table(head, rows, align="llrrrrrrr"),
    ]
    if run.projection_far:
        lines += ["", "standard deviation of projection, worst direction", _projection_table(run)]
    return "\n".join(lines)


def _projection_table(run: UncertaintyRun) -> str:
    nearest = run.ranges[0].field.depth_m
    unit = "m" if run.is_metric else "pitches"
    rows = []
    for where, maps in (("at infinity", run.projection_far), (f"at {nearest:.3g} {unit}", run.projection_near)):
        for m in maps:
            rows.append((f"{m.side} {where}", _px(_middle_of(m)), _px(_worst_of(m))))
    return format_table(("camera", "middle", "worst"), rows)


def uncertainty_document(run: UncertaintyRun) -> dict[str, Any]:
    """Everything as arrays over the grids, with the middle and the worst place of each range."""
    return {
        "unit": "m" if run.is_metric else "board pitch",
        "matching_px": run.matching_px,
        "ranges": [_range_document(m) for m in run.ranges],
        "projection": {
            "at_infinity": [_projection_document(m) for m in run.projection_far],
            "at_nearest": [_projection_document(m) for m in run.projection_near],
        },
        "notes": run.notes,
    }


def _range_document(m: RangeMap) -> dict[str, Any]:
    def at(place: tuple[int, int], row_place: tuple[int, int]) -> dict[str, Any]:
        total = m.depth.total_m[place]
        return {
            "left_px": m.field.left_px[place],
            "calibration_m": m.depth.calibration_m[place],
            "matching_m": m.depth.matching_m[place],
            "board_m": m.depth.board_m[place],
            "total_m": total,
            "relative": total / m.field.depth_m,
            "row_px": m.row_px[row_place],
        }

    has_any = bool(m.field.is_common.any())
    return {
        "depth_m": m.field.depth_m,
        "common_share": m.field.share,
        "middle": at(m.field.middle, m.field.middle) if has_any else None,
        "worst": at(m.worst, m.worst_row) if has_any else None,
        "left_px": m.field.left_px,
        "calibration_m": m.depth.calibration_m,
        "matching_m": m.depth.matching_m,
        "total_m": m.depth.total_m,
        "row_px": m.row_px,
    }


def _projection_document(m: ProjectionMap) -> dict[str, Any]:
    return {
        "camera": m.side,
        "middle_px": _middle_of(m),
        "worst_px": _worst_of(m),
        "px": m.px,
        "sigma_px": m.sigma_px,
    }


def _middle_of(m: ProjectionMap) -> float:
    rows, columns = m.sigma_px.shape
    return float(m.sigma_px[rows // 2, columns // 2])


def _worst_of(m: ProjectionMap) -> float:
    return float(np.nanmax(m.sigma_px)) if np.isfinite(m.sigma_px).any() else float("nan")


def _length(value: float, unit: str) -> str:
    return f"{value:.3g} {unit}" if value > 0 else "-"


def _px(value: float | Sequence[float]) -> str:
    number = float(np.asarray(value))
    return f"{number:.3f} px" if np.isfinite(number) else "-"
