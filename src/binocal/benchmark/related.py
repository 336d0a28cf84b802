"""The related work's calibrators on input that suits each: errors beside the bound, and beside what the cited works report.

Everything is cases x calibrators x seeds -> rows with units. A case makes a sample from a seed (evidence, truth, bound) and measures
a calibration of it; a row is the median over the seeds, the least and the greatest, and the seeds that were refused.
"""

from __future__ import annotations

import platform
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from binocal.benchmark import related_cases as cases
from binocal.calibrators import calibrate
from binocal.errors import BinocalError
from binocal.result import StereoCalibration

SEEDS = 10


@dataclass(frozen=True, slots=True)
class Method:
    """A calibrator with its options, under the name of a row."""

    label: str
    calibrator: str
    options: Mapping[str, Any] = field(default_factory=dict)


def method(name: str, **options: Any) -> Method:
    """The calibrator of that name, its options in the label."""
    words = ", ".join(f"{key} {value}" for key, value in options.items())
    return Method(f"{name} ({words})" if words else name, name, options)


@dataclass(frozen=True, slots=True)
class Case:
    """What to make from a seed, what to measure of a calibration of it, by which methods, and what the cited work reports."""

    name: str
    make: Callable[[int], cases.Sample]
    measure: Callable[[StereoCalibration, cases.Sample], list[cases.Measured]]
    methods: tuple[Method, ...]
    theirs: Mapping[str, str] = field(default_factory=dict)


def run_case(case: Case, seeds: Sequence[int]) -> list[dict[str, Any]]:
    """The rows of a case: one for each method and criterion."""
    found: dict[tuple[str, str], list[cases.Measured]] = {}
    failures = dict.fromkeys((m.label for m in case.methods), 0)
    for seed in seeds:
        sample = case.make(seed)
        for each in case.methods:
            try:
                made = calibrate(sample.evidence, calibrator=each.calibrator, options=each.options, **sample.choices)
            except BinocalError:
                failures[each.label] += 1
                continue
            for measured in case.measure(made, sample):
                found.setdefault((each.label, measured.criterion), []).append(measured)
    rows = []
    for label, n_failed in failures.items():
        of_label = [values for (of, _), values in found.items() if of == label]
        rows += [_row(case, label, values, n_failed, len(seeds)) for values in of_label or [[]]]
    return rows


def _row(case: Case, label: str, values: list[cases.Measured], n_failed: int, n_seeds: int) -> dict[str, Any]:
    """One row; without figures where every seed was refused."""
    if not values:
        nothing = dict.fromkeys(("criterion", "unit", "median", "low", "high", "bound", "paper"))
        return {"case": case.name, "calibrator": label, **nothing, "seeds": n_seeds, "failures": n_failed}
    numbers = np.array([v.value for v in values])
    bounds = np.array([v.bound for v in values])
    return {
        "case": case.name,
        "calibrator": label,
        "criterion": values[0].criterion,
        "unit": values[0].unit,
        "median": float(np.median(numbers)),
        "low": float(numbers.min()),
        "high": float(numbers.max()),
        "bound": float(np.median(bounds)) if np.isfinite(bounds).all() else None,
        "paper": case.theirs.get(values[0].criterion),
        "seeds": n_seeds,
        "failures": n_failed,
    }


LM, OPENCV = method("lm"), method("opencv")
JOINT = (LM, method("alternating"), OPENCV, method("opencv", intrinsics="free"))
SVD = (method("absolute-orientation"), method("absolute-orientation", refine=True))
HETEROGENEOUS, WIDE = method("heterogeneous"), method("wide-field")
RECTANGLES, ZOOM = method("rectangles"), method("zoom")
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
        rows = [row for name in wanted for case in known[name] for row in run_case(case, numbers)]
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
