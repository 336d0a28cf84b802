"""How many threads binocal uses: one number for the kernels, for reading and searching images, and for rendering.

By default all processors that this process may use: its affinity, and the limit of its control group (containers). The
environment variable ``BINOCAL_THREADS``, read once when the number is first needed, sets another default;
:func:`set_threads` and the command line's ``--threads`` set it for good. No result depends on it.
"""

from __future__ import annotations

import math
import os
from pathlib import Path

VARIABLE = "BINOCAL_THREADS"
_CGROUPS = Path("/sys/fs/cgroup")
_OWN_CGROUPS = Path("/proc/self/cgroup")

_chosen: int | None = None

MOST_THREADS = 4096


def n_threads() -> int:
    """Threads that binocal uses at most.

    Raises:
        ValueError: ``BINOCAL_THREADS`` is not a whole number of 1 or more.
    """
    global _chosen
    if _chosen is None:
        stated = os.environ.get(VARIABLE, "").strip()
        _chosen = _checked(stated, f"the environment variable {VARIABLE}") if stated else n_processors()
    return _chosen


def set_threads(n: int | None) -> None:
    """Use ``n`` threads at most from now on; None goes back to the default.

    Raises:
        ValueError: ``n`` is not a whole number of 1 or more.
    """
    global _chosen
    _chosen = None if n is None else _checked(n, "the number of threads")


def n_processors() -> int:
    """Processors that this process may use, by its affinity and its control group's limit; at least one."""
    affinity = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, math.ceil(min(affinity, _cgroup_limit())))


def _checked(n: int | str, what: str) -> int:
    try:
        number = int(n)
    except ValueError:
        number = 0
    if not 1 <= number <= MOST_THREADS or number != float(n):
        raise ValueError(f"{what} must be a whole number between 1 and {MOST_THREADS}; got {n!r}")
    return number


def _cgroup_limit() -> float:
    """Processors' worth of time that the control group allows, of version 2 or 1; infinite where nothing limits it."""
    try:
        lines = _OWN_CGROUPS.read_text(encoding="utf-8").splitlines()
    except OSError:
        return math.inf
    limit = math.inf
    for line in lines:
        _, _, rest = line.partition(":")
        controllers, _, group = rest.partition(":")
        if not controllers:
            limit = min(limit, *(_quota_v2(folder) for folder in _with_parents(_CGROUPS, group)))
        elif "cpu" in controllers.split(","):
            for root in (_CGROUPS / controllers, _CGROUPS / "cpu"):
                limit = min(limit, *(_quota_v1(folder) for folder in _with_parents(root, group)))
    return limit


def _with_parents(root: Path, group: str) -> list[Path]:
    """The group's folder and those of the groups that it lies in, up to the root: each may limit it."""
    names = [name for name in group.split("/") if name not in ("", "..")]
    return [root.joinpath(*names[:n]) for n in range(len(names), -1, -1)]


def _quota_v2(folder: Path) -> float:
    quota, _, period = _read(folder / "cpu.max").partition(" ")
    return _share(quota, period)


def _quota_v1(folder: Path) -> float:
    return _share(_read(folder / "cpu.cfs_quota_us"), _read(folder / "cpu.cfs_period_us"))


def _share(quota: str, period: str) -> float:
    """Quota over period; infinite where either is missing, ``max`` or -1."""
    try:
        share = float(quota) / float(period)
    except (ValueError, ZeroDivisionError):
        return math.inf
    return share if share > 0 else math.inf


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8").strip()
    except OSError:
        return ""
