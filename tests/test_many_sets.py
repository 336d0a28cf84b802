"""Many sets in many worker processes: what is wrong with some of them is named and does not touch the others."""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import pytest

from poisoned_sets import POISONS, rig_of, work

N_SETS, N_WORKERS = 24, 6


@pytest.mark.slow
def test_poisoned_sets_are_named_and_the_others_are_right(tmp_path):
    with ProcessPoolExecutor(N_WORKERS, multiprocessing.get_context("spawn")) as pool:
        results = list(pool.map(work, range(N_SETS), [str(tmp_path)] * N_SETS, timeout=500))
    for index, (baseline_m, problem) in enumerate(results):
        if index in POISONS:
            assert any(words in problem for words in POISONS[index][1].split("|")), (index, problem)
        else:
            assert not problem and baseline_m == pytest.approx(rig_of(index).baseline_m, rel=0.01), (index, problem)
