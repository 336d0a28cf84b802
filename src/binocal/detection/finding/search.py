"""The search for lattices of X-corners: from a coarse image to the full one, then in stretched ones."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy import ndarray

from binocal.detection.finding.groups import link_corners
from binocal.detection.finding.lattice import Lattice, find_lattices
from binocal.detection.finding.xcorners import SaddleImage, XCorners, find_x_corners
from binocal.shapes import Float, Float32, UInt8

LEAST_LINKED_TO_STRETCH = 8  # chance seldom links more than six corners
STRETCHES = 8  # directions of a half turn
COARSEST_PX = 320  # long side of the coarsest image searched: 12 squares across 60 % of it are 16 px each
MOST_KEPT_PIXELS = 1 << 21  # 1920x1080: at most 100 MB a thread


@dataclass(frozen=True, slots=True, eq=False)
class SearchLevel:
    """One search: the lattices in a scaled or stretched image, in that image's pixels.

    ``matrix`` takes the image's pixels to these.
    """

    saddles: SaddleImage
    corners: XCorners
    matrix: Float[ndarray, "2 3"]
    lattices: list[Lattice]
    is_stretched: bool = False
    """And shows a part of the image only."""

    def from_image(self, points: Float[ndarray, "*n 2"]) -> Float[ndarray, "*n 2"]:
        """Points of the image in this one."""
        return points @ self.matrix[:, :2].T + self.matrix[:, 2]

    def to_image(self, points: Float[ndarray, "*n 2"]) -> Float[ndarray, "*n 2"]:
        """Points of this image in the whole one."""
        return (points - self.matrix[:, 2]) @ np.linalg.inv(self.matrix[:, :2]).T


class _Planes(threading.local):
    """A thread's large arrays, kept from image to image: the system takes 3 ms to hand out those of 1280x960.

    What lies in them holds until the thread searches its next image. Those of larger images are not kept.
    """

    def __init__(self) -> None:
        self._kept: dict[tuple[str, int], ndarray] = {}

    def take(self, use: str, index: int, shape: tuple[int, ...]) -> Float32[ndarray, "h w"]:
        """A float32 array of that shape, whatever it holds."""
        if shape[0] * shape[1] > MOST_KEPT_PIXELS:
            return np.empty(shape, np.float32)
        if (use, index) not in self._kept or self._kept[use, index].shape != shape:
            self._kept[use, index] = np.empty(shape, np.float32)
        return self._kept[use, index]


_planes = _Planes()


def search_levels(image: UInt8[ndarray, "h w"], size: tuple[int, int] | None) -> Iterator[SearchLevel]:
    """The lattices of an image (8 bits), coarse to fine.

    Most boards are found at the first level, at a fraction of the cost of the last. ``size`` is the board's corners along
    the longer and the shorter side, None if it is not known. Where it is, and corners were linked but nobody stopped the
    search, the image about them follows, stretched in eight directions.
    """
    halvings = max(0, int(np.floor(np.log2(max(image.shape) / COARSEST_PX))))
    pyramid = [image]
    for _ in range(halvings):
        pyramid.append(cv2.resize(pyramid[-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
    least = 9 if size is None else max(4, min(9, size[0] * size[1] // 2))
    most = 1200 if size is None else max(400, 4 * size[0] * size[1])
    most_linked, linked = 0, np.zeros((0, 2))
    for index, (halved, sigma, radius_px, least_linked) in enumerate(_level_settings(halvings)):
        if most_linked < least_linked:
            continue
        if halved < 0:
            scaled = cv2.resize(image, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
        else:
            scaled = pyramid[halved]
        # As float32: rounded to grey levels, a blurred corner's curvature drowns.
        exact = _planes.take("exact", halved, scaled.shape)
        smooth, response = (_planes.take(use, index, scaled.shape) for use in ("smooth", "response"))
        np.copyto(exact, scaled)
        saddles = SaddleImage.of(cv2.GaussianBlur(exact, (0, 0), sigma, dst=smooth), radius_px, response)
        corners = find_x_corners(saddles, most=most)
        groups = link_corners(saddles, corners)
        if groups and len(groups[0]) > most_linked:
            most_linked = len(groups[0])
            linked = (corners.points_px[groups[0].members] + 0.5) / 0.5**halved - 0.5
        lattices = find_lattices(saddles, corners, groups, least=least, size=size)
        yield SearchLevel(saddles, corners, _scaling(0.5**halved), lattices)
    if size is None or most_linked < LEAST_LINKED_TO_STRETCH:
        return
    for angle in np.linspace(0, np.pi, STRETCHES, endpoint=False):
        stretched, matrix = _stretched(image, linked, angle)
        saddles = SaddleImage.of(cv2.GaussianBlur(stretched, (0, 0), 1.5), 5.0)
        corners = find_x_corners(saddles, most=most)
        groups = link_corners(saddles, corners)
        lattices = find_lattices(saddles, corners, groups, least=least, size=size)
        yield SearchLevel(saddles, corners, matrix, lattices, is_stretched=True)


def _scaling(scale: float) -> Float[ndarray, "2 3"]:
    """Pixel centres are whole numbers before and after."""
    shift = 0.5 * scale - 0.5
    return np.array([[scale, 0, shift], [0, scale, shift]])


def _stretched(
    image: UInt8[ndarray, "h w"], linked_px: Float[ndarray, "n 2"], angle: float
) -> tuple[Float32[ndarray, "h w"], Float[ndarray, "2 3"]]:
    """The image about some corners, drawn to half its length along a direction and twice across.

    There slender rhombi are nearly squares. The corners are a part of a board that may reach thrice as far.
    """
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    A = 0.5 * np.outer(along, along) + 2.0 * np.outer(across, across)
    reach = np.ptp(linked_px, axis=0).max() + 20
    low = np.maximum(linked_px.min(axis=0) - reach, 0)
    high = np.minimum(linked_px.max(axis=0) + reach, np.array(image.shape[::-1]) - 1)
    outline = np.array([low, [high[0], low[1]], [low[0], high[1]], high]) @ A.T
    matrix = np.column_stack([A, -outline.min(axis=0)])
    size = tuple(int(n) for n in np.ceil(np.ptp(outline, axis=0)) + 1)
    drawn = cv2.warpAffine(image.astype(np.float32), matrix, size, borderMode=cv2.BORDER_REPLICATE)
    return drawn, matrix


def _level_settings(halvings: int) -> list[tuple[int, float, float, int]]:
    """The searches in order: halvings of the image, smoothing and ring radius in pixels of the halved image.

    The last number is how many linked corners earlier searches must have seen: chance seldom links more than six, and the
    dear searches only help where squares are small, blurred or noisy, but seen in part.
    """
    if halvings == 0:
        return [(0, 1.2, 4.0, 0), (0, 0.8, 2.6, 0), (-1, 1.2, 3.5, 0)]
    middle = [(halved, 1.2, 4.0, 0) for halved in range(halvings - 1, 0, -1)]
    if halvings == 1:
        return [(1, 0.8, 2.6, 0), (0, 1.2, 4.0, 0), (0, 1.0, 3.0, 0), (1, 1.5, 5.0, 4)]
    return [
        (halvings, 0.8, 2.6, 0),
        *middle,
        (0, 1.0, 3.2, 0),
        (1, 0.8, 2.6, 7),
        (0, 1.5, 5.0, 7),
        (halvings, 1.5, 5.0, 7),
        (0, 2.0, 4.5, 7),
    ]
