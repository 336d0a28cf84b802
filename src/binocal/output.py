"""Where output may be written, and writing it so that it is either there in full or not at all: files and folders."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import tempfile
from collections.abc import Callable, Iterator
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


def write_aside(path: str | Path, content: str | bytes | memoryview, *, force: bool = False) -> None:
    """Write text (UTF-8) or bytes to a temporary file beside ``path``, then rename it to ``path``.

    Raises:
        OutputExistsError: Something is there and ``force`` is False.
        DataError: The file cannot be written.
    """
    path = check_output(path, force=force)
    data = content.encode("utf-8") if isinstance(content, str) else content
    aside = ""
    try:
        aside = str(path.with_name(f".{path.name}.{secrets.token_hex(4)}.part"))
        with open(aside, "xb") as file:  # an ordinary file, with the permissions that the user's files get
            file.write(data)
        os.replace(aside, path)
    except BaseException as error:
        if aside:
            with contextlib.suppress(OSError):
                os.unlink(aside)
        if isinstance(error, OSError):
            raise DataError(f"{path}: cannot be written: {error.strerror}.") from None
        raise


def check_output_folder(output: str | Path, *, force: bool = False) -> Path:
    """The folder as a :class:`Path`, once it is known that results may be put into it.

    Raises:
        OutputExistsError: It holds files and ``force`` is False.
        DataError: It is a file, or cannot be made.
    """
    output = Path(output)
    if output.exists() and not output.is_dir():
        raise DataError(f"{output} is a file; name a folder for the output.")
    if output.is_dir() and any(output.iterdir()) and not force:
        raise OutputExistsError(output)
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"{output.parent}: the output's folder cannot be made: {error.strerror}.") from None
    return output


@contextlib.contextmanager
def staged_folder(
    output: str | Path, *, force: bool = False, before_move: Callable[[Path], None] | None = None, last: str = ""
) -> Iterator[Path]:
    """A temporary folder beside ``output``; its files move there if the block ends well, and vanish if it does not.

    ``before_move`` is called with ``output`` just before, to remove what the new files replace; ``last`` names the file that is
    moved after all others, so that its presence says that all are there.
    """
    output = check_output_folder(output, force=force)
    try:
        aside = Path(tempfile.mkdtemp(prefix=f".{output.name}.", suffix=".part", dir=output.parent))
    except OSError as error:
        raise DataError(f"{output.parent}: the output's folder cannot be written to: {error.strerror}.") from None
    try:
        yield aside
        output.mkdir(exist_ok=True)
        if before_move is not None:
            before_move(output)
        for file in sorted(aside.iterdir(), key=lambda path: path.name == last):
            os.replace(file, output / file.name)
    finally:
        shutil.rmtree(aside, ignore_errors=True)
