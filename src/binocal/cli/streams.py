"""Writing to stdout and stderr that may be closed, full, of another encoding, or read by nobody any more."""

from __future__ import annotations

import contextlib
import io
import os
import re
import sys
from typing import Any

_BEYOND_ASCII = re.compile(r"[^\x00-\x7f]")


def settle_streams() -> None:
    """Let no character and no closed stream end a command.

    What an encoding cannot say is escaped. Closed descriptors are opened on nothing, so that no file of a result gets the
    number of a standard stream, and stderr goes nowhere rather than to stdout.
    """
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            with contextlib.suppress(OSError):
                os.open(os.devnull, os.O_RDWR)  # gets the lowest number, which is this one
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 - for the process's life
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def say(line: str) -> None:
    """A line on stderr; where it cannot be written, nobody can be told."""
    try:
        print(line, file=sys.stderr)
        sys.stderr.flush()
    except (OSError, ValueError):
        discard(2)


class _Printing:
    """Whether a document is on its way, which another must not follow."""

    has_begun = False


def is_printing() -> bool:
    """Whether a document has been, or is being, printed."""
    return _Printing.has_begun


def print_document(text: str) -> None:
    """A JSON document on stdout, in ASCII where stdout cannot say all of it."""
    _Printing.has_begun = True
    try:
        text.encode(getattr(sys.stdout, "encoding", None) or "utf-8")
    except UnicodeEncodeError:
        text = _BEYOND_ASCII.sub(_escape, text)
    print(text, end="" if text.endswith("\n") else "\n")


def finish_stdout() -> None:
    """See that all that was printed has been written.

    Raises:
        OSError: It could not be; what is left is given up.
    """
    if sys.stdout is None:
        raise OSError("it is closed")
    try:
        sys.stdout.flush()
    except OSError:
        discard(1)
        raise


def discard(descriptor: int) -> None:
    """Send a standard stream nowhere from now on, so that Python does not fail on what is left of it when it ends."""
    with contextlib.suppress(OSError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, descriptor)
        os.close(nowhere)


def _escape(match: Any) -> str:
    """JSON's escape of a character, two of them beyond the first 65,536."""
    code = ord(match[0])
    if code < 0x10000:
        return f"\\u{code:04x}"
    code -= 0x10000
    return f"\\u{0xD800 + (code >> 10):04x}\\u{0xDC00 + (code & 0x3FF):04x}"
