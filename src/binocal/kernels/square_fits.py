"""The fit of blurred quadrilaterals to an image: the corners of printed squares.

Model and formulas: ``square_fit.hpp``. Points are (x, y), (0, 0) the centre of the top-left pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.kernels import _kernel
from binocal.kernels.corner_fits import CORNER_FIT, CornerFits, as_numbers, range_of, record_layout
from binocal.shapes import Float

SQUARE_INPUT = np.dtype(
    [
        ("corners_px", float, (4, 2)),
        ("bows_px", float, (4, 3)),
        ("outward_px", float, 4),
        ("reach_px", float),
        ("blur_px", float),
    ]
)
"""The kernel's ``SquareInput``."""

SQUARE_FIT = np.dtype([("corners", CORNER_FIT, 4)])
"""The kernel's ``SquareResult``."""

if {
    "SQUARE_INPUT": record_layout(SQUARE_INPUT),
    "SQUARE_FIT": record_layout(SQUARE_FIT),
} != _kernel.SQUARE_LAYOUTS:
    raise ImportError("binocal's compiled kernel is of another version; install binocal again with pip")


@dataclass(frozen=True, slots=True, eq=False)
class SquareFits:
    """Fitted quadrilaterals, NaN where the fit failed.

    ``corners`` are (4 n) records, square by square, that :func:`binocal.kernels.corner_fits.pool_corners` takes; those of one square
    share its blurs, levels and light.
    """

    corners: CornerFits

    @property
    def corners_px(self) -> Float[ndarray, "n 4 2"]:
        """The corners, clockwise as seen, in the starts' order."""
        return self.corners.points_px.reshape(-1, 4, 2)


def fit_squares(
    grey: ndarray,
    corners_px: Float[ndarray, "n 4 2"],
    bows_px: Float[ndarray, "n 4 3"],
    outward_px: Float[ndarray, "n 4"],
    reach_px: Float[ndarray, "n"],
    *,
    blur_px: float = 1.0,
    is_rough: bool = False,
) -> SquareFits:
    """Fit a blurred quadrilateral to the grey values (h, w), uint8, uint16 or float32, about each start.

    Starts are corners clockwise as seen, right to two pixels; none goes farther than ``reach_px`` in x or y. Edge i runs from
    corner i to the next one and leaves its chord by t (1 - t) (k0 + k1 t + k2 t^2) px inward, t from 0 to 1 along it, with k the
    ``bows_px``: 0 where the lens bends nothing. ``outward_px`` is how far outside of each edge nothing else is printed. Grey values
    at the ends of the range (:func:`binocal.kernels.corner_fits.range_of`) have no say. ``blur_px`` is where the blur starts; a
    rough fit looks at every other pixel and stops a tenth of a pixel away.

    Raises:
        ValueError: The image is of another type or shape.
    """
    if grey.ndim != 2 or grey.dtype not in (np.uint8, np.uint16, np.float32):
        raise ValueError(f"an image is (h, w), uint8, uint16 or float32; got {grey.shape}, {grey.dtype}")
    inputs = np.empty(len(corners_px), SQUARE_INPUT)
    inputs["corners_px"], inputs["bows_px"] = corners_px, bows_px
    inputs["outward_px"], inputs["reach_px"] = outward_px, reach_px
    inputs["blur_px"] = blur_px
    records = np.empty(len(inputs), SQUARE_FIT)
    bottom, top = range_of(grey)
    _kernel.fit_squares(np.ascontiguousarray(grey), bottom, top, as_numbers(inputs), is_rough, as_numbers(records))
    return SquareFits(CornerFits(np.ascontiguousarray(records["corners"]).reshape(-1)))
