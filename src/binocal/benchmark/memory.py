"""Peak memory of a piece of work, in a fresh process so that it is its own."""

from __future__ import annotations

import contextlib
import multiprocessing
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

STATUS, CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def run_alone(work: Callable[..., dict[str, Any]], *arguments: Any) -> dict[str, Any]:
    """What ``work`` returns in a fresh process, with that process's ``peak_mb``."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(_measured, work, *arguments).result()


def added_mb(prepare: Callable[..., Callable[[], Any]], *arguments: Any) -> float:
    """Megabytes by which the work that ``prepare`` returns raises the peak above what was in use when it began.

    Imports and input belong into ``prepare``. Where the system cannot forget an earlier peak (not Linux), the rise is
    that above the earlier peak.
    """
    return run_alone(_added, prepare, *arguments)["added_mb"]


def _measured(work: Callable[..., dict[str, Any]], *arguments: Any) -> dict[str, Any]:
    return work(*arguments) | {"peak_mb": _peak_mb()}


def _added(prepare: Callable[..., Callable[[], Any]], *arguments: Any) -> dict[str, Any]:
    work = prepare(*arguments)
    with contextlib.suppress(OSError):
        CLEAR.write_text("5")
    before = _peak_mb()
    work()
    return {"added_mb": _peak_mb() - before}


def _peak_mb() -> float:
    """Peak resident memory of this process alone; Linux's ru_maxrss holds the parent's too."""
    if STATUS.exists():
        line = next(line for line in STATUS.read_text().splitlines() if line.startswith("VmHWM:"))
        return int(line.split()[1]) * 1024 / 1e6
    import resource

    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6
