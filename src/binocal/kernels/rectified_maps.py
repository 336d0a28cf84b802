"""Where in a camera's image the pixels of a rectified image lie; ``rectified_map.cpp``."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.kernels import _kernel
from binocal.kernels.arrays import as_floats
from binocal.shapes import Bool, Float, Float32
from binocal.threads import n_threads

ROWS_PER_THREAD = 64  # a tenth of a millisecond of work at least; starting a thread costs some 30 microseconds
NO_MASK = np.empty(0, bool)


def rectified_map(
    model: str,
    parameters: Float[ndarray, "p"],
    rows: Float[ndarray, "h 3"],
    columns: Float[ndarray, "w 3"],
    size_wh: tuple[int, int],
    *,
    least_cosine: float,
    outside: float = np.nan,
    is_inside: Bool[ndarray, "h w"] | None = None,
    out: Float32[ndarray, "2 h w"] | None = None,
) -> Float32[ndarray, "2 h w"]:
    """X and y of the pixel of a camera's image that lies on the ray ``rows[i] + columns[j]`` of its frame, for each row i and column j.

    ``outside`` (in x and y) where the ray's angle from the axis has a cosine of ``least_cosine`` or less, and where the pixel is not
    in the image of ``size_wh``; ``is_inside`` receives where there is one. The model is one of the compiled ones.

    Raises:
        ValueError: The model is not compiled, or an array has another shape.
    """
    shape = len(rows), len(columns)
    result = np.empty((2, *shape), np.float32) if out is None else out
    _kernel.rectified_map(
        model, as_floats(parameters), as_floats(rows), as_floats(np.asarray(columns).T), np.array(size_wh, dtype=float), float(least_cosine),
        float(outside), result, NO_MASK if is_inside is None else is_inside, min(n_threads(), 1 + shape[0] // ROWS_PER_THREAD),
    )  # fmt: skip
    return result
