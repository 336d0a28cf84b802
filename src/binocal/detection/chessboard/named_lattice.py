"""A chessboard's lattice that marks or dots name: how it grows over what else is seen of the board, and how it is measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.detection.finding.crossings import better_lens, from_level, grow_known, points_at, steps_at
from binocal.detection.finding.groups import CornerGroup
from binocal.detection.finding.marker_consistency import find_inconsistent
from binocal.detection.finding.marker_grid import MarkerGrid
from binocal.detection.finding.marker_search import marker_level_settings
from binocal.detection.finding.planes import determine_plane
from binocal.detection.finding.regularity import keep_regular
from binocal.detection.finding.search import LevelSetting
from binocal.detection.finding.xcorners import XCorners
from binocal.detection.found import FoundBoard, not_found
from binocal.detection.measuring.refinement import measure_corners
from binocal.kernels.corner_fits import BoardPlaces
from binocal.kernels.marker_grids import FieldLens
from binocal.shapes import Bool, Float, Float32, Int

MOST_SADDLES_PER_CORNER, LEAST_SADDLES = 5, 1200
LEAST_KEPT = 4  # corners: fewer carry no pose
MAX_MOVE = 0.25  # of the spacing, between where a corner was seen and where it was measured
# Of a corner: at the image's border some are hardly fitted, and off by up to 18 px where squares are large.
MOST_SIGMA_PX = 1.0


@dataclass(slots=True, eq=False)
class NamedLattice:
    """What is known of the board's corners."""

    known_px: Float[ndarray, "rows columns 2"]
    lens: FieldLens
    is_inverted: bool


@dataclass(slots=True)
class Refusal:
    """Why a lattice was not taken for the board; the larger rank says more."""

    rank: int = 0
    text: str = "no chessboard found"

    def consider(self, rank: int, text: str) -> None:
        """Takes the text if it says more than what is there."""
        if rank > self.rank:
            self.rank, self.text = rank, text


def most_saddles(board: Board) -> int:
    """How many saddles of an image are looked at."""
    return max(LEAST_SADDLES, MOST_SADDLES_PER_CORNER * board.n_points)


def level_settings(halvings: int) -> list[LevelSetting]:
    """The searches of an image that can be halved so often: those for markers, then smoother ones for blurred boards."""
    return [*marker_level_settings(halvings), *(LevelSetting(n, 1.5, 5.0) for n in (0, 2) if n <= halvings)]


def lay_out(
    group: CornerGroup, corners: XCorners, scale: float
) -> tuple[Int[ndarray, "m 2"], Float[ndarray, "rows columns 2"]]:
    """A group's cells (column, row) from 0 on, and its corners in the image on a grid, NaN where it has none."""
    cells = group.cells - group.cells.min(axis=0)
    columns, rows = cells.max(axis=0) + 1
    grid_px = np.full((rows, columns, 2), np.nan)
    grid_px[cells[:, 1], cells[:, 0]] = from_level(corners.points_px[group.members], scale)
    return cells, grid_px


def is_bright_first(group: CornerGroup, cells: Int[ndarray, "m 2"]) -> bool:
    """Whether the square beyond the lattice's corner (0, 0), between its rows and columns, is bright."""
    return bool(group.turns[0] % 2 == 0) ^ bool(cells[0].sum() % 2)


def grow(
    lattice: NamedLattice,
    grid: MarkerGrid,
    board: Board,
    level: tuple[Float32[ndarray, "h w"], float, Float[ndarray, "k 2"]],
    size_wh: tuple[int, int],
) -> None:
    """Over what the image at this scale has of the board, through the lens that suits it best; ``level`` as of ``grow_known``."""
    before = lattice.known_px
    lattice.lens = better_lens(grid, before, lattice.lens, size_wh) or lattice.lens
    known = grow_known(grid, before, lattice.lens, lattice.is_inverted, level)
    if (lens := better_lens(grid, known, lattice.lens, size_wh)) is not None:
        lattice.lens = lens  # through a wrong one other saddles than the board's may have been taken
        known = grow_known(grid, before, lens, lattice.is_inverted, level)
    lattice.known_px = np.where(board.is_printed.reshape(known.shape[:2])[..., None], known, np.nan)


def measure(
    grey: ndarray,
    board: Board,
    grid: MarkerGrid,
    lattice: NamedLattice,
    relative_reach: float | Float[ndarray, "n"],
    *,
    which: str = "corners",
    find_misnamed: Callable[[Float[ndarray, "n 2"]], Bool[ndarray, "n"]] | None = None,
) -> FoundBoard:
    """The board's corners where the fit, the lattice and the lens agree.

    ``relative_reach`` is how far about a corner nothing but its squares is printed, in squares; ``find_misnamed`` says of measured
    corners (pixels, NaN without) which have another name; ``which`` is what a refusal calls them.
    """
    rough = points_at(grid, lattice.known_px, board.n_points)
    spacing, height = steps_at(grid, lattice.known_px, lattice.lens, board.n_points)
    places = BoardPlaces(board.object_points_m[:, :2], board.pitch_m)
    points, covariance, cross = measure_corners(grey, rough, places, relative_reach * height, may_be_cut=True)
    points = points.copy()
    sigma = np.sqrt(0.5 * np.trace(covariance, axis1=1, axis2=2))
    points[(np.linalg.norm(points - rough, axis=1) > MAX_MOVE * spacing) | (sigma > MOST_SIGMA_PX)] = np.nan
    points[find_inconsistent(grid, lattice.lens, points, covariance, spacing)] = np.nan
    if find_misnamed is not None:
        points[find_misnamed(points)] = np.nan
    seen = np.isfinite(points[:, 0])
    if seen.sum() >= LEAST_KEPT:
        points = keep_regular(board.object_points_m[:, :2], points, spacing, (grey.shape[1], grey.shape[0]))
        seen = np.isfinite(points[:, 0])
    if seen.sum() < LEAST_KEPT or not determine_plane(board.object_points_m[seen, :2]):
        return not_found(board.n_points, f"only {seen.sum()} {which} could be measured; too blurred or covered?")
    covariance, cross = (np.where(seen[:, None, None], of_all, np.nan) for of_all in (covariance, cross))
    n_printed = int(board.is_printed.sum())
    note = "" if seen.sum() == n_printed else f"{seen.sum()} of {n_printed} corners seen"
    return FoundBoard(points, covariance, note=note, cross_covariance_px2=cross)
