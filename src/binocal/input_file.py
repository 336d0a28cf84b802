"""Reading a whole input file: an ordinary file of a bounded size, or an error that names it. Nothing here can hang."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from binocal.errors import FormatError

MOST_BYTES = 2 << 30  # images of the largest cameras are a quarter of it
MOST_TEXT_BYTES = 256 << 20  # a rig.json of 100,000 views is a fifth of it
LEAST_READ_BYTES = 64 << 10  # some file systems state no sizes
_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)


def read_file(path: str | os.PathLike[str], *, most_bytes: int = MOST_BYTES) -> bytes:
    """The content of an ordinary file. Pipes and devices, which may have no end, are refused before they are opened.

    Raises:
        FormatError: It is missing, no ordinary file, cannot be read, or is larger than ``most_bytes``.
    """
    check_ordinary(path)
    try:
        with open(path, "rb") as file:
            size = os.fstat(file.fileno()).st_size
            content = file.read(min(max(size, LEAST_READ_BYTES), most_bytes) + 1)  # room is made for as much at once
    except (OSError, MemoryError) as error:
        raise FormatError(path, f"cannot be read: {_words(error)}") from None
    if len(content) > most_bytes:
        raise FormatError(
            path, f"is larger than the {_size(most_bytes)} that are read of such a file; is it the right one?"
        )
    return content


def read_text(path: str | os.PathLike[str], *, most_bytes: int = MOST_TEXT_BYTES) -> str:
    """The text of an ordinary UTF-8 file, without a byte-order mark. Raises as :func:`read_file`, or where it is no text."""
    try:
        return read_file(path, most_bytes=most_bytes).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FormatError(path, f"is not a text file in UTF-8 (byte {error.start} is none of it)") from None


def check_ordinary(path: str | os.PathLike[str]) -> None:
    """Refuses by name what is not an ordinary file.

    Raises:
        FormatError: It is missing, a folder, a pipe, a device or a socket.
    """
    try:
        mode = os.stat(path).st_mode
    except FileNotFoundError:
        raise FormatError(path, "is missing (no such file); check the name") from None
    except (OSError, ValueError) as error:  # ValueError: a NUL byte in the name
        raise FormatError(path, f"cannot be read: {_words(error)}") from None
    for is_kind, words in _KINDS:
        if is_kind(mode):
            raise FormatError(path, f"is {words}, not an ordinary file; name a file")


def exists(path: str | os.PathLike[str]) -> bool:
    """Whether something is there; False for names that no file can have."""
    try:
        return Path(path).exists()
    except (OSError, ValueError):
        return False


def _words(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error) or type(error).__name__


def _size(n_bytes: int) -> str:
    return f"{n_bytes >> 20} MB" if n_bytes >= 1 << 20 else f"{n_bytes >> 10} kB"
