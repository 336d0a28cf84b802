"""What a signal that ends the process must not cut in two, and what it has to remove before.

A command ends at once, wherever it is: an exception in the main thread would not do, because one that is raised while a module is
loaded, by whichever thread, can be lost or leave the others waiting for ever. Only the command line's own process asks for this
(:mod:`binocal.cli.process`); for everybody else an interrupt is the ``KeyboardInterrupt`` that it always is.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any


class _Interruption:
    """The process's unfinished files and folders, and whether a step is under way that must not be cut."""

    def __init__(self) -> None:
        self.parts: set[Path] = set()
        self.n_uncut = 0
        self.is_pending = False
        self.end: Callable[[], None] = lambda: None
        self.lock = threading.RLock()

    def on_signal(self, *_: Any) -> None:
        if self.n_uncut:
            self.is_pending = True
            return
        for part in tuple(self.parts):
            if part.is_dir():
                shutil.rmtree(part, ignore_errors=True)
            else:
                with contextlib.suppress(OSError):
                    os.unlink(part)
        self.end()


_process = _Interruption()


def add_part(part: Path) -> None:
    """A file or folder that is removed if a signal ends the process."""
    _process.parts.add(part)


def forget_part(part: Path) -> None:
    """It is in its place, or gone."""
    _process.parts.discard(part)


@contextlib.contextmanager
def uncut() -> Iterator[None]:
    """A signal that comes inside the block ends the process behind it; for steps of milliseconds."""
    with _process.lock:
        _process.n_uncut += 1
    try:
        yield
    finally:
        with _process.lock:
            _process.n_uncut -= 1
        if _process.is_pending and not _process.n_uncut and threading.current_thread() is threading.main_thread():
            _process.on_signal()


def end_process_on_signals(end: Callable[[], None]) -> None:
    """From now on SIGINT, SIGTERM and SIGHUP remove what is unfinished and call ``end``, which must not return.

    Those that the process was started to ignore (``nohup``) stay ignored.
    """
    _process.end = end
    for number in ending_signals():
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _process.on_signal)


def ending_signals() -> list[signal.Signals]:
    """Those of the system's signals that ask a process to end."""
    names = ("SIGINT", "SIGTERM", "SIGHUP")
    return [getattr(signal, name) for name in names if hasattr(signal, name)]
