"""Round spots, whole or hollow: ellipses of one polarity, to half a pixel."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy import ndarray

from binocal.kernels.spots import find_components
from binocal.shapes import Bool, Float, Int, UInt8

MIN_AREA_PX2 = 6  # of a component, in pixels of the scale
MIN_CONTRAST_DN = 12.0
MAX_SHARE = 0.36  # of the image's shorter side, that a spot may be wide and high
MAX_ASPECT = 5.0
LEAST_MINOR_PX = 0.8  # half-axis, in pixels of the scale
LEAST_FULL = 0.25  # of its ellipse, that a ring fills: its hole is then 0.77 as wide as the ring
# Sides of the local thresholds, of the image's shorter side: a spot must be narrower.
USUAL_BLOCKS, SMALL_BLOCKS, LARGE_BLOCKS = (0.12,), (0.04, 0.09), (0.2, 0.45)
ALL_BLOCKS = (*SMALL_BLOCKS, *LARGE_BLOCKS)
BELOW_DN = 6  # the mean of its block: what counts as a spot
_ANGLES = np.arange(8) * np.pi / 4


@dataclass(frozen=True, slots=True, eq=False)
class Blobs:
    """Ellipses: centres, half-axes with the angle of the first (radians), and how much their middles look like what is around them."""

    centres_px: Float[ndarray, "n 2"]
    axes_px: Float[ndarray, "n 2"]
    angles_rad: Float[ndarray, "n"]
    hollowness: Float[ndarray, "n"]
    """0 of a disc, 1 of a ring with a wide hole; blur lowers it."""

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

    def select(self, index: Int[ndarray, "k"] | Bool[ndarray, "n"]) -> Blobs:
        """Some of the blobs, in the order given."""
        return Blobs(self.centres_px[index], self.axes_px[index], self.angles_rad[index], self.hollowness[index])


def find_blobs(
    stretched: UInt8[ndarray, "h w"], *, is_dark: bool, scale: int = 1, blocks: tuple[float, ...] = ALL_BLOCKS
) -> Blobs:
    """Elliptic spots, darker (or brighter) than what is around them, by local thresholds of so many sizes.

    ``scale`` 2 looks at the image of half the size, which is four times as fast and loses spots below a radius of 3 px.
    Spots that touch the image's border are none.
    """
    image = stretched if is_dark else 255 - stretched
    if scale == 2:
        image = cv2.resize(image, (image.shape[1] // 2, image.shape[0] // 2), interpolation=cv2.INTER_AREA)
    image = cv2.GaussianBlur(image, (3, 3), 0)
    found = [_find_with_block(image, max(7, int(share * min(image.shape))) | 1) for share in blocks]
    spots, misfit = (np.concatenate(parts) for parts in zip(*found, strict=True))
    spots = spots[np.argsort(misfit, kind="stable")]
    blobs = Blobs(spots[:, :2], spots[:, 2:4], spots[:, 4], np.zeros(len(spots)))
    contrast, hollowness = _look_at(image, blobs)
    is_clear = contrast >= MIN_CONTRAST_DN
    kept = _one_per_place(replace(blobs, hollowness=hollowness).select(is_clear))
    centres = scale * (kept.centres_px + 0.5) - 0.5
    return replace(kept, centres_px=centres, axes_px=scale * kept.axes_px)


def _find_with_block(image: UInt8[ndarray, "h w"], block: int) -> tuple[Float[ndarray, "k 5"], Float[ndarray, "k"]]:
    """Components below the mean of their block that are ellipses: centre, half-axes, angle; and their misfits."""
    around = cv2.blur(image, (block, block))
    found = find_components(image, around, BELOW_DN, MIN_AREA_PX2, MAX_SHARE * min(image.shape))
    area, (width, height) = found.areas_px, found.sizes_wh.T
    xx, yy, xy = (found.moments_px2 + [1 / 12, 1 / 12, 0]).T  # a pixel's own
    root = np.sqrt(np.maximum(xx * yy - xy * xy, 1e-9))
    full = area / (4 * np.pi * root)  # 1 of an ellipse, (1 - hole²) / (1 + hole²) of a ring
    is_ring = ~found.holds_mean
    hole2 = np.where(is_ring, np.clip((1 - full) / (1 + full), 0, 1), 0.0)
    half, distance = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    major, minor = (2 * np.sqrt(np.maximum(half + way * distance, 1e-9) / (1 + hole2)) for way in (1, -1))
    allowance = 0.06 + 0.8 / minor
    of_box = np.maximum(
        np.abs(4 * np.sqrt(xx / (1 + hole2)) - width) / width, np.abs(4 * np.sqrt(yy / (1 + hole2)) - height) / height
    )
    misfit = np.maximum(np.where(is_ring, 0.0, np.abs(1 - full)), of_box)
    is_good = (misfit < allowance) & (full > LEAST_FULL) & (minor > LEAST_MINOR_PX) & (major < MAX_ASPECT * minor)
    is_good &= area < 0.95 * width * height + 4
    angle = 0.5 * np.arctan2(2 * xy, xx - yy)
    return np.column_stack([found.means_px, major, minor, angle])[is_good], misfit[is_good]


def _one_per_place(blobs: Blobs) -> Blobs:
    """Of those that share a place, the first."""
    x, y = blobs.centres_px.T
    reach = 0.7 * blobs.axes_px[:, 1]
    is_near = (x[:, None] - x) ** 2 + (y[:, None] - y) ** 2 < (np.minimum(reach[:, None], reach) + 1) ** 2
    kept = np.ones(len(x), bool)
    for first in range(len(x)):
        if kept[first]:
            kept[first + 1 :] &= ~is_near[first, first + 1 :]
    return blobs.select(kept)


def _look_at(image: UInt8[ndarray, "h w"], blobs: Blobs) -> tuple[Float[ndarray, "n"], Float[ndarray, "n"]]:
    """By how much the least bright place around each spot is brighter than the spot, and its hollowness."""
    cosine, sine = np.cos(blobs.angles_rad)[:, None], np.sin(blobs.angles_rad)[:, None]

    def sample(share: float, more_px: float) -> ndarray:
        u = (share * blobs.axes_px[:, :1] + more_px) * np.cos(_ANGLES)
        v = (share * blobs.axes_px[:, 1:] + more_px) * np.sin(_ANGLES)
        x = blobs.centres_px[:, :1] + cosine * u - sine * v
        y = blobs.centres_px[:, 1:] + sine * u + cosine * v
        place = (
            np.clip(np.rint(y), 0, image.shape[0] - 1).astype(int),
            np.clip(np.rint(x), 0, image.shape[1] - 1).astype(int),
        )
        return image[place].astype(float)

    around, within, middle = sample(1.3, 1.5), sample(0.75, 0.0).mean(axis=1), sample(0.0, 0.0)[:, 0]
    height = around.mean(axis=1) - within
    return around.min(axis=1) - within, (middle - within) / np.maximum(height, 1.0)
