"""OpenCV's process-wide settings, changed for a while and given back: its log level, and its own threads."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any


class _BorrowedSetting:
    """A process-wide setting that several threads may hold at one value; the last to leave restores the caller's."""

    def __init__(self, value: Any, access: Callable[[], tuple[Callable[[], Any], Callable[[Any], Any]]]) -> None:
        self._value, self._access = value, access
        self._lock, self._depth, self._before = threading.Lock(), 0, None

    @contextmanager
    def held(self) -> Iterator[None]:
        """The setting at its value inside the block."""
        read, write = self._access()
        with self._lock:
            if self._depth == 0:
                self._before = read()
                write(self._value)
            self._depth += 1
        try:
            yield
        finally:
            with self._lock:
                self._depth -= 1
                if self._depth == 0:
                    write(self._before)


def _log_level() -> tuple[Callable[[], Any], Callable[[Any], Any]]:
    from cv2.utils import logging

    return logging.getLogLevel, logging.setLogLevel


def _threads() -> tuple[Callable[[], Any], Callable[[Any], Any]]:
    import cv2

    return cv2.getNumThreads, cv2.setNumThreads


_SILENT = 0  # cv2.utils.logging.LOG_LEVEL_SILENT
_log = _BorrowedSetting(_SILENT, _log_level)
_own_threads = _BorrowedSetting(1, _threads)


def quiet_opencv() -> AbstractContextManager[None]:
    """A context in which OpenCV logs nothing."""
    return _log.held()


def single_threaded_opencv() -> AbstractContextManager[None]:
    """A context in which OpenCV starts no threads of its own: the images already fill binocal's."""
    return _own_threads.held()
