"""How a command's own process is set up before anything heavy is imported. Nothing here changes a result."""

from __future__ import annotations

import atexit
import contextlib
import gc
import os
import signal
import threading
from collections.abc import Iterator
from typing import Any

from binocal.cli.streams import settle_streams

MMAP_THRESHOLD, TRIM_THRESHOLD = -3, -1  # glibc's <malloc.h>
LARGEST_KEPT_BYTES = 32 << 20  # the most that glibc allows
KEPT_BYTES = 256 << 20
ALLOCATIONS_PER_COLLECTION = 100_000  # of Python's own 700, there are a hundred while the modules load


def settle_process() -> None:
    """Leave the cores to binocal's own threads, and freed images' memory to the next images.

    BLAS sees small matrices only, and the pages of an image that is given back and asked for again cost as much as a
    tenth of its decoding. Python looks for garbage in cycles seldom, and not at all when the process ends. A setting of the
    user's own comes first.
    """
    settle_streams()
    gc.set_threshold(ALLOCATIONS_PER_COLLECTION, *gc.get_threshold()[1:])
    atexit.register(gc.freeze)
    atexit.register(_ignore_interrupts)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if not any(name.startswith("MALLOC_") for name in os.environ):
        _keep_freed_memory()


@contextlib.contextmanager
def interrupted_by_signals() -> Iterator[None]:
    """Inside the block SIGTERM and SIGHUP end the work as Ctrl-C does: what was made aside is removed.

    Where they are handled or ignored (``nohup``) already, and outside the main thread, nothing changes.
    """
    is_main = threading.current_thread() is threading.main_thread()
    names = ("SIGTERM", "SIGHUP") if is_main else ()
    numbers = [getattr(signal, name) for name in names if hasattr(signal, name)]
    taken = [number for number in numbers if signal.getsignal(number) is signal.SIG_DFL]
    for number in taken:
        signal.signal(number, _interrupt)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, signal.SIG_DFL)


def _interrupt(*_: Any) -> None:
    raise KeyboardInterrupt


def _ignore_interrupts() -> None:
    """All is done and said when Python ends; an interrupt then would only be a traceback."""
    with contextlib.suppress(ValueError):  # not the main thread
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _keep_freed_memory() -> None:
    import ctypes

    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # another C library
        return
    mallopt(MMAP_THRESHOLD, LARGEST_KEPT_BYTES)
    mallopt(TRIM_THRESHOLD, KEPT_BYTES)
