"""The checks of a calibration in ten lines: coloured by severity on a terminal, plain elsewhere, and as a document."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

from binocal.cli.exits import one_line
from binocal.findings import Severity
from binocal.validation.overview import CheckLine

_WORDS = {None: "ok", Severity.NOTE: "note", Severity.WARNING: "warning"}
_STYLES = {None: "green", Severity.NOTE: "cyan", Severity.WARNING: "bold yellow"}


def show_checks(lines: Sequence[CheckLine]) -> None:
    """Print them on stdout."""
    if not lines:
        return
    if sys.stdout is None or not sys.stdout.isatty():
        print("\n" + checks_text(lines))
        return
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 1))
    for line in lines:
        style = _STYLES[line.severity]
        table.add_row(Text(line.name), Text(_WORDS[line.severity], style=style), Text(one_line(line.text)))
    print()
    Console().print(table)


def checks_text(lines: Sequence[CheckLine]) -> str:
    """One line for each check."""
    return "\n".join(f"{line.name:<10} {_WORDS[line.severity]:<8} {one_line(line.text)}" for line in lines)


def checks_document(lines: Sequence[CheckLine]) -> list[dict[str, Any]]:
    """The same as plain data."""
    return [
        {"name": line.name, "severity": _WORDS[line.severity], "text": line.text, "codes": line.codes} for line in lines
    ]
