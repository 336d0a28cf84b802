"""The table of `binocal bench real` as text of at most 100 columns."""

from __future__ import annotations

import math
import textwrap
from typing import Any

FIGURES = ("rotation_deg", "baseline_percent", "focal_centre_px", "rows_rms_px", "rows_median_view_px")
_DIGITS = (4, 3, 3, 4, 4)
_WIDTHS = (14, 12, 12, 13, 13)
_GROUPS = ("baseline", "rotation", "focal", "centre", "depth")
WIDTH = 100


def format_table(table: dict[str, Any]) -> str:
    """The table of :func:`binocal.benchmark.real.run_real_benchmark`, readable."""
    rows, failed = table["rows"], table["failed_sets"]
    lines = [
        f"binocal {table['version']}: random halves of real recordings; {len(rows)} of {len(rows) + len(failed)} recordings, "
        f"{table['splits']} splits, seed {table['seed']}",
        f"({table['machine']}; {table['elapsed_s']:.0f} s)",
        "",
        "RMS difference between halves, and row error on the other half",
        _head("rotation deg", "baseline %", "f and c px", "rows rms px", "median view", "failed"),
    ]
    for row in rows:
        lines.append(f"{row['set']}: {row['views']} of {row['views_given']} views, {row['board']}, {row['model']}")
        for name, found in row["methods"].items():
            failures = f"{found['n_failed']}/{found['n_halves']}"
            lines.append(f"  {name:<22}{_cells(found, _DIGITS)}{failures:>8}")
    lines += ["", *_ratio_lines(table["ratios"]), "", *_z_lines(table)]
    remarks = [line for remark in _remarks(table) for line in textwrap.wrap(remark, WIDTH, subsequent_indent="  ")]
    return "\n".join(lines + ([""] if remarks else []) + remarks)


def _head(*titles: str) -> str:
    return " " * 24 + "".join(f"{title:>{width}}" for title, width in zip(titles, (*_WIDTHS, 8), strict=False))


def _cells(found: dict[str, float], digits: tuple[int, ...]) -> str:
    return "".join(f"{_number(found[f], n):>{width}}" for f, width, n in zip(FIGURES, _WIDTHS, digits, strict=True))


def _number(value: float, digits: int) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def _ratio_lines(ratios: dict[str, dict[str, Any]]) -> list[str]:
    lines = ["binocal's figure over the peer's, median over the recordings (below 1: binocal's is smaller)"]
    for ours, peers in ratios.items():
        lines.append(f"{ours} over")
        for peer, found in peers.items():
            name = "best peer of each" if peer == "best peer" else peer
            lines.append(f"  {name:<22}{_cells(found['median'], (2,) * len(FIGURES))}")
    return lines


def _z_lines(table: dict[str, Any]) -> list[str]:
    lines = [
        "difference between halves over its stated sigma: RMS, share within 1 and 2 sigma (68 and 95 %)",
        f"{'':<26}{'baseline':>10}{'rotation':>10}{'focal':>10}{'centre':>10}{'depth':>10}{'1 sigma':>10}{'2 sigma':>10}",
    ]
    for ours, pooled in table["pooled_z"].items():
        lines.append(ours)
        for name, z in [*((row["set"], row["methods"][ours]["z"]) for row in table["rows"]), ("all", pooled)]:
            cells = "".join(f"{_number(z[group]['rms'], 2):>10}" for group in _GROUPS)
            shares = "".join(f"{_number(100 * z['all'][key], 0):>8} %" for key in ("within_1", "within_2"))
            lines.append(f"  {name:<24}{cells}{shares}")
    return lines


def _remarks(table: dict[str, Any]) -> list[str]:
    """What failed or was left out, with names and reasons."""
    remarks = [f"failed: {name}: {text}" for name, text in table["failed_sets"].items()]
    for row in table["rows"]:
        if row["opencv_views"] is not None and row["opencv_views"] < row["views"]:
            remarks.append(
                f"{row['set']}: OpenCV finds its own corners in {row['opencv_views']} of {row['views']} views"
            )
        remarks += [f"not run: {row['set']}, {name}: {text}" for name, text in row["not_run"].items()]
        for name, found in row["methods"].items():
            where = f"{row['set']}, {name}"
            remarks += [f"failed: {where}, {n} of the halves: {text}" for text, n in found["failures"].items()]
            if found["n_not_rectified"]:
                remarks.append(f"{where}: {found['n_not_rectified']} rigs cannot be rectified")
            if found["n_corners_without_ray"]:
                remarks.append(
                    f"{where}: {found['n_corners_without_ray']} corners without a ray, not counted in the rows"
                )
    return remarks
