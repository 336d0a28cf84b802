"""What the compiled functions on lattices of plain points and on components compute, plainly in NumPy."""

from __future__ import annotations

import cv2
import numpy as np

MAX_STEP_ERROR, SURE_STEP_ERROR, MAX_RADIUS_RATIO = 0.28, 0.12, 1.9
ALONG = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])


def find_components(image, around, below_dn, least_area_px, most_side_px):
    """Rows of area, width, height, mean, second moments, and whether the mean's pixel is one of the component."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(
        (image.astype(int) + below_dn < around).astype(np.uint8), connectivity=4
    )
    records = []
    for label, (left, top, width, height, area) in enumerate(stats):
        touches = left == 0 or top == 0 or left + width == image.shape[1] or top + height == image.shape[0]
        if label == 0 or area < least_area_px or max(width, height) >= most_side_px or touches:
            continue
        y, x = np.nonzero(labels == label)
        spread = np.cov(x, y, bias=True)
        is_held = labels[int(np.rint(y.mean())), int(np.rint(x.mean()))] == label
        records.append([area, width, height, x.mean(), y.mean(), spread[0, 0], spread[1, 1], spread[0, 1], is_held])
    return np.array(records, dtype=float).reshape(-1, 9)


def find_nearest(points, k):
    """Neighbours, distances, and how unlike each step is to the most opposite one."""
    squared = ((points[:, None] - points) ** 2).sum(axis=-1)
    np.fill_diagonal(squared, np.inf)
    near = np.argsort(squared, axis=1, kind="stable")[:, :k]
    distance = np.sqrt(np.take_along_axis(squared, near, axis=1))
    ways = points[near] - points[:, None]
    return near, distance, np.linalg.norm(ways[:, :, None] + ways[:, None], axis=-1).min(axis=2) / distance


def grow_lattice(points, radii, free, seed, basis):
    """The lattice reached from a seed, one ring of cells a round, each from all that is known about it."""
    index = np.flatnonzero(free)
    x, y, sizes = points[index, 0], points[index, 1], np.log(radii[index])
    is_left = index != seed
    canvas = Canvas(points, np.log(radii), seed)
    while is_left.any():
        # the seed's own steps hold about the seed alone
        cells, expected, step, size = canvas.expect(basis if canvas.n == 1 else None)
        squared = (expected[:, 0, None] - x) ** 2 + (expected[:, 1, None] - y) ** 2
        squared[:, ~is_left] = np.inf
        best = squared.argmin(axis=1)
        off = np.sqrt(np.nan_to_num(squared[np.arange(len(best)), best], nan=np.inf)) / step
        is_good = (off < MAX_STEP_ERROR) & (np.abs(sizes[best] - size) < np.log(MAX_RADIUS_RATIO))
        if not is_good.any():
            break
        if (is_good & (off < SURE_STEP_ERROR)).any():
            is_good &= off < SURE_STEP_ERROR
        good = np.flatnonzero(is_good)
        for k in good[np.argsort(off[good], kind="stable")]:
            if is_left[best[k]]:
                canvas.put(cells[k], int(index[best[k]]))
                is_left[best[k]] = False
    return canvas.lattice()


class Canvas:
    """Cells about a seed with room beyond them: indices of their points, -1 where none, the points, and their sizes' logarithms."""

    _APRON = 4

    def __init__(self, points, sizes, seed):
        self._all_points, self._all_sizes = points, sizes
        self._place = np.full((64, 64), -1)
        self._points = np.full((64, 64, 2), np.nan)
        self._sizes = np.full((64, 64), np.nan)
        self._origin = np.array([32, 32])
        self._low, self._high = self._origin.copy(), self._origin.copy()
        self.n = 0
        self.put(self._origin, seed)

    def put(self, cell, index):
        """A point into a cell (row and column of the canvas)."""
        at = cell[0], cell[1]
        self._place[at], self._points[at], self._sizes[at] = index, self._all_points[index], self._all_sizes[index]
        self._low, self._high = np.minimum(self._low, cell), np.maximum(self._high, cell)
        self.n += 1

    def lattice(self):
        """What the canvas holds, in cells from the seed."""
        cells = np.argwhere(self._place >= 0)
        return self._place[tuple(cells.T)], cells - self._origin

    def expect(self, basis):
        """Empty cells beside taken ones, where their points should be (infinite: unknown), and the steps and sizes there."""
        if min(self._low) < self._APRON or max(self._high) >= len(self._place) - self._APRON:
            self._widen()
        (top, left), (bottom, right) = self._low - 2, self._high + 3
        is_taken = self._place[top:bottom, left:right] >= 0
        beside = is_taken[2:, 1:-1] | is_taken[:-2, 1:-1] | is_taken[1:-1, 2:] | is_taken[1:-1, :-2]
        cells = np.argwhere(beside & ~is_taken[1:-1, 1:-1]) + self._low - 1
        expected, weight, step, size = from_each_side(self._points, self._sizes, cells, basis)
        is_known = np.isfinite(expected[..., 0])
        weight = np.where(is_known, weight, 0.0)
        total, n_sides = weight.sum(axis=0), np.maximum(is_known.sum(axis=0), 1)
        expected = (weight[..., None] * np.where(is_known[..., None], expected, 0.0)).sum(axis=0)
        expected = np.where(total[:, None] > 0, expected / np.maximum(total, 1e-12)[:, None], np.inf)
        step, size = (np.where(is_known, values, 0.0).sum(axis=0) / n_sides for values in (step, size))
        return cells, expected, np.maximum(step, 1e-9), size

    def _widen(self):
        room = len(self._place) // 2
        self._place = np.pad(self._place, room, constant_values=-1)
        self._sizes = np.pad(self._sizes, room, constant_values=np.nan)
        self._points = np.pad(self._points, ((room, room), (room, room), (0, 0)), constant_values=np.nan)
        self._origin, self._low, self._high = self._origin + room, self._low + room, self._high + room


def from_each_side(wide, size_map, at, basis):
    """Where a cell's point should be by its neighbour on each side, with a weight, the step that leads there, and the size.

    NaN where its steps are not known. The step is the one before, changed as the steps change along the line, else as
    beside it, else the basis's.
    """

    def look(i, j=0):
        place = at - i * ALONG[:, None] + j * np.abs(ALONG[:, None, ::-1])
        return wide[place[..., 0], place[..., 1]]

    first, second = look(1), look(2)
    behind = first - second
    if basis is None:
        step = np.full(first.shape, np.nan)
    else:
        step = np.tile(np.array([basis[0], -basis[0], basis[1], -basis[1]])[:, None], (1, len(at), 1))
    weight = np.full(first.shape[:2], 1e-3)
    better = [(behind, 1.0), (2 * behind - (second - look(3)), 2.0)]
    for side in (1, -1):  # the same step in the lines beside it
        here = look(1, side)
        beside = look(0, side) - here
        better += [(beside, 1.0), (behind + (beside - (here - look(2, side))), 3.0)]
    for other, worth in better:
        is_known = np.isfinite(other[..., 0]) & (weight < worth)
        step[is_known], weight[is_known] = other[is_known], worth
    before = at - ALONG[:, None]
    return first + step, weight, np.hypot(step[..., 0], step[..., 1]), size_map[before[..., 0], before[..., 1]]
