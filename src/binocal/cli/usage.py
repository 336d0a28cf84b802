"""The sentence of a usage error: which option, what was typed, what it takes."""

from __future__ import annotations

import math
import re
from typing import Any

from binocal.input_file import exists

LONGEST_QUOTE = 60


def usage_message(error: Any) -> str:
    """What a usage error of Typer says, in our words where its own leave out what was typed."""
    message = error.format_message()
    if sentence := _about_number(error):
        head, colon, _ = message.partition(": ")
        message = f"{head}{colon}{sentence}"
    message = message.replace("Input should be", "it must be").rstrip(". ")
    if extra := re.match(r"Got unexpected extra arguments? ?(\(s\))? ?\((?P<first>[^\s)]+)", message):
        message += _about_patterns(extra["first"])
    return message


def quoted(value: object) -> str:
    """What was typed, in quotes, cut where it is long."""
    text = str(value)
    return repr(text if len(text) <= LONGEST_QUOTE else f"{text[:LONGEST_QUOTE]}…")


def _about_number(error: Any) -> str | None:
    """What is wrong with the text of a number, as far as the validation behind the error (Pydantic's) tells."""
    cause = getattr(error, "__cause__", None)
    if not hasattr(cause, "errors"):
        return None
    first = cause.errors()[0]
    kind, limits, typed = first["type"], first.get("ctx", {}), first["input"]
    if kind.startswith("int_"):
        return f"{quoted(typed)} is not a whole number"
    if kind.startswith(("float_", "finite_")) or not _is_finite(typed):
        return f"{quoted(typed)} is not a finite number"
    if kind == "greater_than_equal":
        return f"{quoted(typed)} is below {limits['ge']:g}"
    if kind == "less_than_equal":
        return f"{quoted(typed)} is above {limits['le']:g}"
    return None


def _is_finite(typed: object) -> bool:
    try:
        return math.isfinite(float(str(typed)))
    except ValueError:
        return True  # no number that float reads: another sentence's matter


def _about_patterns(argument: str) -> str:
    """What an argument too many most often comes from, where it is a file: a pattern that the shell has expanded."""
    return "; put patterns in quotes: --left 'left_*.png'" if exists(argument) else ""
