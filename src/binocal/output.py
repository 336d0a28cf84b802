"""Where output may be written, and writing it so that it is either there in full or not at all: files and folders.

Everything is made aside first, under a hidden name that ends in ``.part``, and then renamed. A process that is killed leaves its part;
the next one that writes the same output removes it. A part is locked while its process lives, so that none is taken from another.
A symbolic link is followed: what it names is written, beside which the part is made, and the link stays.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import re
import secrets
import shutil
import stat
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path

from binocal.errors import DataError, OutputError, OutputExistsError
from binocal.interruption import add_part, forget_part, uncut

try:
    import fcntl
except ImportError:  # Windows: parts are not locked there, and those of killed processes stay
    fcntl = None

Content = str | bytes | memoryview
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2  # Linux's <fcntl.h> and renameat2(2)

MOST_TRIES = 50  # for a part that nobody else takes for stale; some folders refuse every new name as missing


def check_output(path: str | Path, *, force: bool = False) -> Path:
    """The path that a result may be written to: the given one, or the file that it is a symbolic link to.

    Raises:
        OutputExistsError: Something is there and ``force`` is False.
        DataError: The path is a folder or no name for a file, or its own folder cannot be made or written to.
    """
    path = Path(path)
    try:
        mode = _mode(path)
        is_link = path.is_symlink()
    except (OSError, ValueError) as error:
        raise DataError(f"{_shown(path)}: cannot be a file: {_words(error)}.") from None
    if mode is not None and stat.S_ISDIR(mode):
        raise DataError(f"{path} is a folder; name a file in it, such as {path / 'rig.json'}.")
    is_of_system = path.absolute().parts[1:2] in (
        ("dev",),
        ("proc",),
    )  # /dev/stdout may lead to a file, which is whatever the shell opened
    if mode is not None and (is_of_system or not stat.S_ISREG(mode)):
        raise DataError(f"{path} is a pipe or a device; name an ordinary file.")
    if mode is not None and not force:
        raise OutputExistsError(path)
    if is_link:
        target = Path(os.path.realpath(path))
        if not target.parent.is_dir():
            raise DataError(
                f"{path} is a link to {_shown(target)}, whose folder is missing; mend the link, or name a file."
            )
        path = target
    _check_parent(path)
    return path


def write_aside(path: str | Path, content: Content, *, force: bool = False) -> None:
    """Write text (UTF-8) or bytes to a temporary file beside ``path``, then rename it to ``path``.

    Raises:
        OutputExistsError: Something is there and ``force`` is False.
        DataError: The path cannot be a file's. OutputError: The file cannot be written.
    """
    write_together({path: content}, force=force)


def write_together(contents: Mapping[str | Path, Content], *, force: bool = False) -> None:
    """As :func:`write_aside`, several files: none is renamed to its place before all are written in full.

    Raises:
        OutputExistsError: One is there and ``force`` is False.
        DataError: A path cannot be a file's. OutputError: A file cannot be written; none has changed.
    """
    targets = [(check_output(path, force=force), content) for path, content in contents.items()]
    with contextlib.ExitStack() as parts:
        asides = []
        for path, _ in targets:
            parts.enter_context(_parent_made(path))
        for path, content in targets:
            data = content.encode("utf-8", "surrogateescape") if isinstance(content, str) else content
            asides.append((parts.enter_context(_part_file(path, data)), path))
        with uncut():
            for aside, path in asides:
                try:
                    os.replace(aside, path)
                except OSError as error:
                    raise OutputError(path, _words(error)) from None


def check_output_folder(output: str | Path, *, force: bool = False) -> Path:
    """The folder as a :class:`Path`, once it is known that results may be put into it.

    Raises:
        OutputExistsError: It holds files and ``force`` is False.
        DataError: It is a file, or cannot be made.
    """
    output = Path(output)
    try:
        mode = _mode(output)
        is_empty = mode is None or not stat.S_ISDIR(mode) or not any(output.iterdir())
    except (OSError, ValueError) as error:
        raise DataError(f"{_shown(output)}: cannot be the output's folder: {_words(error)}.") from None
    if mode is not None and not stat.S_ISDIR(mode):
        raise DataError(f"{output} is a file; name a folder for the output.")
    if not is_empty and not force:
        raise OutputExistsError(output)
    _check_parent(output)
    return output


def write_part(path: Path, content: bytes) -> None:
    """A file of a folder that :func:`staged_folder` made; it is not there yet for anybody else.

    Raises:
        OutputError: It cannot be written.
    """
    try:
        path.write_bytes(content)
    except OSError as error:
        raise OutputError(path, _words(error)) from None


@contextlib.contextmanager
def staged_folder(
    output: str | Path,
    *,
    force: bool = False,
    former: Callable[[Path], Collection[str]] | None = None,
    last: Collection[str] = (),
) -> Iterator[Path]:
    """A temporary folder beside ``output`` that takes its place if the block ends well, and vanishes if it does not.

    Files in ``output`` that are neither written anew nor named by ``former``, which is given the folder (names with / for
    those in folders of it), stay. Where there are such, or where the system cannot exchange two folders in one step, the new
    files are moved one by one: those named in ``last`` are taken away first and come last, so that where they are, all are.

    Raises:
        OutputExistsError: ``output`` holds files and ``force`` is False.
        DataError: It cannot be a folder. OutputError: It cannot be written to.
    """
    output = Path(os.path.realpath(check_output_folder(output, force=force)))
    with _parent_made(output), _part_folder(output) as aside:
        try:
            yield aside
        except OutputError as error:  # by the name that the file would have had
            path = Path(str(error.path))
            raise OutputError(
                output / path.relative_to(aside) if aside in path.parents else path, error.problem
            ) from None
        try:
            with uncut():
                _put_in_place(aside, output, former, last)
        except OSError as error:
            raise OutputError(output, _words(error)) from None


def _put_in_place(
    aside: Path, output: Path, former: Callable[[Path], Collection[str]] | None, last: Collection[str]
) -> None:
    if not output.exists():
        os.rename(aside, output)
        return
    new, old = _files(aside), _files(output)
    outdated = (set(former(output)) & old) - new if former is not None else set[str]()
    if old <= new | outdated and _is_replaceable(output) and _exchange(aside, output):
        return
    marks = {name for name in new | old if name.rpartition("/")[2] in last}
    for name in sorted(marks & old) + sorted(outdated - marks):
        (output / name).unlink(missing_ok=True)
    for name in sorted(new - marks) + sorted(new & marks):
        (output / name).parent.mkdir(parents=True, exist_ok=True)
        os.replace(aside / name, output / name)


def _is_replaceable(output: Path) -> bool:
    """Whether another folder may take its place: nobody's working folder, as far as is known here, would vanish with it."""
    here = Path.cwd()
    return output != here and output not in here.parents


def _exchange(aside: Path, output: Path) -> bool:
    """Exchanges two folders in one step, where the system can; what was in ``output`` is then aside, and goes with it."""
    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):
        return False
    os.chmod(aside, stat.S_IMODE(output.stat().st_mode))
    return renameat2(_AT_FDCWD, os.fsencode(aside), _AT_FDCWD, os.fsencode(output), _RENAME_EXCHANGE) == 0


def _files(folder: Path) -> set[str]:
    """Everything in a folder that is no folder, by its path from there."""
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_symlink() or not path.is_dir()}


@contextlib.contextmanager
def _part_file(path: Path, data: bytes | memoryview) -> Iterator[Path]:
    """A file beside ``path`` with the data, removed at the end of the block if it is still there."""
    aside, lock = _locked_part(path, lambda part: os.close(os.open(part, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666)))
    try:
        try:
            with open(aside, "wb") as file:  # an ordinary file, with the permissions that the user's files get
                file.write(data)
        except OSError as error:
            raise OutputError(path, _words(error)) from None
        yield aside
    finally:
        with contextlib.suppress(OSError):
            os.unlink(aside)
        forget_part(aside.absolute())
        _release(lock)


@contextlib.contextmanager
def _part_folder(output: Path) -> Iterator[Path]:
    """A folder beside ``output``, removed at the end of the block if it is still there."""
    aside, lock = _locked_part(output, os.mkdir)
    try:
        yield aside
    finally:
        shutil.rmtree(aside, ignore_errors=True)
        forget_part(aside.absolute())
        _release(lock)


def _locked_part(path: Path, make: Callable[[Path], None]) -> tuple[Path, int | None]:
    """A new part of an output, and the lock that says that its process lives. Parts that nobody holds are removed before."""
    _remove_stale_parts(path)
    for _ in range(MOST_TRIES):
        part = path.with_name(f".{_part_stem(path)}.{secrets.token_hex(4)}.part")
        try:
            add_part(part.absolute())
            make(part)
            lock = _lock(part)
        except FileNotFoundError:
            if not path.parent.is_dir():
                raise OutputError(path, "its folder is gone") from None
            continue  # another process took it for stale between the two
        except OSError as error:
            raise OutputError(path, _words(error)) from None
        if lock is None or _is_still_there(part, lock):
            return part, lock
        _release(lock)
    raise OutputError(path, "its folder takes no new files")


def _remove_stale_parts(path: Path) -> None:
    """Removes what killed processes left of this output."""
    part_name = re.compile(rf"\.{re.escape(_part_stem(path))}\.[a-z0-9_]{{8}}\.part")
    try:
        parts = [entry for entry in path.parent.iterdir() if part_name.fullmatch(entry.name)]
    except OSError:  # of a folder that can be written to but not listed
        return
    for part in parts if fcntl is not None else ():
        with contextlib.suppress(OSError):
            lock = _lock(part, wait=False)
            try:
                if part.is_dir():
                    shutil.rmtree(part, ignore_errors=True)
                else:
                    part.unlink()
            finally:
                _release(lock)


def _part_stem(path: Path) -> str:
    """What of an output's name its parts bear: not more than leaves room for the rest of theirs."""
    return path.name if len(os.fsencode(path.name)) < 200 else path.name[:40]


def _lock(part: Path, *, wait: bool = True) -> int | None:
    """A lock on a file or folder, which ends with the process; None where the system or the file system has none.

    Raises:
        OSError: The part is gone, or (BlockingIOError) another process holds it.
    """
    if fcntl is None:
        return None
    descriptor = os.open(part, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        if error.errno in (errno.ENOLCK, errno.ENOTSUP, errno.EINVAL) and wait:
            return None
        raise
    return descriptor


def _release(lock: int | None) -> None:
    if lock is not None:
        os.close(lock)


def _is_still_there(part: Path, lock: int) -> bool:
    try:
        return os.path.samestat(os.stat(part), os.fstat(lock))
    except OSError:
        return False


def _mode(path: Path) -> int | None:
    """The type and permissions of what is there; None where nothing is."""
    try:
        return os.stat(path).st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None


def _check_parent(path: Path) -> None:
    """Nothing is made yet: whoever only asks, or fails before he writes, leaves no folder behind."""
    folder = path.absolute().parent
    try:
        while _mode(folder) is None:
            folder = folder.parent
    except OSError as error:
        raise DataError(f"{_shown(path.parent)}: the output's folder cannot be made: {_words(error)}.") from None
    if not folder.is_dir():
        raise DataError(f"{_shown(path.parent)}: the output's folder cannot be made: {_shown(folder)} is a file.")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise DataError(f"{_shown(path.parent)}: the output's folder cannot be written to; choose another output.")


@contextlib.contextmanager
def _parent_made(path: Path) -> Iterator[None]:
    """The folder of an output, made where it is missing, and taken away again if the block fails and leaves it empty."""
    missing = [folder for folder in (path.absolute().parent, *path.absolute().parent.parents) if not folder.exists()]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"{_shown(path.parent)}: the output's folder cannot be made: {_words(error)}.") from None
    try:
        yield
    except BaseException:
        for folder in missing:
            with contextlib.suppress(OSError):
                folder.rmdir()
        raise


def _words(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


def _shown(path: Path) -> str:
    text = str(path)
    return text if len(text) <= 200 else f"{text[:120]}…{text[-40:]}"
