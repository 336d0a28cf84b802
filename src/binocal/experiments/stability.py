"""The paper's figure 7: whether items keep their order from one run to the next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy import ndarray

from binocal.experiments.case import Case, Result
from binocal.experiments.journal import Key
from binocal.experiments.row import Measured, Row, row_of
from binocal.shapes import Float

TABLE = "figure 7"
SERIES = {"parameters": "stability of the parameters", "errors": "stability of their errors"}
"""What is put in order: tables of results, and the criterion that each makes."""
PAPER_PERCENT = 92.0


def order_kept_percent(a: Float[ndarray, "n"], b: Float[ndarray, "n"]) -> float:
    """Share of the pairs of items whose relative order is the same in both series: (1 + Kendall's tau) / 2; a tie is half.

    Raises:
        ValueError: Fewer than two items, or series of unlike lengths.
    """
    if a.shape != b.shape or len(a) < 2:
        raise ValueError(f"two series of the same two items or more are needed; got {a.shape} and {b.shape}")
    i, j = np.triu_indices(len(a), 1)
    return float(50 * (1 + np.mean(np.sign(a[i] - a[j]) * np.sign(b[i] - b[j]))))


def stability_rows(cases: Sequence[Case], seeds: Sequence[int], results: Mapping[Key, Result]) -> list[Row]:
    """Rows of :data:`TABLE`: over all pairs of seeds, the order of a method's estimated parameters, and of the sizes of their errors."""
    rows = []
    for case in cases:
        for method in case.methods:
            of_method = [results[case.name, method.label, seed] for seed in seeds]
            n_failed = sum(bool(result.failure) for result in of_method)
            for series, criterion in SERIES.items():
                runs = [np.array([m.value for m in result.measured if m.table == series]) for result in of_method]
                runs = [np.abs(run) if series == "errors" else run for run in runs if len(run)]
                kept = [Measured(criterion, "%", order_kept_percent(a, b)) for a, b in combinations(runs, 2)]
                paper = PAPER_PERCENT if method.label == "drl" and series == "parameters" else None
                if kept:
                    rows.append(row_of(TABLE, case.name, method.label, kept, paper, len(seeds), n_failed))
    return rows
