"""How a long computation says how far it is and asks whether to go on."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

ProgressCallback = Callable[[str, int, int], None]
"""Called with (stage, done, total)."""

ShouldStop = Callable[[], bool]
"""Asked between the parts of a computation; True ends it with :class:`binocal.errors.CancelledError`."""


def stage_of(progress: ProgressCallback | None, stage: str) -> Callable[[int, int], None] | None:
    """A callback of one stage: (done, total); None where nobody listens."""
    return partial(progress, stage) if progress else None


def prefixed(progress: ProgressCallback | None, prefix: str) -> ProgressCallback | None:
    """The callback with a prefix before every stage's name; None where nobody listens."""
    return (lambda stage, done, total: progress(prefix + stage, done, total)) if progress else None
