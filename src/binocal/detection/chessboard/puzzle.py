"""PuzzleBoards: any part of one is found, and named by the dots on its edges.

The lattice of X-corners comes first, whatever its size; the dots on the edges between its corners say which part of the board it
is; from there it grows over what else is seen of the board.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.boards.puzzle_code import DOT_RADIUS
from binocal.detection.finding.crossings import (
    better_lens,
    count_visible,
    from_level,
    grow_known,
    points_at,
    steps_at,
)
from binocal.detection.finding.edge_bits import agreement_at, locate, read_edges
from binocal.detection.finding.groups import CornerGroup, link_corners
from binocal.detection.finding.lattice import MIN_CORNERS
from binocal.detection.finding.marker_consistency import find_inconsistent
from binocal.detection.finding.marker_grid import MarkerGrid, puzzle_grid
from binocal.detection.finding.marker_search import ENOUGH_SHARE, marker_level_settings
from binocal.detection.finding.planes import determine_plane
from binocal.detection.finding.regularity import keep_regular
from binocal.detection.finding.search import LevelSetting, scaled_saddles
from binocal.detection.finding.xcorners import SaddleImage, XCorners, find_saddles
from binocal.detection.found import FoundBoard, not_found
from binocal.detection.measuring.refinement import measure_corners
from binocal.kernels.corner_fits import BoardPlaces
from binocal.kernels.marker_grids import FieldLens
from binocal.shapes import Bool, Float, Float32, UInt8

MOST_SADDLES_PER_CORNER, LEAST_SADDLES = 5, 1200
MOST_GROUPS = 8  # of linked corners, that are looked at
LEAST_KEPT = 4  # corners: fewer carry no pose
MAX_MOVE = 0.25  # of the spacing, between where a corner was seen and where it was measured
MOST_SIGMA_PX = 1.0  # of a corner: at the image's border some are hardly fitted
REACH = 0.5 - DOT_RADIUS  # squares, from a corner to the nearest dot's rim
LEAST_AGREEMENT, AGREEMENT_REACH = (
    0.4,
    2,
)  # of the dots within so many corners of one with the code, for it to keep its name


@dataclass(slots=True, eq=False)
class _Sighting:
    """What is known of the board's corners."""

    known_px: Float[ndarray, "rows columns 2"]
    lens: FieldLens
    is_inverted: bool


@dataclass(slots=True)
class _Refusal:
    """Why a lattice was not taken for the board; the larger rank says more."""

    rank: int = 0
    text: str = "no chessboard found"

    def consider(self, rank: int, text: str) -> None:
        if rank > self.rank:
            self.rank, self.text = rank, text


def detect_puzzleboard(grey: ndarray, image: UInt8[ndarray, "h w"], board: Board) -> FoundBoard:
    """The inner corners of a PuzzleBoard, partly visible or not; ``image`` is ``grey`` stretched to 8 bits.

    Where the dots leave open which part of the board is seen, nothing is found.
    """
    grid = puzzle_grid(board)
    size_wh = image.shape[1], image.shape[0]
    most = max(LEAST_SADDLES, MOST_SADDLES_PER_CORNER * board.n_points)
    sighting: _Sighting | None = None
    refusal = _Refusal()
    for saddles, scale in scaled_saddles(image, _level_settings):
        corners, peaks = find_saddles(saddles, most=most)
        sighting = _recognise(image, board, saddles, corners, scale, refusal, sighting)
        if sighting is None:
            continue
        _grow(sighting, grid, (saddles.smooth, scale, peaks), size_wh)
        n_known = int(np.isfinite(sighting.known_px[..., 0]).sum())
        if n_known >= ENOUGH_SHARE * count_visible(grid, sighting.known_px, sighting.lens, size_wh):
            break
    return not_found(board.n_points, refusal.text) if sighting is None else _measure(grey, image, board, grid, sighting)


def _level_settings(halvings: int) -> list[LevelSetting]:
    """The searches of an image that can be halved so often: those for markers, then smoother ones for blurred boards."""
    return [*marker_level_settings(halvings), *(LevelSetting(n, 1.5, 5.0) for n in (0, 2) if n <= halvings)]


def _recognise(
    image: UInt8[ndarray, "h w"],
    board: Board,
    saddles: SaddleImage,
    corners: XCorners,
    scale: float,
    refusal: _Refusal,
    sighting: _Sighting | None,
) -> _Sighting | None:
    """What is known already with the groups of linked corners whose dots name them; the first group that does counts before others."""
    for group in link_corners(saddles, corners, has_dots=True)[:MOST_GROUPS]:
        if len(group) < MIN_CORNERS:
            break
        cells = group.cells - group.cells.min(axis=0)
        columns, rows = cells.max(axis=0) + 1
        if min(columns, rows) < 2:
            continue
        grid_px = np.full((rows, columns, 2), np.nan)
        grid_px[cells[:, 1], cells[:, 0]] = from_level(corners.points_px[group.members], scale)
        is_bright_first = _is_bright_first(group, cells)
        readings = read_edges(image, grid_px, FieldLens(), is_bright_first=is_bright_first)
        decoding = locate(board, cells, readings, is_bright_first=is_bright_first)
        if decoding.place is None:
            refusal.consider(decoding.rank, f"a lattice of {columns}x{rows} corners {decoding.reason}")
            continue
        places = decoding.place.corners(cells) - np.array(board.start)
        inside = ((places >= 0) & (places < [board.columns, board.rows])).all(axis=1)
        known = np.full((board.rows, board.columns, 2), np.nan)
        known[places[inside, 1], places[inside, 0]] = grid_px[cells[inside, 1], cells[inside, 0]]
        if sighting is None:
            sighting = _Sighting(known, FieldLens(), decoding.place.is_inverted)
        elif sighting.is_inverted == decoding.place.is_inverted:
            is_new = np.isnan(sighting.known_px[..., :1])
            sighting.known_px = np.where(is_new, known, sighting.known_px)
    return sighting


def _is_bright_first(group: CornerGroup, cells: ndarray) -> bool:
    """Whether the square beyond the lattice's corner (0, 0), between its rows and columns, is bright."""
    return bool(group.turns[0] % 2 == 0) ^ bool(cells[0].sum() % 2)


def _grow(
    sighting: _Sighting,
    grid: MarkerGrid,
    level: tuple[Float32[ndarray, "h w"], float, Float[ndarray, "k 2"]],
    size_wh: tuple[int, int],
) -> None:
    """Over what the image at this scale has of the board, through the lens that suits it best."""
    before = sighting.known_px
    sighting.lens = better_lens(grid, before, sighting.lens, size_wh) or sighting.lens
    known = grow_known(grid, before, sighting.lens, sighting.is_inverted, level)
    if (lens := better_lens(grid, known, sighting.lens, size_wh)) is not None:
        sighting.lens = lens  # through a wrong one other saddles than the board's may have been taken
        known = grow_known(grid, before, lens, sighting.is_inverted, level)
    sighting.known_px = known


def _measure(
    grey: ndarray, image: UInt8[ndarray, "h w"], board: Board, grid: MarkerGrid, sighting: _Sighting
) -> FoundBoard:
    rough = points_at(grid, sighting.known_px, board.n_points)
    spacing, height = steps_at(grid, sighting.known_px, sighting.lens, board.n_points)
    places = BoardPlaces(board.object_points_m[:, :2], board.pitch_m)
    points, covariance, cross = measure_corners(grey, rough, places, REACH * height, may_be_cut=True)
    points = points.copy()
    sigma = np.sqrt(0.5 * np.trace(covariance, axis1=1, axis2=2))
    points[(np.linalg.norm(points - rough, axis=1) > MAX_MOVE * spacing) | (sigma > MOST_SIGMA_PX)] = np.nan
    points[find_inconsistent(grid, sighting.lens, points, covariance, spacing)] = np.nan
    points[_are_misnamed(image, board, points, sighting)] = np.nan
    seen = np.isfinite(points[:, 0])
    if seen.sum() >= LEAST_KEPT:
        points = keep_regular(board.object_points_m[:, :2], points, spacing, (grey.shape[1], grey.shape[0]))
        seen = np.isfinite(points[:, 0])
    if seen.sum() < LEAST_KEPT or not determine_plane(board.object_points_m[seen, :2]):
        return not_found(board.n_points, f"only {seen.sum()} corners could be measured; too blurred or covered?")
    covariance, cross = (np.where(seen[:, None, None], of_all, np.nan) for of_all in (covariance, cross))
    note = "" if seen.all() else f"{seen.sum()} of {board.n_points} corners seen"
    return FoundBoard(points, covariance, note=note, cross_covariance_px2=cross)


def _are_misnamed(
    image: UInt8[ndarray, "h w"], board: Board, points_px: Float[ndarray, "n 2"], sighting: _Sighting
) -> Bool[ndarray, "n"]:
    """At which corners the dots around have another code, or none can be read: a lattice may have gone astray there."""
    grid_px = points_px.reshape(board.rows, board.columns, 2)
    is_bright_first = (sum(board.start) % 2 == 1) != sighting.is_inverted
    readings = read_edges(image, grid_px, sighting.lens, is_bright_first=is_bright_first)
    agreement = agreement_at(grid_px, board, readings, AGREEMENT_REACH).ravel()
    if sighting.is_inverted:
        agreement = -agreement
    return ~(agreement >= LEAST_AGREEMENT)
