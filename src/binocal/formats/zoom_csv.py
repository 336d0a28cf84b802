"""Which images were taken at which zoom setting: a CSV file with the columns ``setting``, ``left``, ``right``.

A row holds the setting, a number in whatever unit the lenses have, and the globs or folders of its left and right images, relative to
the file.
"""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass
from pathlib import Path

from binocal.errors import FormatError
from binocal.input_file import read_file

COLUMNS = ("setting", "left", "right")
REMEDY = "the first line is setting,left,right; each other line a number and two globs"


@dataclass(frozen=True, slots=True)
class SettingImages:
    """The images of one setting."""

    setting: float
    left: str
    right: str


def read_zoom_settings(path: str | Path) -> tuple[SettingImages, ...]:
    """The rows of a file in ascending order of their settings.

    Raises:
        FormatError: It is missing, or not such a file; the text names the line.
    """
    path = Path(path)
    try:
        text = read_file(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise FormatError(path, f"is not text in UTF-8; {REMEDY}.") from None
    try:
        lines = list(csv.reader(io.StringIO(text), strict=True))
    except csv.Error as error:
        raise FormatError(path, f"is no CSV ({error}); {REMEDY}.") from None
    if not lines or tuple(cell.strip() for cell in lines[0]) != COLUMNS:
        raise FormatError(path, f"line 1: expected {','.join(COLUMNS)}; {REMEDY}.")
    rows: list[SettingImages] = []
    line_of: dict[float, int] = {}
    for number, cells in enumerate(lines[1:], start=2):
        if not any(cell.strip() for cell in cells):
            continue
        if len(cells) != len(COLUMNS):
            raise FormatError(path, f"line {number}: {len(cells)} cells, expected {len(COLUMNS)}; {REMEDY}.")
        given, left, right = (cell.strip() for cell in cells)
        setting = _number(given)
        if setting is None:
            raise FormatError(path, f"line {number}: the setting {given[:40]!r} is not a finite number; {REMEDY}.")
        if setting in line_of:
            raise FormatError(
                path,
                f"line {number}: zoom setting {setting:g} stands on line {line_of[setting]} already; give each once, with a glob of "
                "all its images.",
            )
        line_of[setting] = number
        if not left or not right:
            raise FormatError(path, f"line {number}: a side has no images; {REMEDY}.")
        rows.append(SettingImages(setting, str(path.parent / left), str(path.parent / right)))
    if not rows:
        raise FormatError(path, f"holds no setting; {REMEDY}.")
    return tuple(sorted(rows, key=lambda row: row.setting))


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
