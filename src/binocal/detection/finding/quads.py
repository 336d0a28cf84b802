"""Dark or bright quadrilaterals, the images of printed squares, to a pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy import ndarray

from binocal.detection.finding.blobs import BELOW_DN, MAX_SHARE, MIN_AREA_PX2
from binocal.shapes import Float, Int, UInt8

LEAST_SIDE_PX = 4.0  # in pixels of the scale
MOST_ASPECT = 6.0  # of the longest side over the shortest: a square tilted by 70 degrees has 3
LEAST_SINE = 0.3  # of the angle at a corner
SHARE_FILLED = 0.8, 1.4  # of the quadrilateral between the corners found, which blur rounds to 1.25; a disc fills 1.57
MOST_SIDES = 6  # of an outline whose corners blur has cut off
_ROUND_PX = 0.04  # of the outline's length, that sides leave the outline by


@dataclass(frozen=True, slots=True, eq=False)
class Quads:
    """Quadrilaterals by their corners, clockwise as seen."""

    corners_px: Float[ndarray, "n 4 2"]

    def __len__(self) -> int:
        return len(self.corners_px)

    @property
    def centres_px(self) -> Float[ndarray, "n 2"]:
        """Where the diagonals cross: the images of the squares' own centres."""
        a, b, c, d = np.moveaxis(self.corners_px, 1, 0)
        one, other, away = c - a, d - b, b - a
        along = _cross(away, other) / _cross(one, other)
        return a + along[:, None] * one

    @property
    def radii_px(self) -> Float[ndarray, "n"]:
        """Radius of the circle of the same area."""
        a, b, c, d = np.moveaxis(self.corners_px, 1, 0)
        return np.sqrt(np.abs(0.5 * _cross(c - a, d - b)) / np.pi)


def find_quads(stretched: UInt8[ndarray, "h w"], *, is_dark: bool, scale: int = 1, blocks: tuple[float, ...]) -> Quads:
    """Quadrilaterals darker (or brighter) than what is around them, by local thresholds of so many sizes.

    ``scale`` 2 looks at the image of half the size, which is four times as fast and loses squares below 9 px. Those that touch the
    image's border are none.
    """
    image = stretched if is_dark else 255 - stretched
    if scale == 2:
        image = cv2.resize(image, (image.shape[1] // 2, image.shape[0] // 2), interpolation=cv2.INTER_AREA)
    image = cv2.GaussianBlur(image, (3, 3), 0)
    found = [_find_with_block(image, max(7, int(share * min(image.shape))) | 1) for share in blocks]
    quads = _one_per_place(np.concatenate(found))
    return Quads(scale * (quads + 0.5) - 0.5)


def _find_with_block(image: UInt8[ndarray, "h w"], block: int) -> Float[ndarray, "k 4 2"]:
    labels, stats, index = _label_components(image, block)
    left, top, width, height, area = stats[index].T
    # a quadrilateral fills half of its box at least, but large squares are hollow to a small block
    is_thin = np.minimum(width, height) < LEAST_SIDE_PX
    is_candidate = ~is_thin & (area > 0.12 * width * height)
    quads = []
    for i in np.flatnonzero(is_candidate):
        x, y = left[i], top[i]
        mask = (labels[y : y + height[i], x : x + width[i]] == index[i]).astype(np.uint8)
        outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        corners = _corners_of(max(outlines, key=len))
        if corners is not None:
            quads.append(corners + [x, y])
    return np.array(quads).reshape(-1, 4, 2)


def _label_components(
    image: UInt8[ndarray, "h w"], block: int
) -> tuple[Int[ndarray, "h w"], Int[ndarray, "k 5"], Int[ndarray, "m"]]:
    """Connected pixels below the mean of their block: labels, OpenCV's statistics of each, and which may be squares.

    Those have an area, are not too large, and touch no border of the image.
    """
    binary = cv2.compare(cv2.convertScaleAbs(image, beta=BELOW_DN), cv2.blur(image, (block, block)), cv2.CMP_LT)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(binary, connectivity=4, ltype=cv2.CV_32S)
    left, top, width, height, area = stats.T
    most, (rows, columns) = MAX_SHARE * min(image.shape), image.shape
    is_candidate = (area >= MIN_AREA_PX2) & (np.maximum(width, height) < most)
    is_candidate &= (left > 0) & (top > 0) & (left + width < columns) & (top + height < rows)
    is_candidate[0] = False  # what is not below
    return labels, stats, np.flatnonzero(is_candidate)


def _corners_of(outline: ndarray) -> Float[ndarray, "4 2"] | None:
    """The four corners of an outline, clockwise; None where it has not four."""
    hull = cv2.convexHull(outline)
    polygon = cv2.approxPolyDP(hull, max(1.0, _ROUND_PX * cv2.arcLength(hull, True)), True)
    corners = polygon[:, 0].astype(float)
    if not 4 <= len(corners) <= MOST_SIDES:
        return None
    while len(corners) > 4:
        corners = _without_shortest_side(corners)
    away = np.roll(corners, -1, axis=0) - corners
    sides = np.hypot(*away.T)
    turn = _cross(away, np.roll(away, -1, axis=0)) / np.maximum(sides * np.roll(sides, -1), 1e-9)
    if (turn < 0).all():
        corners, sides, turn = corners[::-1], sides[::-1], -turn[::-1]
    if not (turn > LEAST_SINE).all() or sides.min() < LEAST_SIDE_PX - 1 or sides.max() > MOST_ASPECT * sides.min():
        return None
    area = 0.5 * abs(float(_cross(corners[2] - corners[0], corners[3] - corners[1])))
    if not SHARE_FILLED[0] < cv2.contourArea(outline) / area < SHARE_FILLED[1]:
        return None
    # an outline runs through the middles of its pixels, and their edges are the square's
    away = np.roll(corners, -1, axis=0) - corners
    away /= np.hypot(*away.T)[:, None]
    before = np.roll(away, 1, axis=0)
    return corners + 0.5 * (before - away) / np.maximum(_cross(before, away), LEAST_SINE)[:, None]


def _without_shortest_side(corners: Float[ndarray, "k 2"]) -> Float[ndarray, "l 2"]:
    """The polygon whose shortest side is a corner that was cut off: its neighbours run on until they meet."""
    away = np.roll(corners, -1, axis=0) - corners
    first = int(np.hypot(*away.T).argmin())
    corners, away = np.roll(corners, -first, axis=0), np.roll(away, -first, axis=0)
    sine = _cross(away[-1], away[1])
    if abs(sine) < LEAST_SINE * np.hypot(*away[-1]) * np.hypot(*away[1]):
        return corners[1:]
    met = corners[0] + _cross(corners[1] - corners[0], away[1]) / sine * away[-1]
    return np.concatenate([met[None], corners[2:]])


def _one_per_place(quads: Float[ndarray, "n 4 2"]) -> Float[ndarray, "k 4 2"]:
    """Of those that share a place, the largest."""
    sizes = Quads(quads)
    radius, centre = sizes.radii_px, sizes.centres_px
    order = np.argsort(-radius, kind="stable")
    quads, radius, centre = quads[order], radius[order], centre[order]
    is_near = np.linalg.norm(centre[:, None] - centre, axis=-1) < 0.7 * radius[:, None] + 1
    kept = np.ones(len(quads), bool)
    for first in range(len(quads)):
        if kept[first]:
            kept[first + 1 :] &= ~is_near[first, first + 1 :]
    return quads[kept]


def _cross(a: ndarray, b: ndarray) -> Any:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
