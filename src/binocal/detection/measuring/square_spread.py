"""By how much all squares of an image look wider than they are: what a tone curve, a glare, or ink that ran does to them alike.

A tone curve (gamma, saturation) moves the middle of a blurred edge towards one side, by up to half a blur. Within one square that cannot be
told from a square of another size; squares and gaps of a known ratio tell it.
"""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.kernels.image_lens import LensFitOptions, fit_image_lens
from binocal.shapes import Float

_STEP_PX = 0.25  # of the difference: corners are nearly linear in it


def outward_steps(corners_px: Float[ndarray, "n 4 2"]) -> Float[ndarray, "n 4 2"]:
    """Where corners, clockwise as seen, go if all sides move outward by one pixel."""
    way = np.roll(corners_px, -1, axis=1) - corners_px
    way = way / np.linalg.norm(way, axis=-1, keepdims=True)
    before = np.roll(way, 1, axis=1)
    sine = before[..., 0] * way[..., 1] - before[..., 1] * way[..., 0]
    return (before - way) / sine[..., None]


def measure_spread(
    corners_px: Float[ndarray, "n 4 2"],
    corners_xy: Float[ndarray, "n 4 2"],
    size_wh: tuple[int, int],
    options: LensFitOptions,
) -> float:
    """How far outward, px, all sides seem to lie of where the board has them: as the image's own lens fits best; NaN if none does.

    ``corners_xy`` are the corners on the board; squares whose corners are NaN have no say.
    """
    seen = np.isfinite(corners_px).all(axis=(1, 2))
    points, xy = corners_px[seen], corners_xy[seen].reshape(-1, 2)
    steps = outward_steps(points)
    off = []
    for size in (0.0, -_STEP_PX):
        moved = (points + size * steps).reshape(-1, 2)
        lens = fit_image_lens(xy, moved, size_wh, options, places_xy=xy)
        if lens is None or not np.isfinite(lens.images_px).all():
            return float("nan")
        off.append(moved - lens.images_px)
    change = off[0] - off[1]  # of what the lens leaves, for a step outward
    return float(_STEP_PX * np.sum(off[0] * change) / np.sum(change * change))
