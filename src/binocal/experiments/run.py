"""Runs cases on all processors, in any order, to rows in the order of the cases."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from multiprocessing import get_context, parent_process, resource_tracker

from binocal.errors import CancelledError
from binocal.experiments.case import Case, Result, results_of
from binocal.experiments.journal import Journal, Key
from binocal.experiments.row import Measured, Row, row_of
from binocal.progress import ProgressCallback, ShouldStop
from binocal.threads import set_threads

Job = tuple[Case, int, tuple[str, ...]]
"""A case, a seed, and the methods that are still to do."""


def run_cases(
    cases: Sequence[Case],
    seeds: Sequence[int],
    *,
    journal: Journal | None = None,
    workers: int = 1,
    progress: ProgressCallback | None = None,
    should_stop: ShouldStop | None = None,
) -> dict[Key, Result]:
    """Every method on every case with every seed, those in the journal excepted, which are returned too.

    The results do not depend on ``workers``.

    Raises:
        CancelledError: ``should_stop`` returned True; the journal holds what was done.
    """
    done = {} if journal is None else dict(journal.results)
    jobs = _jobs(cases, seeds, done)
    total, count = len(cases) * len(seeds), len(cases) * len(seeds) - len(jobs)
    if progress is not None:
        progress("cases", count, total)
    for results in _each(jobs, workers):
        for result in results:
            done[result.case, result.calibrator, result.seed] = result
            if journal is not None:
                journal.add(result)
        count += 1
        if progress is not None:
            progress("cases", count, total)
        if should_stop is not None and should_stop():
            raise CancelledError("the experiment was stopped as asked; the same command goes on where it was.")
    return done


def _jobs(cases: Sequence[Case], seeds: Sequence[int], done: dict[Key, Result]) -> list[Job]:
    jobs = []
    for seed in seeds:
        for case in cases:
            missing = tuple(m.label for m in case.methods if (case.name, m.label, seed) not in done)
            if missing:
                jobs.append((case, seed, missing))
    return jobs


def _each(jobs: list[Job], workers: int) -> Iterator[list[Result]]:
    """The results of each job as they come; of many, in as many processes as there are workers, one thread each."""
    if workers < 2 or len(jobs) < 2:
        for job in jobs:
            yield results_of(*job)
        return
    _quiet_tracker()
    # spawned: a forked child would share what threads of this process hold
    pool = ProcessPoolExecutor(min(workers, len(jobs)), get_context("spawn"), initializer=_begin_worker)
    futures: list[Future[list[Result]]] = [pool.submit(results_of, *job) for job in jobs]
    try:
        for future in as_completed(futures):
            yield future.result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _quiet_tracker() -> None:
    """Python's tracker of semaphores, which outlives a process that a signal ends at once and cleans up after it, says nothing of it."""
    if os.name != "posix":
        return
    given = os.environ.get("PYTHONWARNINGS")
    os.environ["PYTHONWARNINGS"] = ",".join(filter(None, (given, "ignore:resource_tracker")))
    try:
        resource_tracker.ensure_running()
    finally:
        if given is None:
            del os.environ["PYTHONWARNINGS"]
        else:
            os.environ["PYTHONWARNINGS"] = given


def _begin_worker() -> None:
    """One thread, no answer to an interrupt at the terminal, and an end where the parent is gone, however it went."""
    set_threads(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    assert parent is not None  # this is a worker

    def end_with_parent() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()


def rows_of(cases: Sequence[Case], seeds: Sequence[int], results: dict[Key, Result]) -> list[Row]:
    """The rows of every case: one for each method and criterion, in the order in which they were measured."""
    rows = []
    for case in cases:
        for method in case.methods:
            found: dict[tuple[str, str], list[Measured]] = {}
            of_method = [results[case.name, method.label, seed] for seed in seeds]
            for result in of_method:
                for measured in result.measured:
                    found.setdefault((measured.table, measured.criterion), []).append(measured)
            n_failed = sum(bool(result.failure) for result in of_method)
            rows += [
                row_of(
                    case.table,
                    case.name,
                    method.label,
                    values,
                    case.printed(method.label, values[0].criterion) if values else None,
                    len(seeds),
                    n_failed,
                )
                for values in list(found.values()) or [[]]
            ]
    return rows
