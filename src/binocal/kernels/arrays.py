"""What the functions of this package share: contiguous arrays, and how many threads are worth their start."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.shapes import Float, Shaped
from binocal.threads import n_threads

CORNERS_PER_THREAD = 20_000  # half a millisecond of work; starting a thread costs some 30 microseconds
NOTHING = np.empty(0)
"""What the compiled functions take for an optional array that is not given."""


def threads_for(n_corners: int) -> int:
    """Threads for so many corners' work."""
    return min(n_threads(), 1 + n_corners // CORNERS_PER_THREAD)


def per_rig(scale_px: Float[ndarray, "*any"], batch: tuple[int, ...]) -> Float[ndarray, "rigs"]:
    """One scale for each rig, in a row."""
    scale = np.asarray(scale_px, dtype=float)
    if scale.shape != batch:
        scale = np.broadcast_to(scale, batch)
    return np.ascontiguousarray(scale).reshape(-1)


def as_floats(values: Shaped[ndarray, "..."] | None) -> Float[ndarray, "..."]:
    """Contiguous doubles, copied only where they are not; nothing for None."""
    return NOTHING if values is None else np.ascontiguousarray(values, dtype=float)
