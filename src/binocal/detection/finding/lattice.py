"""Lattices: groups of linked X-corners as grids of rows and columns, completed and bounded by their edges.

Nothing here knows the board: every chessboard pattern in the image comes out with its own number of columns and rows,
by which a wrong SPEC, a second board or a half-hidden one is recognised.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.detection.finding.completion import border_shares, extend_to, fill_holes, trim_borders
from binocal.detection.finding.grid import add_line, border_line, is_before
from binocal.detection.finding.groups import CornerGroup, join_across_gaps
from binocal.detection.finding.xcorners import SaddleImage, XCorners
from binocal.shapes import Float

MIN_CORNERS = 9  # of a lattice: three lines of three; the clutter makes smaller ones by the dozen
MAX_CELLS_PER_CORNER, MAX_CELLS_MORE = 4, 16  # of the outline: what is emptier is a chain of links and no grid
# Margins that are thinner than the blur let some outer corners of a board look like X-corners: with shares of 0.9, or
# contrasts of 0.5 or 1.6 of the lattice's own, on real boards.
CONTRASTS_BEYOND = (0.65, 1.5)
MAX_OFF_BEYOND = 0.3  # of the step, between where the next line's corners should be and the X-corners seen


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """A grid of corners: ``points_px[row, column]``, NaN where none was seen.

    Columns x rows turns as x towards y in the image.
    ``is_dark_first`` says that the square beyond corner (0, 0), outwards, is dark.
    """

    points_px: Float[ndarray, "rows columns 2"]
    is_dark_first: bool
    contrast_dn: float
    """Bright minus dark at a typical corner, of 255."""

    @property
    def n_seen(self) -> int:
        """Number of corners seen."""
        return int(np.isfinite(self.points_px[..., 0]).sum())

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows, the larger first."""
        rows, columns = self.points_px.shape[:2]
        return max(rows, columns), min(rows, columns)


def find_lattices(
    saddles: SaddleImage,
    corners: XCorners,
    groups: list[CornerGroup],
    *,
    least: int = MIN_CORNERS,
    size: tuple[int, int] | None = None,
) -> list[Lattice]:
    """The lattices of at least ``least`` corners, the largest first.

    With a ``size`` (corners along the longer and the shorter side) weak border rows are looked for until it is reached.
    """
    lattices = []
    joined = np.zeros(len(corners), bool)
    for group in groups:
        if len(group) < least or 2 * joined[group.members].sum() > len(group):
            continue
        is_whole = group.is_whole(size)
        members, cells, turns = group.members, group.cells, group.turns
        if not is_whole:
            members, cells = join_across_gaps(corners, group)
        joined[members] = True
        low = cells.min(axis=0)
        columns, rows = cells.max(axis=0) - low + 1
        if min(columns, rows) < 2 or columns * rows > MAX_CELLS_PER_CORNER * len(members) + MAX_CELLS_MORE:
            continue
        grid = np.full((rows, columns, 3), np.nan)
        grid[cells[:, 1] - low[1], cells[:, 0] - low[0], :2] = corners.points_px[members]
        grid[cells[:, 1] - low[1], cells[:, 0] - low[0], 2] = corners.contrast_dn[members]
        # Ray 0 has its bright sector after it: with turn 0 the sector between steps +x and +y is bright, so is the one
        # opposite.
        column, row = cells[0] - low
        is_bright_first = bool(turns[0] % 2 == 0) ^ bool((column + row) % 2)
        if is_whole:
            lattices.append(Lattice(grid[..., :2], not is_bright_first, float(np.median(grid[..., 2]))))
            continue
        grid = fill_holes(saddles, grid, is_bright_first)
        grid, is_bright_first = trim_borders(saddles.smooth, grid, is_bright_first)
        if size is not None and 2 * len(members) > size[0] * size[1]:
            grid, is_bright_first = extend_to(saddles, grid, is_bright_first, size)
        lattices.append(Lattice(grid[..., :2], not is_bright_first, float(np.nanmedian(grid[..., 2]))))
    return sorted((lattice for lattice in lattices if lattice.n_seen >= least), key=lambda lattice: -lattice.n_seen)


def continues_beyond(saddles: SaddleImage, corners: XCorners, lattice: Lattice) -> bool:
    """Whether the lattice goes on beyond one of its borders: the printed board is larger than the lattice.

    A row counts where every corner and every edge of it is seen, with the lattice's own contrast.
    """
    contrast = np.where(np.isfinite(lattice.points_px[..., :1]), lattice.contrast_dn, np.nan)
    grid = np.concatenate([lattice.points_px, contrast], axis=-1)
    for side in _sides_to_try(corners, lattice.points_px):
        is_bright = (not lattice.is_dark_first) ^ is_before(side)
        trial = fill_holes(saddles, add_line(grid, side), is_bright, least=1)
        ratio = trial[border_line(side)][:, 2] / lattice.contrast_dn
        low, high = CONTRASTS_BEYOND
        is_alike = bool(np.all((ratio > low) & (ratio < high)))  # False where a corner is missing
        if is_alike and border_shares(saddles.smooth, trial, is_bright)[side] == 1:
            return True
    return False


def _sides_to_try(corners: XCorners, grid: Float[ndarray, "rows columns 2"]) -> list[int]:
    """The sides (top, bottom, left, right) beyond which half of the next row's corners are among the ``corners``."""
    if len(corners) == 0:
        return []
    lines = ((grid[0], grid[1]), (grid[-1], grid[-2]), (grid[:, 0], grid[:, 1]), (grid[:, -1], grid[:, -2]))
    near, far = (np.concatenate(points) for points in zip(*lines, strict=True))
    step = near - far
    x, y = (near + step).T
    off2 = ((x[:, None] - corners.points_px[:, 0]) ** 2 + (y[:, None] - corners.points_px[:, 1]) ** 2).min(axis=1)
    length2 = step[:, 0] ** 2 + step[:, 1] ** 2
    votes = np.where(np.isfinite(length2), np.where(off2 < MAX_OFF_BEYOND**2 * length2, 1, -1), 0)
    ends = np.cumsum([len(points) for points, _ in lines])
    return [side for side, of_line in enumerate(np.split(votes, ends[:-1])) if of_line.sum() >= 0]
