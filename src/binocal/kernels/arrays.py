"""What the functions of this package share: flat contiguous arrays, and how many threads are worth their start."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.shapes import Float
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


def given(whitening: ndarray | None) -> ndarray:
    """The array, or nothing."""
    return NOTHING if whitening is None else np.ascontiguousarray(whitening, dtype=float)


def flat(
    parameters: ndarray,
    R: ndarray,
    t: ndarray,
    object_points: ndarray,
    pixels: ndarray,
    is_seen: ndarray,
    n_rigs: int,
) -> tuple[ndarray, ...]:
    """Contiguous arrays with the batch dimensions made one."""
    n = is_seen.shape[-1]
    return (
        np.ascontiguousarray(parameters, dtype=float).reshape(n_rigs, -1),
        np.ascontiguousarray(R, dtype=float).reshape(-1, 3, 3),
        np.ascontiguousarray(t, dtype=float).reshape(-1, 3),
        np.ascontiguousarray(object_points, dtype=float),
        np.ascontiguousarray(pixels, dtype=float).reshape(-1, 2, n),
        np.ascontiguousarray(is_seen).reshape(-1, n),
    )
