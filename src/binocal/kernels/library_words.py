"""What C libraries print to their standard error, caught for the calling thread.

Formulas there are none: ``library_words.cpp`` says how, and why not by the descriptor. Where the C library is not GNU's, nothing is
caught.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from binocal.kernels import _kernel


@contextmanager
def caught_words() -> Iterator[list[str]]:
    """A context in which C code of this thread prints nothing to stderr; its lines are in the list at the end."""
    lines: list[str] = []
    _kernel.begin_catching_words()
    try:
        yield lines
    finally:
        lines += _kernel.end_catching_words().decode(errors="replace").splitlines()
