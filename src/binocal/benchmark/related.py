"""The related work's calibrators on input that suits each: errors beside the bound, and beside what the cited works report.

Everything is cases x methods x seeds -> rows with units (:mod:`binocal.experiments`).
"""

from __future__ import annotations

import platform
from collections.abc import Iterable
from typing import Any

import numpy as np

from binocal.experiments.related import related_groups
from binocal.experiments.run import rows_of, run_cases

SEEDS = 10


def run_related_benchmark(*, seed: int = 0, seeds: int = SEEDS, groups: Iterable[str] = ()) -> dict[str, Any]:
    """All groups of cases, or those named.

    Raises:
        ValueError: There is no such group.
    """
    known = related_groups()
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
