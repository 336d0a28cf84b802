"""Sizes of paper, by name."""

from __future__ import annotations

import re

from binocal.boards.board import parse_length

PAPERS = {
    "A4": (210.0, 297.0),
    "A3": (297.0, 420.0),
    "A2": (420.0, 594.0),
    "A1": (594.0, 841.0),
    "A0": (841.0, 1189.0),
    "letter": (215.9, 279.4),
}
"""Width and height in millimetres, upright; the ISO sizes from the smallest on."""

ISO = ("A4", "A3", "A2", "A1", "A0")
LARGEST_MM = 5000.0  # 14400 points are the most that a PDF page may have
LEAST_MM = 10.0


def parse_paper(text: str) -> tuple[float, float]:
    """Width and height of a page in millimetres: ``A3``, ``letter``, ``300x420mm``.

    Raises:
        ValueError: It is none of these.
    """
    for name, size in PAPERS.items():
        if text.strip().lower() == name.lower():
            return size
    found = re.fullmatch(r"\s*([0-9.]+)x([0-9.]+)\s*(mm|cm|m|in)\s*", text)
    if not found:
        raise ValueError(
            f"{text[:40]!r} is no page; write {', '.join(PAPERS)}, or a width and height such as 300x420mm"
        )
    width, height = (1e3 * parse_length(found[i] + found[3])[0] for i in (1, 2))
    if not (min(width, height) >= LEAST_MM and max(width, height) <= LARGEST_MM):
        raise ValueError(f"a page of {text} is not plausible: pages have {LEAST_MM:g} to {LARGEST_MM:g} mm a side")
    return width, height


def smallest_paper(width: float, height: float) -> str | None:
    """The smallest ISO page on which a sheet has room, upright or turned; None where not even A0 is enough."""
    for name in ISO:
        if _fits((width, height), PAPERS[name]):
            return name
    return None


def turned_to_fit(page: tuple[float, float], sheet: tuple[float, float]) -> tuple[float, float]:
    """The page, upright or turned, as the sheet has room on it; where it has on both or neither, as the sheet lies."""
    upright, turned = page, (page[1], page[0])
    has_room = [option for option in (upright, turned) if has_room_for(option, sheet)]
    if len(has_room) == 1:
        return has_room[0]
    return turned if (page[0] < page[1]) == (sheet[0] > sheet[1]) else upright


def has_room_for(page: tuple[float, float], sheet: tuple[float, float]) -> bool:
    """Whether a sheet lies on a page as both stand, to a micrometre."""
    return sheet[0] <= page[0] + 1e-3 and sheet[1] <= page[1] + 1e-3


def _fits(sheet: tuple[float, float], page: tuple[float, float]) -> bool:
    return has_room_for(page, sheet) or has_room_for((page[1], page[0]), sheet)
