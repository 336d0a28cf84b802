"""How a report prints numbers: to few digits, and without powers of ten where they are large."""

from __future__ import annotations


def two_digits(value: float) -> str:
    """``0.0123`` is 0.012, ``1234`` is 1234."""
    return f"{value:.2g}" if abs(value) < 99.5 else f"{value:.0f}"


def three_digits(value: float) -> str:
    """``0.01234`` is 0.0123, ``12345`` is 12345."""
    return f"{value:.3g}" if abs(value) < 999.5 else f"{value:.0f}"
