"""Chessboards with marked squares: any part with the marks in view is found, and named by them.

The lattice of X-corners comes first, whatever its size; the squares between its corners say which part of the board it is; from
there it grows over what else is seen of the board.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.detection.finding.crossings import (
    better_lens,
    count_visible,
    from_level,
    grow_known,
    points_at,
    steps_at,
)
from binocal.detection.finding.expected_places import place_near
from binocal.detection.finding.groups import CornerGroup, link_corners
from binocal.detection.finding.lattice import MIN_CORNERS
from binocal.detection.finding.marked_squares import Placement, fits_board, place_board, read_squares
from binocal.detection.finding.marker_consistency import find_inconsistent
from binocal.detection.finding.marker_grid import MarkerGrid, marked_grid
from binocal.detection.finding.marker_search import ENOUGH_SHARE, marker_level_settings
from binocal.detection.finding.planes import determine_plane
from binocal.detection.finding.regularity import keep_regular
from binocal.detection.finding.search import LevelSetting, scaled_saddles
from binocal.detection.finding.whole_extent import place_whole
from binocal.detection.finding.xcorners import SaddleImage, XCorners, find_saddles
from binocal.detection.found import FoundBoard, not_found
from binocal.detection.measuring.refinement import measure_corners
from binocal.kernels.corner_fits import BoardPlaces
from binocal.kernels.marker_grids import FieldLens
from binocal.shapes import Bool, Float, Float32, UInt8

MOST_SADDLES_PER_CORNER, LEAST_SADDLES = 5, 1200
MOST_GROUPS = 6  # of linked corners, that are looked at
LEAST_KEPT = 4  # corners: fewer carry no pose
MAX_MOVE = 0.25  # of the spacing, between where a corner was seen and where it was measured
MOST_SIGMA_PX = (
    1.0  # of a corner: at the image's border some are hardly fitted, and off by up to 18 px where squares are large
)
MIRROR_IMAGE = (
    "mirror image; give the images as the cameras took them, or count columns, rows and the marked squares again"
)
# A disc's rim is 0.54 squares from the square's corners, and the fit takes what lies within 0.85 of the reach.
REACH_AT_DISC = 0.5


@dataclass(slots=True, eq=False)
class _Sighting:
    """A lattice named by its marks."""

    known_px: Float[ndarray, "rows columns 2"]
    lens: FieldLens
    is_inverted: bool


@dataclass(slots=True)
class _Refusal:
    """Why a lattice was not taken for the board; the larger rank says more."""

    rank: int = 0
    text: str = "no chessboard found"

    def not_found(self, n_points: int) -> FoundBoard:
        """What is told of the image."""
        return replace(not_found(n_points, self.text), is_unnamed=self.rank in (1, 2))

    def consider(self, rank: int, text: str) -> None:
        if rank > self.rank:
            self.rank, self.text = rank, text


def detect_marked_chessboard(
    grey: ndarray,
    image: UInt8[ndarray, "h w"],
    board: Board,
    expected_px: Float[ndarray, "n 2"] | None = None,
) -> FoundBoard:
    """The inner corners of a chessboard with marked squares, partly visible or not; ``image`` is ``grey`` stretched to 8 bits.

    Where the marks are not seen, or leave open which part of the board is, its corners are named by where they are expected
    (NaN: unknown), to a quarter of a square; where nothing is expected, or something else, nothing is found.
    """
    grid = marked_grid(board)
    size_wh = image.shape[1], image.shape[0]
    most = max(LEAST_SADDLES, MOST_SADDLES_PER_CORNER * board.n_points)
    sighting: _Sighting | None = None
    refusal = _Refusal()
    for saddles, scale in scaled_saddles(image, _level_settings):
        corners, peaks = find_saddles(saddles, most=most)
        level = saddles.smooth, scale, peaks
        if sighting is None:
            sighting = _recognise(image, board, expected_px, (saddles, corners, scale), refusal)
            if sighting is None:
                continue
        _grow(sighting, grid, board, level, size_wh)
        n_known = int(np.isfinite(sighting.known_px[..., 0]).sum())
        if n_known >= ENOUGH_SHARE * count_visible(grid, sighting.known_px, sighting.lens, size_wh):
            break
    return refusal.not_found(board.n_points) if sighting is None else _measure(grey, board, grid, sighting)


def _level_settings(halvings: int) -> list[LevelSetting]:
    """The searches of an image that can be halved so often: those for markers, then smoother ones for blurred boards."""
    return [*marker_level_settings(halvings), *(LevelSetting(n, 1.5, 5.0) for n in (0, 2) if n <= halvings)]


def _recognise(
    image: UInt8[ndarray, "h w"],
    board: Board,
    expected_px: Float[ndarray, "n 2"] | None,
    seen: tuple[SaddleImage, XCorners, float],
    refusal: _Refusal,
) -> _Sighting | None:
    """The lattice whose squares are marked as the board's, or lies where its corners must; None, and why, where there is none."""
    saddles, corners, scale = seen
    for group in link_corners(saddles, corners)[:MOST_GROUPS]:
        if len(group) < MIN_CORNERS:
            break
        cells = group.cells - group.cells.min(axis=0)
        columns, rows = cells.max(axis=0) + 1
        if min(columns, rows) < 2:
            continue
        grid_px = np.full((rows, columns, 2), np.nan)
        grid_px[cells[:, 1], cells[:, 0]] = from_level(corners.points_px[group.members], scale)
        readings, is_bright_first = read_squares(image, grid_px), _is_bright_first(group, cells)
        placements = place_board(board, grid_px, readings)
        if len(placements) == 1 and fits_board(placements[0], len(group)):
            return _as_sighting(board, grid_px, placements[0], is_bright_first)
        unmarked = [] if placements else place_whole(board, grid_px, readings)
        if expected_px is not None:
            unmarked = place_near(board, grid_px, expected_px)
        # What colours contradict is off by a square, or the wrong way up.
        named = [
            _as_sighting(board, grid_px, each, is_bright_first) for each in unmarked if fits_board(each, len(group))
        ]
        named = [sighting for sighting in named if not sighting.is_inverted]
        if len(named) == 1:
            return named[0]
        if len(placements) < 2 and _is_mirrored(image, board, grid_px, len(group)):
            refusal.consider(4, f"a chessboard of {columns}x{rows} corners is seen that is the SPEC's {MIRROR_IMAGE}")
        _explain(refusal, board, placements, (int(columns), int(rows)))
    return None


def _is_mirrored(
    image: UInt8[ndarray, "h w"], board: Board, grid_px: Float[ndarray, "rows columns 2"], n_seen: int
) -> bool:
    """Whether the lattice is the board's mirror image, and so much of it that its marks and its edges say so."""
    mirrored = np.ascontiguousarray(grid_px[:, ::-1])
    placements = place_board(board, mirrored, read_squares(image, mirrored))
    return len(placements) == 1 and fits_board(placements[0], n_seen)


def _explain(refusal: _Refusal, board: Board, placements: list[Placement], size: tuple[int, int]) -> None:
    seen = f"a chessboard of {size[0]}x{size[1]} corners is seen"
    marked = "square" if len(board.discs) + len(board.swapped) == 1 else "squares"
    if not placements:
        refusal.consider(1, f"{seen}, but not the board's marked {marked}, without which its corners have no names")
    elif len(placements) > 1:
        ways = f"fits the board in {len(placements)} ways"
        refusal.consider(2, f"{seen} that {ways}; show more of the board around its marked {marked}")
    else:
        beyond = f"reaches beyond the SPEC's {board.columns}x{board.rows} around the marked {marked}"
        refusal.consider(3, f"{seen} that {beyond}; count corners and marked squares again")


def _is_bright_first(group: CornerGroup, cells: ndarray) -> bool:
    """Whether the square beyond the lattice's corner (0, 0), between its rows and columns, is bright."""
    return bool(group.turns[0] % 2 == 0) ^ bool(cells[0].sum() % 2)


def _as_sighting(
    board: Board, grid_px: Float[ndarray, "rows columns 2"], placement: Placement, is_bright_first: bool
) -> _Sighting:
    row, column = np.nonzero(np.isfinite(grid_px[..., 0]))
    cells = np.stack([column, row], axis=-1)
    places = placement.corners(cells)
    inside = ((places >= 0) & (places < [board.columns, board.rows])).all(axis=1)
    known = np.full((board.rows, board.columns, 2), np.nan)
    known[places[inside, 1], places[inside, 0]] = grid_px[row[inside], column[inside]]
    # The board's square beyond its corner (0, 0) is dark; squares are of one colour where the sum of their middle's places is even.
    middle = placement.turn @ np.array([0.5, 0.5]) + placement.shift - 0.5
    is_like_first = int(np.rint(middle.sum())) % 2 == 0
    return _Sighting(known, FieldLens(), is_bright_first == is_like_first)


def _grow(
    sighting: _Sighting,
    grid: MarkerGrid,
    board: Board,
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
    sighting.known_px = np.where(board.is_printed.reshape(known.shape[:2])[..., None], known, np.nan)


def _measure(grey: ndarray, board: Board, grid: MarkerGrid, sighting: _Sighting) -> FoundBoard:
    rough = points_at(grid, sighting.known_px, board.n_points)
    spacing, height = steps_at(grid, sighting.known_px, sighting.lens, board.n_points)
    reach = np.where(_are_at_discs(board), REACH_AT_DISC, 1.0) * height
    places = BoardPlaces(board.object_points_m[:, :2], board.pitch_m)
    points, covariance, cross = measure_corners(grey, rough, places, reach, may_be_cut=True)
    points = points.copy()
    sigma = np.sqrt(0.5 * np.trace(covariance, axis1=1, axis2=2))
    points[(np.linalg.norm(points - rough, axis=1) > MAX_MOVE * spacing) | (sigma > MOST_SIGMA_PX)] = np.nan
    points[find_inconsistent(grid, sighting.lens, points, covariance, spacing)] = np.nan
    seen = np.isfinite(points[:, 0])
    if seen.sum() >= LEAST_KEPT:
        points = keep_regular(board.object_points_m[:, :2], points, spacing, (grey.shape[1], grey.shape[0]))
        seen = np.isfinite(points[:, 0])
    if seen.sum() < LEAST_KEPT or not determine_plane(board.object_points_m[seen, :2]):
        return not_found(
            board.n_points, f"only {seen.sum()} corners about the marks could be measured; too blurred or covered?"
        )
    covariance, cross = (np.where(seen[:, None, None], of_all, np.nan) for of_all in (covariance, cross))
    n_printed = int(board.is_printed.sum())
    note = "" if seen.sum() == n_printed else f"{seen.sum()} of {n_printed} corners seen"
    return FoundBoard(points, covariance, note=note, cross_covariance_px2=cross)


def _are_at_discs(board: Board) -> Bool[ndarray, "n"]:
    """Which corners have a disc in a square beside them."""
    are_near = np.zeros((board.rows, board.columns), bool)
    for column, row in board.discs:
        are_near[row - 1 : row + 1, column - 1 : column + 1] = True
    return are_near.ravel()
