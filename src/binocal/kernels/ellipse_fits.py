"""The fit of blurred ellipses to an image: the outlines and centres of round spots.

Model and formulas: ``ellipse_fit.hpp``. Points are (x, y), (0, 0) the centre of the top-left pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.kernels import _kernel
from binocal.kernels.corner_fits import CORNER_FIT, CornerFits, as_numbers, range_of, record_layout
from binocal.shapes import Float

ELLIPSE_INPUT = np.dtype(
    [
        ("centre_px", float, 2),
        ("axes_px", float, 2),
        ("angle_rad", float),
        ("outward_px", float),
        ("inward_px", float),
    ]
)
"""The kernel's ``EllipseInput``."""

ELLIPSE_FIT = np.dtype([("centre", CORNER_FIT), ("axes_px", float, 2), ("angle_rad", float)])
"""The kernel's ``EllipseResult``."""

if {
    "ELLIPSE_INPUT": record_layout(ELLIPSE_INPUT),
    "ELLIPSE_FIT": record_layout(ELLIPSE_FIT),
} != _kernel.ELLIPSE_LAYOUTS:
    raise ImportError("binocal's compiled kernel is of another version; install binocal again with pip")


@dataclass(frozen=True, slots=True, eq=False)
class EllipseFits:
    """Fitted ellipses, NaN where the fit failed.

    ``centres`` are what :func:`binocal.kernels.corner_fits.pool_corners` takes: of its records, both blurs are the outline's one.
    """

    centres: CornerFits
    axes_px: Float[ndarray, "n 2"]
    angles_rad: Float[ndarray, "n"]

    @property
    def areas_px2(self) -> Float[ndarray, "n"]:
        """The outlines' areas."""
        return np.pi * self.axes_px.prod(axis=1)


def fit_ellipses(
    grey: ndarray,
    centres_px: Float[ndarray, "n 2"],
    axes_px: Float[ndarray, "n 2"],
    angles_rad: Float[ndarray, "n"],
    outward_px: Float[ndarray, "n"],
    inward_px: Float[ndarray, "n"],
) -> EllipseFits:
    """Fit a blurred ellipse to the grey values (h, w), uint8, uint16 or float32, about each start.

    Starts are centres, half-axes and the first axis's direction, right to a few pixels and a fifth of the size;
    ``outward_px`` and ``inward_px`` how far from the outline nothing else is printed. Grey values at the ends of the range
    (:func:`binocal.kernels.corner_fits.range_of`) have no say.

    Raises:
        ValueError: The image is of another type or shape.
    """
    if grey.ndim != 2 or grey.dtype not in (np.uint8, np.uint16, np.float32):
        raise ValueError(f"an image is (h, w), uint8, uint16 or float32; got {grey.shape}, {grey.dtype}")
    inputs = np.empty(len(centres_px), ELLIPSE_INPUT)
    inputs["centre_px"], inputs["axes_px"], inputs["angle_rad"] = centres_px, axes_px, angles_rad
    inputs["outward_px"], inputs["inward_px"] = outward_px, inward_px
    records = np.empty(len(inputs), ELLIPSE_FIT)
    bottom, top = range_of(grey)
    _kernel.fit_ellipses(
        np.ascontiguousarray(grey),
        bottom,
        top,
        as_numbers(inputs),
        as_numbers(records),
    )
    return EllipseFits(
        CornerFits(np.ascontiguousarray(records["centre"])), records["axes_px"].copy(), records["angle_rad"].copy()
    )
