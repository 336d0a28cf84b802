"""Round spots: ellipses of one polarity, to half a pixel."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy import ndarray

from binocal.shapes import Float, Float32, Int

MIN_AREA_PX2 = 12.0
MIN_CONTRAST_DN = 12.0


@dataclass(frozen=True, slots=True, eq=False)
class Blobs:
    """Ellipses: centres, mean radii, areas, and half-axes with the angle of the first (radians)."""

    centres_px: Float[ndarray, "n 2"]
    axes_px: Float[ndarray, "n 2"]
    angles_rad: Float[ndarray, "n"]

    def __len__(self) -> int:
        return len(self.centres_px)

    @property
    def radii_px(self) -> Float[ndarray, "n"]:
        """Radius of the circle of the same area."""
        return np.sqrt(self.axes_px.prod(axis=1))

    @property
    def areas_px2(self) -> Float[ndarray, "n"]:
        """Areas."""
        return np.pi * self.axes_px.prod(axis=1)

    def select(self, index: Int[ndarray, "k"]) -> Blobs:
        """Some of the blobs, in the order given."""
        return Blobs(self.centres_px[index], self.axes_px[index], self.angles_rad[index])


def find_blobs(stretched: Float32[ndarray, "h w"], *, is_dark: bool) -> Blobs:
    """Elliptic spots, darker (or brighter) than what is around them, found by local thresholds of four sizes."""
    image = np.clip(stretched, 0, 255).astype(np.uint8)
    if not is_dark:
        image = 255 - image
    image = cv2.GaussianBlur(image, (3, 3), 0)
    shortest = min(image.shape)
    found: list[tuple[float, ...]] = []
    for share in (0.04, 0.09, 0.2, 0.45):
        block = max(7, int(share * shortest)) | 1
        mean = cv2.blur(image, (block, block))
        binary = (image.astype(np.int16) < mean.astype(np.int16) - 6).astype(np.uint8)
        contours, _ = cv2.findContours(binary, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        for contour in contours:
            ellipse = _fit_ellipse(contour, shortest)
            if ellipse is not None:
                found.append(ellipse)
    return _merge(found, image)


def _fit_ellipse(contour: ndarray, shortest: int) -> tuple[float, ...] | None:
    """Centre, half-axes, angle and misfit of a contour that is an ellipse; None if it is not."""
    if not 8 <= len(contour) < 4 * shortest:
        return None
    area = cv2.contourArea(contour)
    # The contour runs through pixel centres, half a pixel inside the spot.
    area_full = area + 0.5 * cv2.arcLength(contour, True) + 1
    if area_full < MIN_AREA_PX2 or area_full > 0.1 * shortest**2:
        return None
    moments = cv2.moments(contour)
    if moments["m00"] <= 0:
        return None
    x, y = moments["m10"] / moments["m00"], moments["m01"] / moments["m00"]
    # Half-axes of the ellipse with the contour's second moments; 1/12 is the pixel's own.
    xx, yy, xy = (moments[name] / moments["m00"] for name in ("mu20", "mu02", "mu11"))
    middle, half = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    major, minor = 2 * np.sqrt(max(middle + half, 0)), 2 * np.sqrt(max(middle - half, 0))
    if minor < 0.8 or major > 5 * minor:
        return None
    misfit = abs(np.pi * major * minor / max(area, 1e-9) - 1)
    hull_area = cv2.contourArea(cv2.convexHull(contour))
    allowance = 0.06 + 0.8 / minor
    if misfit > allowance or area < (1 - allowance) * hull_area:
        return None
    angle = 0.5 * np.arctan2(2 * xy, xx - yy)
    return x, y, major + 0.5, minor + 0.5, angle, misfit


def _merge(found: list[tuple[float, ...]], image: ndarray) -> Blobs:
    """One blob per spot: of those that share a centre, the best ellipse, if it stands out from its surroundings."""
    kept: list[tuple[float, ...]] = []
    taken: dict[tuple[int, int], list[tuple[float, ...]]] = {}
    height, width = image.shape
    for blob in sorted(found, key=lambda blob: blob[5]):
        x, y, major, minor = blob[:4]
        reach = max(minor, 2.0)
        cell = 24
        near = [
            other
            for i in range(int((x - reach) // cell), int((x + reach) // cell) + 1)
            for j in range(int((y - reach) // cell), int((y + reach) // cell) + 1)
            for other in taken.get((i, j), ())
        ]
        if any((x - other[0]) ** 2 + (y - other[1]) ** 2 < (0.7 * min(minor, other[3]) + 1) ** 2 for other in near):
            continue
        cosine, sine = np.cos(blob[4]), np.sin(blob[4])
        inside = image[min(height - 1, max(0, round(y))), min(width - 1, max(0, round(x)))]
        ring = []
        for way in ((cosine, sine), (-cosine, -sine)), ((-sine, cosine), (sine, -cosine)):
            distance = (1.3 * major if way is not None and way[0] == (cosine, sine) else 1.3 * minor) + 1.5
            for dx, dy in way:
                column, row = round(x + distance * dx), round(y + distance * dy)
                if 0 <= column < width and 0 <= row < height:
                    ring.append(int(image[row, column]))
        if len(ring) < 4 or min(ring) - int(inside) < MIN_CONTRAST_DN:
            continue
        kept.append(blob)
        taken.setdefault((int(x // cell), int(y // cell)), []).append(blob)
    values = np.array(kept, dtype=float).reshape(-1, 6)
    return Blobs(values[:, :2], values[:, 2:4], values[:, 4])
