"""Writing a file so that it is either there in full or not at all."""

from __future__ import annotations

import contextlib
import os
import tempfile
from pathlib import Path

from binocal.errors import DataError, OutputExistsError


def check_output(path: str | Path, *, force: bool = False) -> Path:
    """The path as a :class:`Path`, once it is known that a result may be written there; its folder is made if missing.

    Raises:
        OutputExistsError: Something is there and ``force`` is False.
        DataError: The path is a folder, or its own folder cannot be made or written to.
    """
    path = Path(path)
    if path.is_dir():
        raise DataError(f"{path} is a folder; name a file in it, such as {path / 'rig.json'}.")
    if path.exists() and not force:
        raise OutputExistsError(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"{path.parent}: the output's folder cannot be made: {error.strerror}.") from None
    if not os.access(path.parent, os.W_OK):
        raise DataError(f"{path.parent}: the output's folder cannot be written to; choose another output.")
    return path


def write_aside(path: str | Path, content: str | bytes, *, force: bool = False) -> None:
    """Write text (UTF-8) or bytes to a temporary file beside ``path``, then rename it to ``path``.

    Raises:
        OutputExistsError: Something is there and ``force`` is False.
        DataError: The file cannot be written.
    """
    path = check_output(path, force=force)
    data = content.encode("utf-8") if isinstance(content, str) else content
    aside = ""
    try:
        handle, aside = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent)
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        os.chmod(aside, 0o666 & ~_umask())  # mkstemp makes files private; a result is an ordinary file
        os.replace(aside, path)
    except BaseException as error:
        if aside:
            with contextlib.suppress(OSError):
                os.unlink(aside)
        if isinstance(error, OSError):
            raise DataError(f"{path}: cannot be written: {error.strerror}.") from None
        raise


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
