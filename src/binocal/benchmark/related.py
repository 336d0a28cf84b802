"""The related work's calibrators on input that suits each: errors beside the bound, and beside what the cited works report.

Everything is cases x methods x seeds -> rows with units (:mod:`binocal.experiments`).
"""

from __future__ import annotations

import platform
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from binocal.benchmark import related_cases as cases
from binocal.experiments.case import Case, by_calibrator
from binocal.experiments.run import rows_of, run_cases

SEEDS = 10


LM, OPENCV = by_calibrator("lm"), by_calibrator("opencv")
JOINT = (LM, by_calibrator("alternating"), OPENCV, by_calibrator("opencv", intrinsics="free"))
SVD = (by_calibrator("absolute-orientation"), by_calibrator("absolute-orientation", refine=True))
HETEROGENEOUS, WIDE = by_calibrator("heterogeneous"), by_calibrator("wide-field")
RECTANGLES, ZOOM = by_calibrator("rectangles"), by_calibrator("zoom")
WANG_2019 = {"attitude, rms": "0.12", "translation, rms": "7.2", "coordinates, rms": "1.6"}
WANG_2020 = {
    "binocular mean reprojection error": "0.620-0.754",
    "the same, mean of the views' poses": "0.782-0.943",
}


def all_cases(folder: Path) -> dict[str, tuple[Case, ...]]:
    """The cases by group; rendered images go to ``folder`` for a moment."""
    rectangles = tuple(
        Case(
            f"{'another rectangle each' if another else 'one rectangle'}, {n} pairs, attitude {sigma:g} deg"
            + (f", pivot {1e3 * pivot:g} mm behind" if pivot else ""),
            cases.turning(n, sigma, is_always_another=another, pivot_m=pivot),
            cases.turning_errors,
            (RECTANGLES,),
            WANG_2019,
        )
        for another, n, sigma, pivot in (
            (False, 5, 1.0, 0.0), (False, 20, 0.3, 0.0), (False, 20, 1.0, 0.0), (False, 20, 3.0, 0.0), (False, 50, 1.0, 0.0),
            (False, 20, 1.0, 0.02), (True, 20, 0.1, 0.0), (True, 20, 0.3, 0.0), (True, 20, 1.0, 0.0),
        )
    )  # fmt: skip
    return {
        "boards": (
            Case("table-2 rig, 20 pairs, 0.2 px", cases.board_corners, cases.rig_errors, (*JOINT, *SVD, HETEROGENEOUS)),
        ),
        "heterogeneous": (
            Case(
                "colour and thermal, rendered, 12 pairs",
                cases.rendered("colour-thermal", "chessboard:11x8:30mm", "brown4", folder),
                cases.rig_errors,
                (HETEROGENEOUS, LM, OPENCV, SVD[0]),
            ),
        ),
        "wide": tuple(
            Case(
                f"thermal, {degrees} deg, rendered, 12 pairs",
                cases.rendered(f"thermal-{degrees}", "chessboard:11x8:30mm", "fisheye4", folder),
                cases.wide_errors,
                (WIDE, LM, OPENCV),
                WANG_2020,
            )
            for degrees in (180, 210)
        ),
        "rectangles": rectangles,
        "zoom": tuple(
            Case(f"zoom 4:1, {n} settings of 12 pairs, 0.1 px", cases.zoom(n), cases.zoom_errors, (ZOOM,))
            for n in (9, 13)
        ),
    }


def run_related_benchmark(*, seed: int = 0, seeds: int = SEEDS, groups: Iterable[str] = ()) -> dict[str, Any]:
    """All groups of cases, or those named.

    Raises:
        ValueError: There is no such group.
    """
    with tempfile.TemporaryDirectory(prefix="binocal-bench-") as folder:
        known = all_cases(Path(folder))
        wanted = tuple(groups) or tuple(known)
        for name in wanted:
            if name not in known:
                raise ValueError(f"no group {name!r} of cases; there are {', '.join(known)}")
        numbers = [seed + i for i in range(seeds)]
        chosen = [case for name in wanted for case in known[name]]
        rows = [row.document() for row in rows_of(chosen, numbers, run_cases(chosen, numbers))]
    machine = f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}"
    return {
        "benchmark": "related",
        "seed": seed,
        "seeds": seeds,
        "machine": machine,
        "rows": rows,
        "text": _text(rows, machine),
    }


def _text(rows: list[dict[str, Any]], machine: str) -> str:
    lines = [f"Related work's calibrators; {machine}; median (least..greatest)"]
    case = None
    for row in rows:
        if row["case"] != case:
            case = row["case"]
            lines += ["", f"{case} ({row['seeds']} seeds)"]
        bound = "" if row["bound"] is None else f"  bound {row['bound']:.4g}"
        theirs = "" if row["paper"] is None else f"  cited work {row['paper']}"
        refused = f"  {row['failures']} refused" if row["failures"] else ""
        if row["median"] is None:
            lines.append(f"  {row['calibrator']:36} refused with every seed")
            continue
        value = f"{row['median']:.4g} ({row['low']:.4g}..{row['high']:.4g}) {row['unit']}"
        lines.append(f"  {row['calibrator']:36} {row['criterion']:38} {value}{bound}{theirs}{refused}")
    return "\n".join(lines)
