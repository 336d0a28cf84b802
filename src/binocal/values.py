"""What binocal's value types have in common: arrays that nobody can change, after pickling and copying too, and how they print."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any

import numpy as np
from numpy import ndarray


def frozen_array(values: Any, dtype: type = float) -> ndarray:
    """A read-only copy."""
    array = np.array(values, dtype=dtype)
    array.setflags(write=False)
    return array


class ArrayValue:
    """Base of frozen dataclasses that hold arrays: pickle and copy go through the constructor.

    What pickle would restore by itself are writable arrays that no check has seen.
    """

    __slots__ = ()

    def __reduce__(self) -> tuple[type, tuple[Any, ...]]:
        """The class and its fields, in the constructor's order."""
        return type(self), tuple(getattr(self, field.name) for field in fields(self))  # type: ignore[arg-type]


def with_sigma(value: float, sigma: float) -> str:
    """``1600.123 ± 0.045``: the value to the digits that its standard deviation leaves meaningful."""
    if not math.isfinite(value):
        return "unknown"
    if not (math.isfinite(sigma) and sigma > 0):
        return f"{value:.6g}"
    digits = min(12, max(0, 1 - math.floor(math.log10(sigma))))
    return f"{value:.{digits}f} ± {sigma:.{digits}f}"


def counted(n: int, one: str, many: str = "") -> str:
    """``1 pair``, ``2 pairs``: a number with the word for it; ``many`` where that is not ``one`` with an s."""
    return f"{n} {one if n == 1 else many or one + 's'}"
