"""From arguments to an exit code: every way in which a command can end, and how it says so."""

from __future__ import annotations

import errno
import functools
import os
import re
import sys
import warnings
from collections.abc import Sequence
from typing import Any

from binocal.cli.exits import FAILED, FINE, INTERRUPT_TEXT, INTERRUPTED, UNUSABLE_INPUT, USAGE, one_line
from binocal.cli.grouping import group_lines
from binocal.cli.streams import discard, finish_stdout, print_document, say
from binocal.cli.usage import check_texts, usage_message
from binocal.errors import (
    BinocalError,
    CancelledError,
    MissingExtraError,
    NotConvergedError,
    OutputError,
    PluginError,
)
from binocal.findings import finding_document, findings_of

FAILURES = (
    NotConvergedError,
    MissingExtraError,
    PluginError,
    OutputError,
)  # while running; other errors are the input's
# What a path of the user's own can be at fault for; anything else that the system refuses is a failure while running.
PATH_ERRORS = frozenset((errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.EACCES, errno.ENAMETOOLONG, errno.ELOOP))


def run(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code; every :class:`BinocalError` becomes one line on stderr."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    wants_json = "--json" in arguments
    try:
        code = _run(arguments)
        finish_stdout()
        if code == INTERRUPTED:  # typer makes an exit code of an interrupt
            raise KeyboardInterrupt
        return code if isinstance(code, int) else FINE
    except BinocalError as error:
        _report(error_code(error), str(error), wants_json, details(error))
        if isinstance(error, CancelledError):
            return INTERRUPTED
        return FAILED if isinstance(error, FAILURES) else UNUSABLE_INPUT
    except KeyboardInterrupt:
        _report("interrupted", INTERRUPT_TEXT, wants_json)
        return INTERRUPTED
    except BrokenPipeError:
        discard(1)  # the reader left; nobody reads a message
        return FAILED
    except (OSError, MemoryError) as error:
        return _report_system(error, wants_json)
    except Exception as error:
        if type(error).__name__ == "Abort":  # how click, in older versions of typer, passes on an interrupt
            _report("interrupted", INTERRUPT_TEXT, wants_json)
            return INTERRUPTED
        if hasattr(error, "format_message") and hasattr(error, "exit_code"):  # typer's usage errors, of whichever click
            return _report_usage(error, wants_json)
        if wants_json:
            _report("internal", f"{type(error).__name__}: {error}", wants_json)
        raise


@functools.cache
def _command() -> Any:
    """The command line as typer builds it from the verbs' signatures, which takes longer than most refusals."""
    from typer.main import get_command

    from binocal.cli.verbs import app

    return get_command(app)


def _run(arguments: list[str]) -> Any:
    command = _command()
    if arguments:
        check_texts(command.commands.get(arguments[0]), arguments[1:])
    with warnings.catch_warnings():
        warnings.showwarning = _show_warning
        # NumPy's own, of numbers beyond a double's range: what follows from those is refused by name
        warnings.filterwarnings("ignore", category=RuntimeWarning)
        return command(arguments, prog_name="binocal", standalone_mode=False)


def _report_system(error: OSError | MemoryError, wants_json: bool) -> int:
    """What the system refuses: a path that cannot be, or a full disk, a lack of memory, a stdout that takes nothing."""
    if isinstance(error, MemoryError):
        _report("no-memory", "there is not enough memory for it; use smaller or fewer images.", wants_json)
        return FAILED
    name = _where(error) if error.filename is None else os.fsdecode(error.filename)
    words = error.strerror or str(error)
    _report("system", f"{name if len(name) <= 200 else name[:160] + '…'}: {words}.", wants_json)
    return UNUSABLE_INPUT if error.filename is not None and error.errno in PATH_ERRORS else FAILED


def _where(error: OSError) -> str:
    """What an error without a file's name is about: the working folder, where that is gone, or stdout."""
    if error.errno == errno.ENOENT:
        try:
            os.getcwd()
        except OSError:
            return "the working folder"
    return "stdout"


def error_code(error: BaseException) -> str:
    """Stable code of an error for machines: ``TooFewViewsError`` is ``too-few-views``."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "-", type(error).__name__.removesuffix("Error")).lower() or "error"


def details(error: BaseException) -> dict[str, Any]:
    """The figures that an error carries as fields."""
    figures = {key: value for key, value in vars(error).items() if not key.startswith("_")}
    if found := findings_of(error):
        figures["findings"] = [finding_document(one) for one in found]
    notes = getattr(error, "__notes__", [])
    return figures | ({"notes": list(notes)} if notes else {})


def _report(code: str, message: str, wants_json: bool, figures: dict[str, Any] | None = None) -> None:
    """One line on stderr, the lists behind it above; with --json, the same as one document on stdout."""
    from binocal.formats.json_document import dump_json, jsonable

    figures = figures or {}
    notes = [one_line(line) for line in figures.get("notes", [])]
    parts = [line.removeprefix("ignored ").partition(": ") for line in notes if line.startswith("ignored ")]
    ignored = [(path, reason) for path, _, reason in parts]
    lines = group_lines("ignored", "file", ignored)
    lines += group_lines("dropped", "image", figures.get("reasons", {}).items())
    lines += group_lines("dropped", "view", figures.get("rejected", {}).items())
    for line in (*lines, *(line for line in notes if not line.startswith("ignored "))):
        say(line)
    say(f"binocal: {one_line(message)}")
    if wants_json:
        document = {"error": {"code": code, "message": one_line(message)} | figures}
        try:
            print_document(dump_json(jsonable(document)))
            finish_stdout()
        except OSError:
            discard(1)


def _report_usage(error: Any, wants_json: bool) -> int:
    context = getattr(error, "ctx", None)
    command = context.command_path if context is not None else "binocal"
    if type(error).__name__ == "NoArgsIsHelpError":
        print(error.format_message())
        return USAGE
    message = usage_message(error)
    _report("usage", f"{message}{'' if message.endswith('?') else '.'} See `{command} --help`.", wants_json)
    return error.exit_code or USAGE


def _show_warning(message: Any, *_: Any, **__: Any) -> None:
    say(f"warning: {one_line(str(message))}")
