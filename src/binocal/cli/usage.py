"""The sentence of a usage error: which option, what was typed, what it takes."""

from __future__ import annotations

import itertools
import math
import os
import re
from collections.abc import Sequence
from typing import Any

from binocal.input_file import exists

LONGEST_QUOTE = 60
MOST_WORDS = 8


def usage_message(error: Any) -> str:
    """What a usage error of Typer says, in our words where its own leave out what was typed."""
    message = error.format_message()
    if sentence := _about_number(error):
        head, colon, _ = message.partition(": ")
        message = f"{head}{colon}{sentence}"
    message = message.replace("Input should be", "it must be").replace(": Value error, ", ": ").rstrip(". ")
    if extra := re.match(r"Got unexpected extra arguments? ?(?:\(s\))? ?\((?P<all>.*)\)$", message, re.DOTALL):
        message = _about_extra(extra["all"])
    return message


def check_texts(verb: Any, arguments: Sequence[str]) -> None:
    """Refuse what no option can mean and what paths would hide: empty texts, and a file's name that ends like a folder's.

    Args:
        verb: The command as Typer made it, or None where there is none of that name.
        arguments: As typed, after the verb.

    Raises:
        typer.BadParameter: The option is named.
    """
    import typer  # late: while it loads, --json is known already

    options = {name: option for option in getattr(verb, "params", ()) for name in option.opts}
    for before, text in itertools.pairwise(["", *arguments]):
        name, equals, value = text.partition("=")
        if not (equals and name in options):
            name, value = before, text
        if value == "":
            raise typer.BadParameter(f"{name}: nothing is given" if name in options else "an argument is empty")
        is_file = "." in (getattr(options.get(name), "metavar", None) or "")
        if is_file and value.endswith(("/", os.sep)):
            example = os.path.join(value, options[name].metavar.lower())
            raise typer.BadParameter(f"{name}: {value} names a folder; name a file, such as {example}")


def quoted(value: object) -> str:
    """What was typed, in quotes, cut where it is long."""
    text = str(value)
    return repr(text if len(text) <= LONGEST_QUOTE else f"{text[: LONGEST_QUOTE // 2]}…{text[-LONGEST_QUOTE // 2 :]}")


def _about_number(error: Any) -> str | None:
    """What is wrong with the text of a number, as far as the validation behind the error (Pydantic's) tells."""
    cause: Any = getattr(error, "__cause__", None)
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


def _about_extra(arguments: str) -> str:
    """Arguments too many: where the first is a file, it most often comes from a pattern that the shell has expanded."""
    words = arguments.split(" ")
    beginnings = [" ".join(words[:n]) for n in range(1, min(len(words), MOST_WORDS) + 1)]  # names may hold spaces
    file = next((name for name in beginnings if exists(name)), None)
    first = file or words[0]
    others = " and others" if len(first) < len(arguments) else ""
    advice = "; put patterns in quotes: --left 'left_*.png'" if file else ""
    return f"Got unexpected extra arguments: {quoted(first)}{others}{advice}"
