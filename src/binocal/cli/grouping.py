"""Lines for what was left out: one for each reason, not one for each view."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterable

from binocal.cli.exits import one_line

MOST_NAMES = 8  # in one line; --json has all
MOST_LINES = 4  # beyond it, reasons that differ in their numbers alone share a line


def group_lines(verb: str, what: str, reasons: Iterable[tuple[str, str]]) -> list[str]:
    """A line for each reason, in the order in which they first come; ``what`` the names are of: view, image, file.

    ``dropped view 03: why`` for one name, ``dropped 12 views (03, 04, ...): why`` for more.
    """
    given = [(one_line(name), one_line(reason)) for name, reason in reasons]
    groups = _grouped(given, lambda reason: reason)
    if len(groups) > MOST_LINES:
        groups = _grouped(given, lambda reason: re.sub(r"\d+(\.\d+)?", "#", reason))
    return [_line(verb, what, members) for members in groups]


def list_names(names: list[str]) -> str:
    """The first names, and how many more there are."""
    return ", ".join(names[:MOST_NAMES]) + (f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else "")


def _grouped(given: list[tuple[str, str]], key: Callable[[str], str]) -> list[list[tuple[str, str]]]:
    groups: dict[str, list[tuple[str, str]]] = defaultdict(list)
    for name, reason in given:
        groups[key(reason)].append((name, reason))
    return list(groups.values())


def _line(verb: str, what: str, members: list[tuple[str, str]]) -> str:
    name, reason = members[0]
    if len(members) == 1:
        return f"{verb} {what} {name}: {reason}"
    such_as = "" if len({text for _, text in members}) == 1 else "such as "
    return f"{verb} {len(members)} {what}s ({list_names([name for name, _ in members])}): {such_as}{reason}"
