"""From arguments to an exit code: every way in which a command can end, and how it says so."""

from __future__ import annotations

import json
import re
import sys
import warnings
from collections.abc import Sequence
from typing import Any

from binocal.cli.exits import FAILED, FINE, INTERRUPTED, UNUSABLE_INPUT, USAGE, one_line
from binocal.errors import BinocalError, CancelledError, MissingExtraError, NotConvergedError, PluginError
from binocal.findings import finding_document, findings_of


def run(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code; every :class:`BinocalError` becomes one line on stderr."""
    from binocal.cli.verbs import app

    arguments = list(sys.argv[1:] if arguments is None else arguments)
    wants_json = "--json" in arguments
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning
            code = app(arguments, prog_name="binocal", standalone_mode=False)
        sys.stdout.flush()
        if code == INTERRUPTED:  # typer makes an exit code of an interrupt
            raise KeyboardInterrupt
        return code if isinstance(code, int) else FINE
    except BinocalError as error:
        _report(error_code(error), str(error), wants_json, details(error))
        if isinstance(error, CancelledError):
            return INTERRUPTED
        return FAILED if isinstance(error, NotConvergedError | MissingExtraError | PluginError) else UNUSABLE_INPUT
    except KeyboardInterrupt:
        _report("interrupted", "interrupted; no file was left half written.", wants_json)
        return INTERRUPTED
    except BrokenPipeError:
        sys.stderr.close()  # the reader left; nobody reads a message
        return FAILED
    except Exception as error:
        if type(error).__name__ == "Abort":  # how click, in older versions of typer, passes on an interrupt
            _report("interrupted", "interrupted; no file was left half written.", wants_json)
            return INTERRUPTED
        if hasattr(error, "format_message") and hasattr(error, "exit_code"):  # typer's usage errors, of whichever click
            return _report_usage(error, wants_json)
        if wants_json:
            _report("internal", f"{type(error).__name__}: {error}", wants_json)
        raise


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
    figures = figures or {}
    for line in figures.get("notes", []):
        print(one_line(line), file=sys.stderr)
    for name, reason in {**figures.get("reasons", {}), **figures.get("rejected", {})}.items():
        print(f"dropped {name}: {one_line(reason)}", file=sys.stderr)
    print(f"binocal: {one_line(message)}", file=sys.stderr)
    if wants_json:
        document = {"error": {"code": code, "message": one_line(message)} | figures}
        print(json.dumps(document, default=str, allow_nan=False, ensure_ascii=False))


def _report_usage(error: Any, wants_json: bool) -> int:
    context = getattr(error, "ctx", None)
    command = context.command_path if context is not None else "binocal"
    message = error.format_message()
    if type(error).__name__ == "NoArgsIsHelpError":
        print(message)
        return USAGE
    _report("usage", f"{message.rstrip('. ')}. See `{command} --help`.", wants_json)
    return error.exit_code or USAGE


def _show_warning(message: Any, *_: Any, **__: Any) -> None:
    print(f"warning: {one_line(str(message))}", file=sys.stderr)
