"""X-corners: points where four sectors meet, dark and bright in turn, and the directions of the edges between them.

Candidates are peaks of the saddle response (minus the Hessian's determinant, Bowers et al. and many since); each is
then read on a ring around it, where an X-corner shows exactly four transitions, opposite ones alike (the idea of
Bennett & Lasenby 2014, ChESS).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.kernels import images
from binocal.shapes import Bool, Float, Float32

MIN_CONTRAST_DN = 6.0  # of 255; ring contrast below it is noise in every camera tried
# Opposite samples of a ring agree to 0.35 of its contrast: this admits shading across the ring and a centre that is off
# by a fifth of the radius.
MAX_UNLIKENESS = 0.35
# Where the lattice says that a corner must be, half the contrast and less likeness will do: edges and grid bear it out.
WEAK_CONTRAST_DN = 3.0
WEAK_UNLIKENESS = 0.6
PEAK_PER_TENTH = 0.5  # of the response that a tenth of the pixels exceed; corners peak far above it
PEAK_REACH_PER_RADIUS = 0.6  # two corners are never closer than a ring's radius; peaks within 0.6 of it are one


@dataclass(frozen=True, slots=True, eq=False)
class XCorners:
    """Candidate X-corners of one image.

    ``rays_rad`` are the four edge directions in rising angle (x towards y, so clockwise on the screen); the first has
    its bright sector after it (at larger angles), the second before it, and so on in turn. ``contrast_dn`` is bright
    minus dark.
    """

    points_px: Float[ndarray, "n 2"]
    rays_rad: Float[ndarray, "n 4"]
    contrast_dn: Float[ndarray, "n"]

    def __len__(self) -> int:
        return len(self.points_px)


@dataclass(frozen=True, slots=True, eq=False)
class SaddleImage:
    """A smoothed image (0..255) with its saddle response, to be read on rings of ``radius_px``."""

    smooth: Float32[ndarray, "h w"]
    response: Float32[ndarray, "h w"]
    radius_px: float

    @staticmethod
    def of(
        smooth: Float32[ndarray, "h w"], radius_px: float, response: Float32[ndarray, "h w"] | None = None
    ) -> SaddleImage:
        """The image with its response, which is written into ``response`` if given."""
        return SaddleImage(smooth, images.saddle_response(smooth, response), radius_px)


def find_x_corners(saddles: SaddleImage, *, most: int = 1200) -> XCorners:
    """X-corners of a smoothed grey image, read on rings. The ``most`` strongest saddles are tried."""
    return find_saddles(saddles, most=most)[0]


def find_saddles(saddles: SaddleImage, *, most: int = 1200) -> tuple[XCorners, Float[ndarray, "n 2"]]:
    """As :func:`find_x_corners`, and all the saddles that were tried."""
    response, radius_px = saddles.response, saddles.radius_px
    # A saddle of contrast c blurred by about s px has a response of about (c / 2 / s^2 / 3)^2. Corners cover a few
    # hundredths of an image at most, and peak far above what a tenth of its pixels reach.
    sparse = response[::8, ::8].ravel()
    ranks = (int(0.9 * sparse.size), max(0, int(sparse.size * (1 - 40 * most / response.size))))
    tenth, enough = (float(value) for value in np.partition(sparse, ranks)[list(ranks)])
    least = max((MIN_CONTRAST_DN / (3 * radius_px)) ** 2, PEAK_PER_TENTH * tenth)
    reach, margin = max(1, round(PEAK_REACH_PER_RADIUS * radius_px)), int(np.ceil(radius_px)) + 1
    # Where noise has more peaks than are wanted, most are skipped by what only so many pixels reach.
    points = images.find_peaks(response, reach, margin, max(least, enough), most)
    if len(points) < most and enough > least:
        points = images.find_peaks(response, reach, margin, least, most)
    is_corner, rays, contrast = read_rings(saddles.smooth, points, radius_px)
    return XCorners(points[is_corner], rays[is_corner], contrast[is_corner]), points


def read_rings(
    smooth: ndarray,
    points_px: Float[ndarray, "n 2"],
    radius_px: float,
    *,
    min_contrast_dn: float = MIN_CONTRAST_DN,
    max_unlikeness: float = MAX_UNLIKENESS,
) -> tuple[Bool[ndarray, "n"], Float[ndarray, "n 4"], Float[ndarray, "n"]]:
    """Which points are X-corners, their edge directions, and their contrast; see :class:`XCorners`."""
    return images.read_rings(smooth, points_px, radius_px, min_contrast_dn, max_unlikeness)


def wrap_angle(angle: ndarray) -> ndarray:
    """The same angle, radians, from -pi to pi."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
