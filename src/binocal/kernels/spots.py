"""Components of an image that are darker than their surroundings, with their moments, compiled.

Points are (x, y), (0, 0) the centre of the top-left pixel. tests/kernels states the function plainly and compares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.kernels import _kernel
from binocal.shapes import Bool, Float, UInt8

_ROOM = 2048  # records, at first


@dataclass(frozen=True, slots=True, eq=False)
class Components:
    """Areas in pixels, sides of the boxes, means and second moments (xx, yy, xy) about them, and whether the mean's pixel is one of it."""

    areas_px: Float[ndarray, "n"]
    sizes_wh: Float[ndarray, "n 2"]
    means_px: Float[ndarray, "n 2"]
    moments_px2: Float[ndarray, "n 3"]
    holds_mean: Bool[ndarray, "n"]


def find_components(
    image: UInt8[ndarray, "h w"], around: UInt8[ndarray, "h w"], below_dn: int, least_area_px: int, most_side_px: float
) -> Components:
    """Components, joined along sides, of the pixels more than ``below_dn`` below ``around``, in reading order of their first pixels.

    Those that touch the image's border are left out, and those of less than ``least_area_px`` or not narrower and lower
    than ``most_side_px``.
    """
    room = _ROOM
    while True:
        records = np.empty((room, _kernel.SPOT_SIZE))
        n = _kernel.find_spots(
            np.ascontiguousarray(image),
            np.ascontiguousarray(around),
            below_dn,
            least_area_px,
            float(most_side_px),
            records,
        )
        if n <= room:
            break
        room = n
    records = records[:n]
    return Components(records[:, 0], records[:, 1:3], records[:, 3:5], records[:, 5:8], records[:, 8] > 0)
