"""The crossings of a board's lines that are known by name in an image: they tell where the others lie, and how large its faces are there.

Nothing is assumed of the lens but that crossings near each other are seen through the same part of it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy import ndarray

from binocal.detection.finding.marker_grid import MarkerGrid
from binocal.kernels.marker_grids import FieldLens, grow_lattice, predict_each, predict_places, predict_steps
from binocal.shapes import Float, Float32

FOLLOWED_RAD = tuple(np.radians([0, 70, 100, 130, 160, 190]))
WELL_EXPECTED_PX = 0.5  # median distance of corners from where those around them put them
LEAST_BETTER_EXPECTED = 1.2
INSIDE_PX = 6.0
PROBE = 0.2  # of a face's side, about a corner, to see how large it is there


def points_at(grid: MarkerGrid, known_px: Float[ndarray, "rows columns 2"], n_points: int) -> Float[ndarray, "n 2"]:
    """The corners in the board's order, NaN where not known."""
    points = np.full((n_points, 2), np.nan)
    points[grid.points] = known_px
    return points


def steps_at(
    grid: MarkerGrid, known_px: Float[ndarray, "rows columns 2"], lens: FieldLens, n_points: int
) -> tuple[Float[ndarray, "n"], Float[ndarray, "n"]]:
    """A face at each known corner, in the board's order, pixels: its shorter side, and its least height."""
    lines, side = grid.lines, grid.side
    row, column = np.nonzero(np.isfinite(known_px[..., 0]))
    steps = side * predict_steps(lines, known_px, lens, PROBE * side)[row, column]
    across, along = steps[:, 0], steps[:, 1]
    lengths = np.sqrt(np.sum([across**2, along**2], axis=-1))
    spacing, height = np.full(n_points, np.nan), np.full(n_points, np.nan)
    index = grid.points[row, column]
    spacing[index] = lengths.min(axis=0)
    area = np.abs(across[:, 0] * along[:, 1] - across[:, 1] * along[:, 0])
    height[index] = area / np.maximum(lengths.max(axis=0), 1e-9)
    return spacing, height


def expected_at(
    grid: MarkerGrid, known_px: Float[ndarray, "rows columns 2"], lens: FieldLens
) -> Float[ndarray, "rows columns 2"]:
    """Where the crossings should lie."""
    places = np.stack(np.meshgrid(grid.lines.x, grid.lines.y), axis=-1)
    return predict_places(grid.lines, known_px, lens, places)


def count_visible(
    grid: MarkerGrid, known_px: Float[ndarray, "rows columns 2"], lens: FieldLens, size_wh: tuple[int, int]
) -> int:
    """How many crossings should lie inside the image."""
    expected = expected_at(grid, known_px, lens)
    return int(((expected > INSIDE_PX) & (expected < np.array(size_wh) - 1 - INSIDE_PX)).all(axis=-1).sum())


def grow_known(
    grid: MarkerGrid,
    known_px: Float[ndarray, "rows columns 2"],
    lens: FieldLens,
    is_inverted: bool,
    level: tuple[Float32[ndarray, "h w"], float, Float[ndarray, "k 2"]],
) -> Float[ndarray, "rows columns 2"]:
    """The known corners with those that the image has beside them, corner by corner; ``level``: the smoothed image, its scale, its saddles."""
    smooth, scale, peaks = level
    known = to_level(known_px, scale)
    at_scale = lens.scaled(scale, 0.5 * scale - 0.5)
    sign = -grid.sign if is_inverted else grid.sign
    known, is_new = grow_lattice(smooth, grid.lines, sign, grid.free, known, peaks, at_scale, has_dots=grid.has_dots)
    return np.where(is_new[..., None], from_level(known, scale), known_px)


def better_lens(
    grid: MarkerGrid, known_px: Float[ndarray, "rows columns 2"], lens: FieldLens, size_wh: tuple[int, int]
) -> FieldLens | None:
    """The lens through which corners expect each other best, where through this one they do not well; None if no other is better."""

    def off_px(lens: FieldLens) -> float:
        off2 = ((predict_each(grid.lines, known_px, lens) - known_px) ** 2).sum(axis=-1)
        off2 = off2[np.isfinite(off2)]
        return math.sqrt(median_of(off2)) if len(off2) else math.inf

    least = off_px(lens)
    if least < WELL_EXPECTED_PX:
        return None
    best = min((FieldLens.of_field(size_wh, field_rad) for field_rad in FOLLOWED_RAD), key=off_px)
    return best if off_px(best) < least / LEAST_BETTER_EXPECTED else None


def median_of(values: ndarray) -> float:
    """The upper median of some finite numbers; NumPy's takes five times as long for a hundred."""
    middle = values.size // 2
    return float(np.partition(values, middle, axis=None)[middle])


def from_level(points: ndarray, scale: float) -> ndarray:
    """Points of an image at a scale in the image itself."""
    return (points - (0.5 * scale - 0.5)) / scale


def to_level(points: ndarray, scale: float) -> ndarray:
    """Points of an image in the same at a scale."""
    return points * scale + (0.5 * scale - 0.5)
