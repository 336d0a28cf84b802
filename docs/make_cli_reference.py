"""Writes docs/cli.md from the command line itself: `python docs/make_cli_reference.py`. A test holds the two equal."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import typer

from binocal.cli.verbs import app

PATH = Path(__file__).with_name("cli.md")
WIDTH = 100
HEAD = """# Command line

Written by `docs/make_cli_reference.py`; change the verbs in `src/binocal/cli/verbs/` instead of
this page.

Results go to stdout, everything else (what was ignored or dropped and why, progress) to stderr.
With `--json`, stdout holds exactly one document, on errors too:
`{"error": {"code": ..., "message": ...}}`. An output that is a symbolic link is followed: the file
that it names is written, the link stays. Nothing is overwritten without `--force`; a file is
there in full or not at all, a folder too, whenever a command ends or is killed. What a killed one
leaves is hidden, ends in `.part`, and is removed by the next that writes the same output.

| exit code | meaning |
|---|---|
| 0 | fine |
| 1 | failure while running, such as a full disk or a stdout that takes nothing |
| 2 | usage: an option is wrong |
| 3 | input unusable; the text names which image or view, why, and what to do |
| 4 | finished, but below the quality asked for (`--max-rms`, `--require`), or a rig that has changed |
| 130 | interrupted, by Ctrl-C, SIGTERM or SIGHUP |
"""


def reference() -> str:
    """The whole page."""
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    return HEAD + "".join(_section(name, command) for name, command in commands.items())


def _section(name: str, command: Any) -> str:
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    options = [p for p in command.params if p.param_type_name == "option" and p.name != "help"]
    usage = " ".join(["binocal", name, *(p.metavar or p.name.upper() for p in arguments), "[OPTIONS]"])
    lines = [f"\n## binocal {name}\n", _filled(command.help.strip()), f"\n```\n{usage}\n```\n"]
    lines += [_item(f"- `{p.metavar or p.name.upper()}`: {p.help}") for p in arguments]
    for p in options:
        metavar = "" if p.is_flag else f" {p.metavar}"
        shown = (
            f" (default `{_shown(p.default)}`)" if not p.is_flag and p.default is not None and not p.required else ""
        )
        lines.append(_item(f"- `{p.opts[0]}{metavar}`{' (required)' if p.required else ''}: {p.help}{shown}"))
    return "\n".join(lines) + "\n"


def _filled(text: str) -> str:
    return textwrap.fill(" ".join(text.split()), WIDTH, break_long_words=False, break_on_hyphens=False)


def _item(text: str) -> str:
    return textwrap.fill(text, WIDTH, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)


def _shown(value: Any) -> str:
    return str(getattr(value, "value", value))


if __name__ == "__main__":
    PATH.write_text(reference(), encoding="utf-8")
