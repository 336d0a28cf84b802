"""What an experiment finds: one figure with its unit, and the rows that many of them make."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

NAN = float("nan")


@dataclass(frozen=True, slots=True)
class Measured:
    """One figure of one calibration; ``bound`` is NaN where there is none.

    ``table`` is the table or figure of the paper that it belongs to; empty: that of its case.
    """

    criterion: str
    unit: str
    value: float
    bound: float = NAN
    table: str = ""


@dataclass(frozen=True, slots=True)
class Row:
    """A criterion of one method on one case: median over the seeds, least and greatest.

    They are None where every seed was refused, or where the rigs that came out measure nothing.
    ``bound`` is the median of the Cramér-Rao bounds, ``paper`` what is printed of it elsewhere, as printed. ``seeds`` were tried,
    ``failures`` of them gave no result.
    """

    table: str
    case: str
    calibrator: str
    criterion: str | None
    unit: str | None
    median: float | None
    low: float | None
    high: float | None
    bound: float | None
    paper: float | str | None
    seeds: int
    failures: int

    def document(self) -> dict[str, Any]:
        """The row as plain data."""
        return asdict(self)


def row_of(
    table: str,
    case: str,
    calibrator: str,
    values: Sequence[Measured],
    paper: float | str | None,
    n_seeds: int,
    n_failed: int,
) -> Row:
    """The row of one criterion, measured once a seed; without figures where nothing was measured."""
    if not values:
        return Row(table, case, calibrator, None, None, None, None, None, None, None, n_seeds, n_failed)
    first, bounds = values[0], np.array([v.bound for v in values])
    numbers = np.array([v.value for v in values if np.isfinite(v.value)])
    middle: tuple[float, float, float] | tuple[None, None, None] = (None, None, None)
    if len(numbers):
        middle = float(np.median(numbers)), float(numbers.min()), float(numbers.max())
    bound = float(np.median(bounds)) if np.isfinite(bounds).all() else None
    table = first.table or table
    return Row(table, case, calibrator, first.criterion, first.unit, *middle, bound, paper, n_seeds, n_failed)
