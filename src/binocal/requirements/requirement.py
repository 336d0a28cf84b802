"""What a user needs of a rig, as a sentence: ``depth 1% at 5m``, ``row 0.1px``, ``baseline 0.02%``."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Literal

from binocal.boards.board import parse_length

Quantity = Literal["depth", "row", "baseline", "focal", "reprojection"]
EXAMPLES = "depth 1% at 5m, row 0.1px, baseline 0.02%, focal 0.05%, reprojection 0.3px"
_UNITS: dict[str, tuple[str, ...]] = {
    "depth": ("%", "length"),
    "row": ("px",),
    "baseline": ("%", "length"),
    "focal": ("%", "px"),
    "reprojection": ("px",),
}
_TAKES_RANGE = ("depth", "row")
_NUMBER = r"[0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?"
_SENTENCE = re.compile(
    rf"(?P<quantity>[a-z]+)\s+(?P<number>{_NUMBER})\s*(?P<unit>%|[a-z]+)?"
    r"(?:\s+at\s+(?P<range>.+?))?(?:\s+with\s+(?P<matching>.+?))?"
)


@dataclass(frozen=True, slots=True)
class Requirement:
    """A limit on a figure of the rig. ``text`` is how it was stated.

    ``limit`` is a share (``is_relative``), pixels, or a length in metres (board pitches where ``is_metric`` is False). ``range_m`` is
    where it holds, None where none was stated; ``matching_px`` the noise of a disparity that counts along, 0 for the rig alone.
    """

    text: str
    quantity: Quantity
    limit: float
    is_relative: bool
    range_m: float | None = None
    matching_px: float = 0.0
    is_metric: bool | None = None
    """Whether its lengths have a unit; None where it has no lengths."""

    @property
    def unit(self) -> str:
        """How the limit is printed."""
        if self.is_relative:
            return "%"
        return "px" if self.quantity in ("row", "focal", "reprojection") else "m" if self.is_metric else "pitches"

    def shown(self, value: float) -> str:
        """A value of the figure, in the limit's unit."""
        if not math.isfinite(value):
            return "unknown"
        if self.is_relative:
            return f"{100 * value:.3g} %"
        return f"{1e3 * value:.3g} mm" if self.unit == "m" else f"{value:.3g} {self.unit}"


def parse_requirement(text: str) -> Requirement:
    """The requirement that a sentence states.

    Raises:
        ValueError: It states none; the text says what is wrong with it, and how one looks.
    """
    stated = " ".join(text.split())
    match = _SENTENCE.fullmatch(stated)
    if not match:
        raise ValueError(f"{_short(stated)!r} is no requirement; write one like: {EXAMPLES}")
    quantity, unit = match["quantity"], match["unit"] or ""
    if quantity not in _UNITS:
        raise ValueError(f"{_short(stated)!r}: nothing is known of {quantity!r}; write one like: {EXAMPLES}")
    limit, is_relative, is_metric = _limit(stated, quantity, match["number"], unit)
    if match["range"] is not None and quantity not in _TAKES_RANGE:
        raise ValueError(
            f"{_short(stated)!r}: a {quantity} does not depend on the range; leave out 'at {match['range']}'"
        )
    range_m = None
    if match["range"] is not None:
        try:
            range_m, has_unit = parse_length(match["range"])
        except ValueError:
            raise ValueError(
                f"{_short(stated)!r}: {match['range']!r} is no range; write a length such as 5m after 'at'"
            ) from None
        if is_metric is not None and is_metric != has_unit:
            raise ValueError(f"{_short(stated)!r}: give both lengths a unit, or neither")
        is_metric = has_unit
    if quantity == "depth" and range_m is None:
        raise ValueError(f"{_short(stated)!r}: depth depends on the range; say where, such as 'depth 1% at 5m'")
    if quantity == "depth" and not is_relative and range_m is not None and limit >= range_m:
        raise ValueError(f"{_short(stated)!r}: a limit as large as the range asks for nothing; were the two exchanged?")
    matching_px = 0.0
    if match["matching"] is not None:
        found = re.fullmatch(rf"({_NUMBER})\s*px", match["matching"])
        if quantity != "depth" or not found:
            raise ValueError(f"{_short(stated)!r}: 'with' says how well depth is matched, such as 'with 0.25px'")
        matching_px = float(found[1])
    return Requirement(stated, quantity, limit, is_relative, range_m, matching_px, is_metric)  # type: ignore[arg-type]


def _limit(stated: str, quantity: str, number: str, unit: str) -> tuple[float, bool, bool | None]:
    """The limit, whether it is a share, and whether it is a length with a unit (None: no length)."""
    value = float(number)
    if not 0 < value < math.inf:
        raise ValueError(f"{_short(stated)!r}: a limit is {'finite' if value > 0 else 'above 0'}")
    if unit == "%" and value >= 100:
        raise ValueError(f"{_short(stated)!r}: a limit of 100 % or more asks for nothing; give a smaller one")
    if unit == "%":
        kind = "%"
    elif unit in ("px", ""):
        kind = unit or "nothing"
    else:
        kind = "length"
    if kind not in _UNITS[quantity]:
        known = " or ".join("a length" if u == "length" else u for u in _UNITS[quantity])
        given = f"not in {unit}" if unit else "not without a unit"
        raise ValueError(f"{_short(stated)!r}: a {quantity} is limited in {known}, {given}")
    if kind == "length":
        try:
            length_m, is_metric = parse_length(f"{number}{unit}")
        except ValueError:
            raise ValueError(f"{_short(stated)!r}: {unit!r} is no unit of length (mm, cm, m, in)") from None
        return length_m, False, is_metric
    return value / 100 if kind == "%" else value, kind == "%", None


def _short(text: str) -> str:
    return text if len(text) <= 80 else f"{text[:60]}…"
