"""The search for lattices of X-corners: from a coarse image to the full one, then in stretched ones."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy import ndarray

from binocal.detection.finding.groups import link_corners
from binocal.detection.finding.lattice import MIN_CORNERS, Lattice, find_lattices
from binocal.detection.finding.xcorners import SaddleImage, XCorners, find_x_corners
from binocal.shapes import Float, Float32, UInt8

LEAST_LINKED_TO_STRETCH = 8  # chance seldom links more than six corners
# The later, costly searches only help where squares are small, blurred or noisy, but seen in part; for the same reason
# they ask for corners linked before. A small image (one halving) costs little and is searched on less.
LINKED_TO_RETRY, LINKED_TO_RETRY_SMALL = 7, 4
STRETCHES = 8  # directions of a half turn
SHORTENED, WIDENED = 0.5, 2.0  # along and across a direction: rhombi of 4 to 1 become squares
# Share of the image from which all searches are made: paper that saturates parts the dark squares, and only smoothing
# joins them again.
MUCH_SATURATED = 0.3
REACH_OF_LINKED = 1.0  # of the linked corners' extent, beyond them: they are a part of a board of up to three times it
COARSEST_PX = 320  # long side of the coarsest image searched: 12 squares across 60 % of it are 16 px each
MOST_SADDLES = 1200  # tried where the board is not known; otherwise four a corner, for clutter has saddles too
MOST_SADDLES_PER_CORNER, LEAST_SADDLES = 4, 400
MOST_KEPT_PIXELS = 1 << 21  # 1920x1080: at most 100 MB a thread


@dataclass(frozen=True, slots=True, eq=False)
class SearchLevel:
    """One search: the X-corners and lattices of a scaled or stretched image, in that image's pixels.

    ``matrix`` takes the image's pixels to these.
    """

    saddles: SaddleImage
    corners: XCorners
    matrix: Float[ndarray, "2 3"]
    lattices: list[Lattice]
    linked_px: Float[ndarray, "n 2"]
    """The largest group of linked corners, in the image's pixels."""

    @property
    def size_wh(self) -> tuple[int, int]:
        """Width and height of this image, pixels."""
        height, width = self.saddles.smooth.shape
        return width, height

    def from_image(self, points: Float[ndarray, "*n 2"]) -> Float[ndarray, "*n 2"]:
        """Points of the image in this one."""
        return points @ self.matrix[:, :2].T + self.matrix[:, 2]

    def to_image(self, points: Float[ndarray, "*n 2"]) -> Float[ndarray, "*n 2"]:
        """Points of this image in the whole one."""
        return _to_image(points, self.matrix)


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


@dataclass(frozen=True, slots=True)
class _Limits:
    """How many corners a lattice has at least, and how many saddles are tried, for a board's size (None: unknown)."""

    size: tuple[int, int] | None

    @property
    def least_corners(self) -> int:
        return MIN_CORNERS if self.size is None else max(4, min(MIN_CORNERS, self.size[0] * self.size[1] // 2))

    @property
    def most_saddles(self) -> int:
        if self.size is None:
            return MOST_SADDLES
        return max(LEAST_SADDLES, MOST_SADDLES_PER_CORNER * self.size[0] * self.size[1])


def scaled_levels(image: UInt8[ndarray, "h w"], size: tuple[int, int] | None) -> Iterator[SearchLevel]:
    """The lattices of an image (8 bits), coarse to fine.

    Most boards are found at the first level, at a fraction of the cost of the last. ``size`` is the board's corners along
    the longer and the shorter side, None if it is not known.
    """
    is_bright = np.mean(image[::8, ::8] >= 254) > MUCH_SATURATED
    most_linked = 0
    pyramid = _Pyramid(image)
    for index, setting in enumerate(level_settings(pyramid.halvings)):
        if most_linked < setting.least_linked and not is_bright:
            continue
        level = _search(pyramid.saddles(index, setting), _scaling(0.5**setting.halvings), size)
        most_linked = max(most_linked, len(level.linked_px))
        yield level


def scaled_saddles(
    image: UInt8[ndarray, "h w"], settings: Callable[[int], Sequence[LevelSetting]]
) -> Iterator[tuple[SaddleImage, float]]:
    """An image (8 bits) smoothed, with its saddles, by the settings for so many halvings; and the scale of each."""
    pyramid = _Pyramid(image)
    for index, setting in enumerate(settings(pyramid.halvings)):
        yield pyramid.saddles(index, setting), 0.5**setting.halvings


class _Pyramid:
    """An image at its scales."""

    def __init__(self, image: UInt8[ndarray, "h w"]) -> None:
        self.halvings = max(0, int(np.floor(np.log2(max(image.shape) / COARSEST_PX))))
        self._scaled = [image]

    def saddles(self, index: int, setting: LevelSetting) -> SaddleImage:
        """The image at a scale, smoothed, with its saddles: the ``index``-th search's, in arrays that the next image's takes again."""
        scaled = self._at(setting.halvings)
        # As float32: rounded to grey levels, a blurred corner's curvature drowns.
        exact = _planes.take("exact", setting.halvings, scaled.shape)
        smooth, response = (_planes.take(use, index, scaled.shape) for use in ("smooth", "response"))
        np.copyto(exact, scaled)
        smooth = cv2.GaussianBlur(exact, (0, 0), setting.blur_px, dst=smooth)
        return SaddleImage.of(smooth, setting.radius_px, response)

    def _at(self, halvings: int) -> UInt8[ndarray, "h w"]:
        if halvings < 0:
            return cv2.resize(self._scaled[0], None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
        while len(self._scaled) <= halvings:
            self._scaled.append(cv2.resize(self._scaled[-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
        return self._scaled[halvings]


def stretched_levels(
    image: UInt8[ndarray, "h w"], size: tuple[int, int], linked_px: Float[ndarray, "n 2"]
) -> Iterator[SearchLevel]:
    """The lattices of the image about some linked corners, stretched in eight directions in turn.

    Squares that are seen very obliquely are slender rhombi whose corners hardly look like any; in one of the directions
    they are nearly squares.
    """
    for angle in np.linspace(0, np.pi, STRETCHES, endpoint=False):
        stretched, matrix = _stretch(image, linked_px, angle)
        saddles = SaddleImage.of(cv2.GaussianBlur(stretched, (0, 0), 1.5), 5.0)
        yield _search(saddles, matrix, size)


def _search(saddles: SaddleImage, matrix: Float[ndarray, "2 3"], size: tuple[int, int] | None) -> SearchLevel:
    limits = _Limits(size)
    corners = find_x_corners(saddles, most=limits.most_saddles)
    groups = link_corners(saddles, corners)
    linked = corners.points_px[groups[0].members] if groups else np.zeros((0, 2))
    lattices = find_lattices(saddles, corners, groups, least=limits.least_corners, size=size)
    return SearchLevel(saddles, corners, matrix, lattices, _to_image(linked, matrix))


def _to_image(points: Float[ndarray, "*n 2"], matrix: Float[ndarray, "2 3"]) -> Float[ndarray, "*n 2"]:
    (a, b), (c, d) = matrix[:, :2]
    if b == c == 0:
        return (points - matrix[:, 2]) / (a, d)  # the usual, scaled image
    return (points - matrix[:, 2]) @ np.linalg.inv(matrix[:, :2]).T


def _scaling(scale: float) -> Float[ndarray, "2 3"]:
    """Pixel centres are whole numbers before and after."""
    shift = 0.5 * scale - 0.5
    return np.array([[scale, 0, shift], [0, scale, shift]])


def _stretch(
    image: UInt8[ndarray, "h w"], linked_px: Float[ndarray, "n 2"], angle: float
) -> tuple[Float32[ndarray, "h2 w2"], Float[ndarray, "2 3"]]:
    """The image about some corners, drawn to half its length along a direction and twice across."""
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    A = SHORTENED * np.outer(along, along) + WIDENED * np.outer(across, across)
    reach = REACH_OF_LINKED * np.ptp(linked_px, axis=0).max() + 20
    low = np.maximum(linked_px.min(axis=0) - reach, 0)
    high = np.minimum(linked_px.max(axis=0) + reach, np.array(image.shape[::-1]) - 1)
    outline = np.array([low, [high[0], low[1]], [low[0], high[1]], high]) @ A.T
    matrix = np.column_stack([A, -outline.min(axis=0)])
    size = tuple(int(n) for n in np.ceil(np.ptp(outline, axis=0)) + 1)
    drawn = cv2.warpAffine(image.astype(np.float32), matrix, size, borderMode=cv2.BORDER_REPLICATE)
    return drawn, matrix


class LevelSetting(NamedTuple):
    """One search: how often the image is halved (-1: doubled), smoothing and ring radius in pixels of that image."""

    halvings: int
    blur_px: float
    radius_px: float
    least_linked: int = 0
    """Corners that earlier searches must have linked."""


def level_settings(halvings: int) -> list[LevelSetting]:
    """The searches of an image that can be halved so often, in order."""
    if halvings == 0:
        return [LevelSetting(0, 1.2, 4.0), LevelSetting(0, 0.8, 2.6), LevelSetting(-1, 1.2, 3.5)]
    if halvings == 1:
        settings = [LevelSetting(1, 0.8, 2.6), LevelSetting(0, 1.2, 4.0), LevelSetting(0, 1.0, 3.0)]
        return [*settings, LevelSetting(1, 1.5, 5.0, LINKED_TO_RETRY_SMALL)]
    return [
        LevelSetting(halvings, 0.8, 2.6),
        *(LevelSetting(halved, 1.2, 4.0) for halved in range(halvings - 1, 0, -1)),
        LevelSetting(0, 1.0, 3.2),
        LevelSetting(1, 0.8, 2.6, LINKED_TO_RETRY),
        LevelSetting(0, 1.5, 5.0, LINKED_TO_RETRY),
        LevelSetting(halvings, 1.5, 5.0, LINKED_TO_RETRY),
        LevelSetting(0, 2.0, 4.5, LINKED_TO_RETRY),
    ]
