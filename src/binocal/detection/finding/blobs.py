"""Round spots: ellipses of one polarity, and their centroids to a hundredth of a pixel."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy import ndarray

from binocal.detection.measuring.refinement import estimate_noise_dn
from binocal.shapes import Float, Float32, Int

MIN_AREA_PX2 = 12.0
MIN_CONTRAST_DN = 12.0
FLOOR_PX = 0.005  # what is left of the perspective shift; measured 0.0015 to 0.01 px
_REACH = 1.45  # the spot's patch, in its own half-axes; neighbours of a grid with discs of 0.7 pitch begin at 1.8


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


def refine_centres(
    grey: ndarray, blobs: Blobs, *, is_dark: bool
) -> tuple[Float[ndarray, "n 2"], Float[ndarray, "n"], Float[ndarray, "n"]]:
    """Centroids of the spots' own grey values above a fitted plane of background, their variance, px^2, and areas, px^2.

    NaN where none. The area is the spot's light over that of its middle, which blur leaves alone where the spot is larger
    than it; the outlines' areas are 7 % too large at a radius of 20 px.
    Weighting by grey makes the centroid exact under any symmetric blur, as long as the patch holds the whole spot.
    """
    image = grey.astype(np.float32)
    noise_dn = estimate_noise_dn(grey)
    centres, variance = np.full((len(blobs), 2), np.nan), np.full(len(blobs), np.nan)
    areas_px2 = variance.copy()
    for i, ((x, y), (major, minor), angle) in enumerate(
        zip(blobs.centres_px, blobs.axes_px, blobs.angles_rad, strict=True)
    ):
        for _ in range(2):
            fit = _centroid(image, x, y, major, minor, angle, is_dark)
            if fit is None:
                break
            x, y, contrast, n_pixels, spread, area_px2 = fit
        if fit is None or np.hypot(*(np.array([x, y]) - blobs.centres_px[i])) > 0.4 * minor + 1:
            continue
        centres[i], areas_px2[i] = (x, y), area_px2
        # Variance of a first moment: noise^2 sum(r^2) / (contrast area)^2, per axis.
        variance[i] = (noise_dn / contrast) ** 2 * 0.5 * spread * n_pixels / (np.pi * major * minor) ** 2 + FLOOR_PX**2
    return centres, variance, areas_px2


def _centroid(
    image: ndarray, x: float, y: float, major: float, minor: float, angle: float, is_dark: bool
) -> tuple[float, float, float, int, float, float] | None:
    reach = _REACH * major + 2
    left, top = int(np.floor(x - reach)), int(np.floor(y - reach))
    right, bottom = int(np.ceil(x + reach)) + 1, int(np.ceil(y + reach)) + 1
    if left < 0 or top < 0 or right > image.shape[1] or bottom > image.shape[0]:
        return None
    patch = image[top:bottom, left:right].astype(float)
    dy, dx = np.mgrid[top:bottom, left:right].astype(float)
    dx, dy = dx - x, dy - y
    cosine, sine = np.cos(angle), np.sin(angle)
    along, across = dx * cosine + dy * sine, dy * cosine - dx * sine
    # Widened by a fixed 2 px too: the blur does not shrink with the spot.
    radius = np.hypot(along / (_REACH * major + 2), across / (_REACH * minor + 2))
    spot, border = radius < 1, (radius >= 0.88) & (radius < 1)
    if border.sum() < 8:
        return None
    plane = np.column_stack([dx[border], dy[border], np.ones(border.sum())])
    level = np.linalg.lstsq(plane, patch[border], rcond=None)[0]
    height = patch - (dx * level[0] + dy * level[1] + level[2])
    weight = np.where(spot, -height if is_dark else height, 0.0)
    total = weight.sum()
    contrast = total / (np.pi * major * minor)
    if contrast < 3:
        return None
    shift = (weight * dx).sum() / total, (weight * dy).sum() / total
    middle = np.hypot(along / major, across / minor) < 0.45
    top = float(weight[middle].mean()) if middle.sum() >= 5 and minor >= 4 else contrast
    spread = float(((dx**2 + dy**2) * spot).sum() / spot.sum())
    return x + shift[0], y + shift[1], contrast, int(spot.sum()), spread, float(total / max(top, contrast))


def centre_covariance(variance: Float[ndarray, "n"], centres: Float[ndarray, "n 2"]) -> Float[ndarray, "n 2 2"]:
    """Isotropic covariances, NaN where the centre is."""
    covariance = variance[:, None, None] * np.eye(2)
    covariance[~np.isfinite(centres[:, 0])] = np.nan
    return covariance
