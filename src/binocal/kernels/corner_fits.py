"""The fit of the corner model to an image, and the pooling of an image's fits.

Model and formulas: ``corner_fit.hpp`` and ``corner_pool.hpp``. Points are (x, y), (0, 0) the centre of the top-left pixel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.kernels import _kernel
from binocal.kernels.arrays import as_floats
from binocal.shapes import Float, Shaped

CORNER_FIT = np.dtype(
    [
        ("point_px", float, 2),
        ("light_slope", float, 2),
        ("covariance", float, 10),
        ("odd_variance", float),
        ("variance", float),
        ("half_contrast_dn", float),
        ("blur_px", float, 2),
        ("edges_rad", float, 2),
        ("radius_px", float),
        ("n_pixels", float),
        ("n_evaluations", float),
        ("long_variance", float),
        ("clipped_share", float),
    ]
)
"""The kernel's ``CornerResult``: ``covariance`` is the upper triangle, row by row, of that of x, y and the two slopes."""

POOLED_CORNER = np.dtype(
    [
        ("point_px", float, 2),
        ("covariance_px2", float, (2, 2)),
        ("cross_covariance_px2", float, (2, 2)),
        ("misfit", float),
    ]
)
"""The kernel's ``PooledCorner``."""

CORNER_INPUT = np.dtype([("point_px", float, 2), ("reach_px", float), ("strip_px", float)])
"""The kernel's ``CornerInput``."""


def record_layout(record: np.dtype) -> tuple[int, dict[str, int]]:
    """Size and the fields' offsets, bytes."""
    return record.itemsize, {name: offset for name, (_, offset, *_) in (record.fields or {}).items()}


if {
    "CORNER_FIT": record_layout(CORNER_FIT),
    "CORNER_INPUT": record_layout(CORNER_INPUT),
    "POOLED_CORNER": record_layout(POOLED_CORNER),
} != _kernel.RECORD_LAYOUTS:
    raise ImportError("binocal's compiled kernel is of another version; install binocal again with pip")


@dataclass(frozen=True, slots=True, eq=False)
class CornerFits:
    """Fits of the corner model, each on its own; NaN where it failed. ``records`` have the fields of :data:`CORNER_FIT`."""

    records: Shaped[ndarray, "n"]

    @property
    def points_px(self) -> Float[ndarray, "n 2"]:
        """The corners."""
        return self.records["point_px"]

    @property
    def light_slope(self) -> Float[ndarray, "n 2"]:
        """The light's relative slope per pixel."""
        return self.records["light_slope"]

    @property
    def joint_covariance(self) -> Float[ndarray, "n 4 4"]:
        """Covariance of x, y and the two slopes for pixel noise of one grey level (px, 1/px)."""
        joint = np.empty((len(self.records), 4, 4))
        row, column = np.triu_indices(4)
        joint[:, row, column] = joint[:, column, row] = self.records["covariance"]
        return joint

    @property
    def odd_variance(self) -> Float[ndarray, "n"]:
        """Mean square of what is odd in the residuals about the corner, grey levels^2."""
        return self.records["odd_variance"]

    @property
    def variance(self) -> Float[ndarray, "n"]:
        """Mean square of all residuals, grey levels^2."""
        return self.records["variance"]

    @property
    def contrast_dn(self) -> Float[ndarray, "n"]:
        """Bright minus dark, negative where the image's sign is."""
        return 2 * self.records["half_contrast_dn"]

    @property
    def blur_px(self) -> Float[ndarray, "n 2"]:
        """The two edges' Gaussian sigmas, pixel integration included."""
        return self.records["blur_px"]

    @property
    def edges_rad(self) -> Float[ndarray, "n 2"]:
        """Directions of the two edges."""
        return self.records["edges_rad"]

    @property
    def radius_px(self) -> Float[ndarray, "n"]:
        """Radius of the disc that was fitted."""
        return self.records["radius_px"]

    @property
    def n_pixels(self) -> Float[ndarray, "n"]:
        """Pixels in that disc."""
        return self.records["n_pixels"]

    @property
    def long_variance(self) -> Float[ndarray, "n"]:
        """Variance of independent noise that would scatter the corner as the image's does, grey levels^2; NaN if not measured."""
        return self.records["long_variance"]

    @property
    def clipped_share(self) -> Float[ndarray, "n"]:
        """Share of the disc's pixels that are so near an end of the range that their noise is clipped."""
        return self.records["clipped_share"]

    @property
    def n_evaluations(self) -> Float[ndarray, "n"]:
        """How often the model was evaluated."""
        return self.records["n_evaluations"]


@dataclass(frozen=True, slots=True, eq=False)
class BoardPlaces:
    """Corners on their board, whose axes the corners' edges follow.

    ``pitch`` is the distance of the board's lines, in the unit of ``xy``, where every corner has such lines on its four
    sides (the board's outline is one); else 0.
    """

    xy: Float[ndarray, "n 2"]
    pitch: float = 0.0


LEAST_CLIPPED_SHARE = 1e-3  # of a 16-bit image's pixels at its greatest value, for it to be where the sensor clips


def range_of(grey: ndarray) -> tuple[float, float]:
    """The ends of an image's range in grey levels, infinite where none is known: 0 and 255 of 8 bits, of floats none.

    Sensors of 10 to 14 bits clip anywhere in a 16-bit word: the top is the image's greatest value if many pixels have it.
    Where those are no clipped ones (8-bit greys in 16 bits, drawings) no model of them goes beyond it.
    """
    if grey.dtype == np.uint8:
        return 0.0, 255.0
    if grey.dtype != np.uint16 or grey.size == 0:
        return -math.inf, math.inf
    most = int(grey.max())
    is_clipped = np.mean(grey[::4, ::4] == most) >= LEAST_CLIPPED_SHARE
    return 0.0, float(most) if is_clipped else math.inf


def fit_corners(
    grey: ndarray,
    points_px: Float[ndarray, "n 2"],
    reach_px: Float[ndarray, "n"],
    strip_px: Float[ndarray, "n"],
    *,
    board: BoardPlaces | None = None,
) -> CornerFits:
    """Fit a blurred saddle to the grey values (h, w), uint8, uint16 or float32, around each start.

    ``reach_px`` is the distance to the nearest edge that is not the corner's own, ``strip_px`` that from the corner's
    edges to what is printed inside the squares (inf: nothing). Model and formulas: ``corner_fit.hpp``; grey values at the
    ends of the range (:func:`range_of`) are taken for clipped. With the corners' places on the board their edges are the
    curves that the image's lens makes of straight ones: ``board_corners.hpp``.

    Raises:
        ValueError: The image is of another type or shape.
    """
    if grey.ndim != 2 or grey.dtype not in (np.uint8, np.uint16, np.float32):
        raise ValueError(f"an image is (h, w), uint8, uint16 or float32; got {grey.shape}, {grey.dtype}")
    inputs = np.empty(len(points_px), CORNER_INPUT)
    inputs["point_px"], inputs["reach_px"], inputs["strip_px"] = points_px, reach_px, strip_px
    records = np.empty(len(inputs), CORNER_FIT)
    xy, pitch = (None, 0.0) if board is None else (board.xy, float(board.pitch))
    bottom, top = range_of(grey)
    _kernel.fit_corners(
        np.ascontiguousarray(grey), bottom, top, as_numbers(inputs), as_floats(xy), pitch, as_numbers(records)
    )
    return CornerFits(records)


@dataclass(frozen=True, slots=True, eq=False)
class PooledCorners:
    """Corners and covariances that share an image's noise and light, NaN where there is no corner.

    ``cross_covariance_px2`` is the sum of a corner's covariances with the others, which share pixels with it.
    ``misfit`` is the variance of the residuals' odd part over the image's noise.
    """

    points_px: Float[ndarray, "n 2"]
    covariance_px2: Float[ndarray, "n 2 2"]
    cross_covariance_px2: Float[ndarray, "n 2 2"]
    misfit: Float[ndarray, "n"]
    noise_dn: float


def pool_corners(fits: CornerFits, *, are_corners: bool = True) -> PooledCorners:
    """One estimate from the fits of one image; see ``corner_pool.hpp``.

    Fits of other points than corners (``are_corners`` False) share none of their pixels.
    """
    pooled = np.empty(len(fits.records), POOLED_CORNER)
    noise2 = _kernel.pool_corners(as_numbers(fits.records), are_corners, as_numbers(pooled))
    return PooledCorners(
        pooled["point_px"],
        pooled["covariance_px2"],
        pooled["cross_covariance_px2"],
        pooled["misfit"],
        math.sqrt(noise2),
    )


def as_numbers(records: Shaped[ndarray, "n"]) -> Float[ndarray, "n k"]:
    """The same memory as plain numbers."""
    return records.view(float).reshape(len(records), records.dtype.itemsize // 8)
