"""The printed board through a Gaussian of ``spread_px``: band-limited, so that it can be sampled.

Inputs are board coordinates in pitches and their derivatives by the pixel coordinates. An edge of the print is
straight within the Gaussian, which is then exact: the normal distribution of the distance in pixels. Reflectance is
1 on white paper, 0 on ink and off the sheet; coverage is 1 on the sheet, 0 off it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.shapes import Float, Int
from binocal.simulation.layout import CellPrint, DiscPrint, cell_print, disc_print, printed_extent_m, sheet_margin


@dataclass(frozen=True, slots=True, eq=False)
class Footprint:
    """Where points of the image lie on the board: x, y (pitches), derivatives by u, v; they broadcast."""

    x: ndarray
    y: ndarray
    x_u: ndarray
    x_v: ndarray
    y_u: ndarray
    y_v: ndarray


@runtime_checkable
class Sheet(Protocol):
    """A printed sheet of paper."""

    def classify(self, at: Footprint, reach_x: ndarray, reach_y: ndarray) -> tuple[ndarray, ndarray, ndarray]:
        """Reflectance and coverage at the points, and whether both are constant within the reach (pitches)."""
        ...

    def spread(self, at: Footprint, spread_px: float) -> tuple[ndarray, ndarray]:
        """Reflectance and coverage through a Gaussian with that standard deviation."""
        ...


def sheet_of(board: Board, *, is_legacy_charuco: bool = False, april_border_bits: int = 2) -> Sheet:
    """The board's print on its sheet of white paper."""
    if board.kind in ("circles", "acircles"):
        return DiscSheet(disc_print(board), board)
    cells = cell_print(board, is_legacy_charuco=is_legacy_charuco, april_border_bits=april_border_bits)
    sheet = CellSheet(cells, sheet_margin(board))
    if board.kind == "puzzleboard":
        return DottedSheet(sheet, cells.discs)
    return MarkedSheet(sheet, cells.discs) if len(cells.discs) else sheet


class CellSheet:
    """Black and white cells of a rectilinear grid."""

    def __init__(self, cells: CellPrint, margin: float) -> None:
        self._x = _Axis(np.r_[cells.x_edges[0] - margin, cells.x_edges, cells.x_edges[-1] + margin])
        self._y = _Axis(np.r_[cells.y_edges[0] - margin, cells.y_edges, cells.y_edges[-1] + margin])
        paper = np.pad(1 - cells.ink, 1, constant_values=1)
        self._reflectance = np.pad(paper, 1).astype(np.float32)
        self._coverage = np.pad(np.ones_like(paper), 1).astype(np.float32)
        self._stride = self._reflectance.shape[1]

    def classify(self, at: Footprint, reach_x: ndarray, reach_y: ndarray) -> tuple[ndarray, ndarray, ndarray]:
        """See :class:`Sheet`."""
        x0, x1 = self._x.index(at.x - reach_x), self._x.index(at.x + reach_x)
        y0, y1 = self._y.index(at.y - reach_y) * self._stride, self._y.index(at.y + reach_y) * self._stride
        # paper differs from ink and from no sheet, which never touch: equal at the four ends means one surface
        reflectance = self._reflectance.ravel()
        value = reflectance[y0 + x0]
        is_constant = (
            (value == reflectance[y0 + x1]) & (value == reflectance[y1 + x0]) & (value == reflectance[y1 + x1])
        )
        is_constant &= (x1 - x0 <= 1) & (y1 - y0 <= self._stride)
        return value, self._coverage.ravel()[y0 + x0], is_constant

    def spread(self, at: Footprint, spread_px: float) -> tuple[ndarray, ndarray]:
        """See :class:`Sheet`. Looks at the nearest edge of each direction.

        Exact to 1e-4 where cells are at least 8 spreads wide.
        Where two edges cross, their distances are jointly normal; the joint distribution is the tetrachoric series
        to third order in the correlation. Source: Pearson 1900, "On the correlation of characters not
        quantitatively measurable".
        """
        from scipy.special import ndtr

        scale_x, scale_y = np.hypot(at.x_u, at.x_v), np.hypot(at.y_u, at.y_v)
        x0, a = self._x.nearest_edge(at.x, spread_px * scale_x)
        y0, b = self._y.nearest_edge(at.y, spread_px * scale_y)
        s, t = ndtr(a), ndtr(b)
        w11 = s * t
        is_crossing = a * a + b * b < 32  # elsewhere the joint term is below 2e-8
        correlation = ((at.x_u * at.y_u + at.x_v * at.y_v) / (scale_x * scale_y)).astype(np.float32)
        w11[is_crossing] += _joint_minus_product(
            a[is_crossing], b[is_crossing], np.broadcast_to(correlation, a.shape)[is_crossing]
        )
        weights = 1 - s - t + w11, s - w11, t - w11, w11
        place = y0 * self._stride + x0
        places = place, place + 1, place + self._stride, place + self._stride + 1
        reflectance = _blend(self._reflectance, places, weights)
        coverage = np.ones_like(reflectance)
        is_rim = (x0 == 0) | (y0 == 0) | (x0 == self._stride - 2) | (y0 == len(self._coverage) - 2)
        if is_rim.any():
            coverage[is_rim] = _blend(self._coverage, [p[is_rim] for p in places], [w[is_rim] for w in weights])
        return reflectance, coverage


class DiscSheet:
    """Black discs on a white sheet."""

    def __init__(self, discs: DiscPrint, board: Board) -> None:
        x0, y0, x1, y1 = np.array(printed_extent_m(board)) / board.pitch_m
        self._discs = discs
        self._paper = CellSheet(
            CellPrint(np.array([x0, x1]), np.array([y0, y1]), np.zeros((1, 1), dtype=int)), sheet_margin(board)
        )

    def _from_nearest(self, at: Footprint) -> tuple[ndarray, ndarray, ndarray, ndarray, ndarray]:
        """Offset x, y from the nearest disc's centre, the distance, and the disc's own radius and its hole's."""
        d = self._discs
        row = np.clip(np.rint(at.y), 0, d.rows - 1)
        start = d.stagger * (row % 2)
        column = np.clip(np.rint((at.x - start) / d.step_x), 0, d.columns - 1)
        x, y = at.x - start - d.step_x * column, at.y - row
        place = row.astype(int), column.astype(int)
        return x, y, np.hypot(x, y), d.outer[place], d.hole[place]

    def classify(self, at: Footprint, reach_x: ndarray, reach_y: ndarray) -> tuple[ndarray, ndarray, ndarray]:
        """See :class:`Sheet`."""
        paper, coverage, is_constant = self._paper.classify(at, reach_x, reach_y)
        _, _, r, outer, hole = self._from_nearest(at)
        reach = np.hypot(reach_x, reach_y)
        is_constant &= (np.abs(r - outer) > reach) & ((np.abs(r - hole) > reach) | (hole == 0))
        return paper * ((r > outer) | (r < hole)), coverage, is_constant

    def spread(self, at: Footprint, spread_px: float) -> tuple[ndarray, ndarray]:
        """See :class:`Sheet`. Takes a rim as straight: right to spread_px² / (2 radius), alike all round."""
        from scipy.special import ndtr

        paper, coverage = self._paper.spread(at, spread_px)
        x, y, r, outer, hole = self._from_nearest(at)
        slope = np.hypot(x * at.x_u + y * at.y_u, x * at.x_v + y * at.y_v) / np.maximum(r, 1e-9)
        spread = spread_px * np.maximum(slope, 1e-12)
        bright = ndtr((r - outer) / spread)
        bright += np.where(hole > 0, ndtr((hole - r) / spread), 0.0)
        return paper * bright, coverage


class MarkedSheet:
    """Cells, some with a disc of the other colour."""

    def __init__(self, cells: CellSheet, discs: Float[ndarray, "k 4"]) -> None:
        self._cells, self._discs = cells, discs

    def classify(self, at: Footprint, reach_x: ndarray, reach_y: ndarray) -> tuple[ndarray, ndarray, ndarray]:
        """See :class:`Sheet`."""
        reflectance, coverage, is_constant = self._cells.classify(at, reach_x, reach_y)
        reach = np.hypot(reach_x, reach_y)
        for x, y, radius, ink in self._discs:
            beyond = np.hypot(at.x - x, at.y - y) - radius
            is_constant &= np.abs(beyond) > reach
            reflectance = np.where(beyond < 0, np.float32(1 - ink), reflectance)
        return reflectance, coverage, is_constant

    def spread(self, at: Footprint, spread_px: float) -> tuple[ndarray, ndarray]:
        """See :class:`Sheet`. Takes a disc's rim as straight: right to spread_px² / (2 radius), alike all round."""
        from scipy.special import ndtr

        reflectance, coverage = self._cells.spread(at, spread_px)
        for centre_x, centre_y, radius, ink in self._discs:
            x, y = at.x - centre_x, at.y - centre_y
            r = np.hypot(x, y)
            near = r < 3 * radius
            if near.any():
                slope = np.hypot(x * at.x_u + y * at.y_u, x * at.x_v + y * at.y_v) / np.maximum(r, 1e-9)
                inside = np.where(near, ndtr((radius - r) / (spread_px * np.maximum(slope, 1e-12))), 0.0)
                reflectance = reflectance + inside.astype(np.float32) * (np.float32(1 - ink) - reflectance)
        return reflectance, coverage


class DottedSheet:
    """Cells of a chessboard with a dot in the middle of each edge between two corners.

    Their middles make a lattice turned by 45 degrees, so that the nearest dot is looked up, however many there are.
    """

    def __init__(self, cells: CellSheet, discs: Float[ndarray, "k 4"]) -> None:
        self._cells = cells
        self._low = self._turned(discs[:, 0], discs[:, 1]).min(axis=1)
        column, row = self._turned(discs[:, 0], discs[:, 1]) - self._low[:, None]
        self._radius = np.full((column.max() + 1, row.max() + 1), -np.inf, np.float32)
        self._paper = np.zeros(self._radius.shape, np.float32)
        self._radius[column, row] = discs[:, 2]
        self._paper[column, row] = 1 - discs[:, 3]

    @staticmethod
    def _turned(x: ndarray, y: ndarray) -> Int[ndarray, "2 *n"]:
        """The place of the nearest dot in the turned lattice."""
        return np.rint(np.stack([x + y - 0.5, x - y - 0.5])).astype(int)

    def _nearest(self, at: Footprint) -> tuple[ndarray, ndarray, ndarray, ndarray, ndarray]:
        """Offset x, y from the nearest dot's middle, the distance, the dot's radius (below 0: there is none), and 1 where it is white."""
        place = self._turned(at.x, at.y)
        a, b = place + 0.5
        x, y = at.x - 0.5 * (a + b), at.y - 0.5 * (a - b)
        limits = np.array(self._radius.shape)[(...,) + (None,) * at.x.ndim]
        index = place - self._low[(...,) + (None,) * at.x.ndim]
        inside = ((index >= 0) & (index < limits)).all(axis=0)
        i, j = np.where(inside, index, 0)
        return x, y, np.hypot(x, y), np.where(inside, self._radius[i, j], -np.inf), self._paper[i, j]

    def classify(self, at: Footprint, reach_x: ndarray, reach_y: ndarray) -> tuple[ndarray, ndarray, ndarray]:
        """See :class:`Sheet`."""
        reflectance, coverage, is_constant = self._cells.classify(at, reach_x, reach_y)
        _, _, r, radius, paper = self._nearest(at)
        is_inside = r < radius
        is_constant = is_constant | is_inside  # a dot hides the edge beneath it
        is_constant &= np.abs(r - radius) > np.hypot(reach_x, reach_y)
        return np.where(is_inside, paper, reflectance), coverage, is_constant

    def spread(self, at: Footprint, spread_px: float) -> tuple[ndarray, ndarray]:
        """See :class:`Sheet`. Takes a dot's rim as straight: right to spread_px² / (2 radius), alike all round."""
        from scipy.special import ndtr

        reflectance, coverage = self._cells.spread(at, spread_px)
        x, y, r, radius, paper = self._nearest(at)
        slope = np.hypot(x * at.x_u + y * at.y_u, x * at.x_v + y * at.y_v) / np.maximum(r, 1e-9)
        inside = ndtr((radius - r) / (spread_px * np.maximum(slope, 1e-12))).astype(np.float32)
        return reflectance + inside * (paper - reflectance), coverage


def _joint_minus_product(a: ndarray, b: ndarray, correlation: ndarray) -> ndarray:
    """P(A < a, B < b) - P(A < a) P(B < b) of two standard normal variables."""
    series = correlation * (1 + correlation / 2 * (a * b + correlation / 3 * (a * a - 1) * (b * b - 1)))
    return series * np.exp(-0.5 * (a * a + b * b)) / np.float32(2 * np.pi)


def _blend(values: ndarray, places: Sequence[ndarray], weights: Sequence[ndarray]) -> ndarray:
    """Weighted sum of the table's values at flat places."""
    flat = values.ravel()
    out = weights[0] * flat[places[0]]
    for weight, place in zip(weights[1:], places[1:], strict=True):
        out += weight * flat[place]
    return out


class _Axis:
    """The sorted edges of a sheet along one direction: the first and the last are the sheet's own."""

    def __init__(self, edges: Float[ndarray, "k"]) -> None:
        self._edges = edges
        self._intervals = _SortedTable(edges)
        self._midpoints = _SortedTable((edges[1:] + edges[:-1]) / 2)

    def index(self, x: ndarray) -> Int[ndarray, "..."]:
        """Interval of x: 0 before the first edge, k after the last."""
        return self._intervals.count_at_or_below(x)

    def nearest_edge(self, x: ndarray, scale: ndarray) -> tuple[Int[ndarray, "..."], Float[ndarray, "..."]]:
        """Index of the nearest edge, and the signed distance beyond it in units of ``scale`` (float32)."""
        edge = self._midpoints.count_at_or_below(x)
        return edge, ((x - self._edges[edge]) / scale).astype(np.float32)


class _SortedTable:
    """``searchsorted`` by table, several times faster: equal bins, none wide enough to hold two values."""

    def __init__(self, values: Float[ndarray, "k"]) -> None:
        self._values = np.r_[values, np.inf]
        step = 0.999 * float(np.diff(values).min()) if len(values) > 1 else 1.0
        self._origin, self._per_step = float(values[0]) - step, 1 / step
        n_bins = int(np.ceil((values[-1] - self._origin) / step)) + 2
        self._first = np.searchsorted(values, self._origin + step * np.arange(n_bins), side="right")
        self._first[0] = 0

    def count_at_or_below(self, x: ndarray) -> Int[ndarray, "..."]:
        """How many values are at or below x."""
        bins = (x - self._origin) * self._per_step
        bins = np.minimum(np.maximum(bins, 0), len(self._first) - 1).astype(np.intp)
        first = self._first[bins]
        return first + (x >= self._values[first])
