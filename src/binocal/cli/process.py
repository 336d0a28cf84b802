"""How a command's own process is set up before anything heavy is imported. Nothing here changes a result."""

from __future__ import annotations

import atexit
import contextlib
import gc
import os
import signal

from binocal.cli.exits import INTERRUPT_TEXT, INTERRUPTED
from binocal.cli.streams import is_printing, settle_streams
from binocal.interruption import end_process_on_signals, ending_signals

MMAP_THRESHOLD, TRIM_THRESHOLD = -3, -1  # glibc's <malloc.h>
LARGEST_KEPT_BYTES = 32 << 20  # the most that glibc allows
KEPT_BYTES = 256 << 20
SHOW_CURSOR = "\r\x1b[J\x1b[?25h"
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
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if not any(name.startswith("MALLOC_") for name in os.environ):
        _keep_freed_memory()


def end_on_signals(wants_json: bool) -> None:
    """Ctrl-C, SIGTERM and SIGHUP end this process at once, with a line and the exit code for it."""
    end_process_on_signals(lambda: _end(wants_json))


def ignore_signals() -> None:
    """All is done and said: while Python ends, a signal would only change the exit code."""
    for number in ending_signals():
        signal.signal(number, signal.SIG_IGN)


def _end(wants_json: bool) -> None:
    """Says that it was interrupted, past all buffers, and leaves without waiting for any thread."""
    restore = SHOW_CURSOR if os.isatty(2) else ""  # a progress bar may have hidden it
    _write(2, f"{restore}binocal: {INTERRUPT_TEXT}\n")
    if wants_json and not is_printing():
        _write(1, f'{{"error": {{"code": "interrupted", "message": "{INTERRUPT_TEXT}"}}}}\n')
    os._exit(INTERRUPTED)


def _write(descriptor: int, text: str) -> None:
    with contextlib.suppress(OSError):
        os.write(descriptor, text.encode("ascii"))


def _keep_freed_memory() -> None:
    import ctypes

    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # another C library
        return
    mallopt(MMAP_THRESHOLD, LARGEST_KEPT_BYTES)
    mallopt(TRIM_THRESHOLD, KEPT_BYTES)
