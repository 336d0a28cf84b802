"""X-corners: points where four sectors meet, dark and bright in turn, and the directions of the edges between them.

Candidates are peaks of the saddle response (minus the Hessian's determinant, Bowers et al. and many since); each is
then read on a ring around it, where an X-corner shows exactly four transitions, opposite ones alike (the idea of
Bennett & Lasenby 2014, ChESS).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy import ndarray

from binocal.native import pictures

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Float32, Int, UInt8

MIN_CONTRAST_DN = 6.0  # of 255; ring contrast below it is noise in every camera tried
# Opposite samples of a ring agree to 0.35 of its contrast: this admits shading across the ring and a centre that is off
# by a fifth of the radius.
MAX_UNLIKENESS = 0.35
_STRIP_PIXELS = 1 << 16  # four float planes of a strip are 1 MB


@dataclass(frozen=True, slots=True, eq=False)
class XCorners:
    """Candidate X-corners of one picture.

    ``rays_rad`` are the four edge directions in rising angle (x towards y, so clockwise on the screen); the first has
    its bright sector after it (at larger angles), the second before it, and so on in turn. ``contrast_dn`` is bright
    minus dark.
    """

    points_px: Float32[ndarray, "n 2"]
    rays_rad: Float[ndarray, "n 4"]
    contrast_dn: Float[ndarray, "n"]

    def __len__(self) -> int:
        return len(self.points_px)


@dataclass(frozen=True, slots=True, eq=False)
class SaddlePicture:
    """A smoothed picture (0..255, uint8 or float32) with its saddle response, to be read on rings of ``radius_px``."""

    smooth: ndarray
    response: Float32[ndarray, "h w"]
    radius_px: float

    @staticmethod
    def of(smooth: ndarray, radius_px: float) -> SaddlePicture:
        """The picture with :func:`saddle_response`."""
        return SaddlePicture(smooth, saddle_response(smooth), radius_px)


def saddle_response(smooth: ndarray) -> Float32[ndarray, "h w"]:
    """Minus the determinant of the Hessian: positive at saddles, zero along edges. ``smooth`` is uint8 or float32."""
    depth = cv2.CV_16S if smooth.dtype == np.uint8 else cv2.CV_32F
    height, width = smooth.shape
    response = np.empty((height, width), np.float32)
    for start, stop in _strips(height, width):
        low, high = max(0, start - 1), min(height, stop + 1)
        strip, inner = smooth[low:high], slice(start - low, stop - low)
        xx = cv2.Sobel(strip, depth, 2, 0, ksize=3)[inner]
        yy = cv2.Sobel(strip, depth, 0, 2, ksize=3)[inner]
        xy = cv2.Sobel(strip, depth, 1, 1, ksize=3)[inner]
        # ksize-3 kernels sum their smoothing to 4 (second derivatives) and 4 (mixed: 2 x 2), so products carry 16.
        square = cv2.multiply(xy, xy, scale=1 / 16, dtype=cv2.CV_32F)
        cv2.subtract(square, cv2.multiply(xx, yy, scale=1 / 16, dtype=cv2.CV_32F), dst=response[start:stop])
    return response


def _strips(height: int, width: int) -> Iterator[tuple[int, int]]:
    """Rows in strips that the processor's cache holds, which halves the time on large pictures."""
    rows = max(16, _STRIP_PIXELS // width)
    return ((start, min(start + rows, height)) for start in range(0, height, rows))


def _find_peaks(response: Float32[ndarray, "h w"], size: int, margin: int, least: float) -> Int[ndarray, "n 2"]:
    """Columns and rows of the response's maxima in windows of ``size``, ``margin`` from the border, above ``least``."""
    height, width = response.shape
    kernel = np.ones((size, size), np.uint8)
    found = []
    for start, stop in _strips(height, width):
        low, high = max(0, start - size), min(height, stop + size)
        highest = cv2.dilate(response[low:high], kernel)[start - low : stop - low]
        peaks = cv2.compare(response[start:stop], cv2.max(highest, least), cv2.CMP_GE)
        peaks[:, :margin], peaks[:, -margin:] = 0, 0
        peaks[: max(0, margin - start)] = 0
        peaks[max(0, height - margin - start) :] = 0
        at = cv2.findNonZero(peaks)
        if at is not None:
            found.append(at.reshape(-1, 2) + np.array([0, start]))  # (n, 1, 2) before OpenCV 5
    return np.concatenate(found) if found else np.zeros((0, 2), int)


def find_x_corners(saddles: SaddlePicture, *, most: int = 1200) -> XCorners:
    """X-corners of a smoothed grey picture, read on rings. The ``most`` strongest saddles are tried."""
    response, radius_px = saddles.response, saddles.radius_px
    size = 2 * max(1, round(0.6 * radius_px)) + 1
    # A saddle of contrast c blurred by about s px has a response of about (c / 2 / s^2 / 3)^2. Corners cover a few
    # hundredths of a picture at most, and peak far above what a tenth of its pixels reach.
    sparse = response[::8, ::8].ravel()
    tenth = float(np.partition(sparse, int(0.9 * sparse.size))[int(0.9 * sparse.size)])
    least = max((MIN_CONTRAST_DN / (3 * radius_px)) ** 2, 0.5 * tenth)
    at = _find_peaks(response, size, int(np.ceil(radius_px)) + 1, least)
    if len(at) == 0:
        return XCorners(np.zeros((0, 2), np.float32), np.zeros((0, 4)), np.zeros(0))
    columns, rows = at.T
    if len(rows) > most:
        strongest = np.argpartition(response[rows, columns], -most)[-most:]
        rows, columns = rows[strongest], columns[strongest]
    points = _interpolate_peaks(response, rows, columns)
    is_corner, rays, contrast = read_rings(saddles.smooth, points, radius_px)
    return XCorners(points[is_corner], rays[is_corner], contrast[is_corner])


def _interpolate_peaks(response: ndarray, rows: ndarray, columns: ndarray) -> Float32[ndarray, "n 2"]:
    """Peaks to a fraction of a pixel, by parabolas through the neighbours in x and in y."""

    def offset(before: ndarray, at: ndarray, after: ndarray) -> ndarray:
        bend = before - 2 * at + after
        return np.clip(np.where(bend < 0, 0.5 * (before - after) / np.where(bend < 0, bend, -1), 0), -0.5, 0.5)

    at = response[rows, columns]
    x = columns + offset(response[rows, columns - 1], at, response[rows, columns + 1])
    y = rows + offset(response[rows - 1, columns], at, response[rows + 1, columns])
    return np.stack([x, y], axis=-1).astype(np.float32)


def localize_saddles(
    picture: UInt8[ndarray, "h w"], points_px: Float[ndarray, "n 2"], spacing_px: Float[ndarray, "n"]
) -> Float[ndarray, "n 2"]:
    """Points moved to the saddle of the quadratic that fits the grey levels around them best, to about 0.1 px.

    A point stays where the fit is no saddle, or moves by more than its window (a third of the smaller spacings, 2 to 8 px).
    NaN stays NaN. Source: Lucchese & Mitra 2002, "Using saddle points for subpixel feature detection".
    """
    points = np.asarray(points_px, dtype=float).copy()
    index = np.nonzero(np.isfinite(points[:, 0]) & np.isfinite(spacing_px))[0]
    if len(index) == 0:
        return points
    reach = int(np.clip(np.sort(spacing_px[index])[len(index) // 5] / 3, 2, 8))
    fit = _quadratic_fit(reach)
    points[index] = pictures.localize_saddles(picture, points[index], fit, reach)
    return points


@lru_cache(maxsize=16)
def _quadratic_fit(reach: int) -> Float[ndarray, "5 k2"]:
    """The matrix from a window's pixels to the coefficients of x^2, xy, y^2, x and y."""
    step = np.arange(-reach, reach + 1)
    y, x = (axis.ravel().astype(float) for axis in np.meshgrid(step, step, indexing="ij"))
    weight = np.exp(-(x**2 + y**2) / reach**2)
    basis = np.stack([x * x, x * y, y * y, x, y, np.ones_like(x)], axis=-1)
    return np.linalg.solve(basis.T @ (weight[:, None] * basis), basis.T * weight)[:5]


def read_rings(
    smooth: ndarray,
    points_px: Float[ndarray, "n 2"],
    radius_px: float,
    *,
    min_contrast_dn: float = MIN_CONTRAST_DN,
    max_unlikeness: float = MAX_UNLIKENESS,
) -> tuple[Bool[ndarray, "n"], Float[ndarray, "n 4"], Float[ndarray, "n"]]:
    """Which points are X-corners, their edge directions, and their contrast; see :class:`XCorners`."""
    return pictures.read_rings(smooth, points_px, radius_px, min_contrast_dn, max_unlikeness)


def _wrap(angle: ndarray) -> ndarray:
    return (angle + np.pi) % (2 * np.pi) - np.pi
