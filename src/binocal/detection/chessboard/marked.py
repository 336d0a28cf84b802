"""Chessboards with marked squares: any part with the marks in view is found, and named by them.

The lattice of X-corners comes first, whatever its size; the squares between its corners say which part of the board it is; from
there it grows over what else is seen of the board.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.detection.chessboard.named_lattice import (
    NamedLattice,
    Refusal,
    grow,
    is_bright_first,
    lay_out,
    level_settings,
    measure,
    most_saddles,
)
from binocal.detection.finding.crossings import count_visible
from binocal.detection.finding.expected_places import place_near
from binocal.detection.finding.groups import link_corners
from binocal.detection.finding.lattice import MIN_CORNERS
from binocal.detection.finding.marked_squares import Placement, fits_board, place_board, read_squares
from binocal.detection.finding.marker_grid import marked_grid
from binocal.detection.finding.marker_search import ENOUGH_SHARE
from binocal.detection.finding.search import scaled_saddles
from binocal.detection.finding.whole_extent import place_whole
from binocal.detection.finding.xcorners import SaddleImage, XCorners, find_saddles
from binocal.detection.found import FoundBoard, not_found
from binocal.kernels.marker_grids import FieldLens
from binocal.shapes import Bool, Float, UInt8

MOST_GROUPS = 6  # of linked corners, that are looked at
MIRROR_IMAGE = (
    "mirror image; give the images as the cameras took them, or count columns, rows and the marked squares again"
)
# A disc's rim is 0.54 squares from the square's corners, and the fit takes what lies within 0.85 of the reach.
REACH_AT_DISC = 0.5


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
    sighting: NamedLattice | None = None
    refusal = Refusal()
    for saddles, scale in scaled_saddles(image, level_settings):
        corners, peaks = find_saddles(saddles, most=most_saddles(board))
        level = saddles.smooth, scale, peaks
        if sighting is None:
            sighting = _recognise(image, board, expected_px, (saddles, corners, scale), refusal)
            if sighting is None:
                continue
        grow(sighting, grid, board, level, size_wh)
        n_known = int(np.isfinite(sighting.known_px[..., 0]).sum())
        if n_known >= ENOUGH_SHARE * count_visible(grid, sighting.known_px, sighting.lens, size_wh):
            break
    if sighting is None:
        return replace(not_found(board.n_points, refusal.text), is_unnamed=refusal.rank in (1, 2))
    reach = np.where(_are_at_discs(board), REACH_AT_DISC, 1.0)
    return measure(grey, board, grid, sighting, reach, which="corners about the marks")


def _recognise(
    image: UInt8[ndarray, "h w"],
    board: Board,
    expected_px: Float[ndarray, "n 2"] | None,
    seen: tuple[SaddleImage, XCorners, float],
    refusal: Refusal,
) -> NamedLattice | None:
    """The lattice whose squares are marked as the board's, or lies where its corners must; None, and why, where there is none."""
    saddles, corners, scale = seen
    for group in link_corners(saddles, corners)[:MOST_GROUPS]:
        if len(group) < MIN_CORNERS:
            break
        cells, grid_px = lay_out(group, corners, scale)
        rows, columns = grid_px.shape[:2]
        if min(columns, rows) < 2:
            continue
        readings, is_bright = read_squares(image, grid_px), is_bright_first(group, cells)
        placements = place_board(board, grid_px, readings)
        if len(placements) == 1 and fits_board(placements[0], len(group)):
            return _as_sighting(board, grid_px, placements[0], is_bright)
        unmarked = [] if placements else place_whole(board, grid_px, readings)
        if expected_px is not None:
            unmarked = place_near(board, grid_px, expected_px)
        # What colours contradict is off by a square, or the wrong way up.
        named = [_as_sighting(board, grid_px, each, is_bright) for each in unmarked if fits_board(each, len(group))]
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


def _explain(refusal: Refusal, board: Board, placements: list[Placement], size: tuple[int, int]) -> None:
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


def _as_sighting(
    board: Board, grid_px: Float[ndarray, "rows columns 2"], placement: Placement, is_bright: bool
) -> NamedLattice:
    row, column = np.nonzero(np.isfinite(grid_px[..., 0]))
    cells = np.stack([column, row], axis=-1)
    places = placement.corners(cells)
    inside = ((places >= 0) & (places < [board.columns, board.rows])).all(axis=1)
    known = np.full((board.rows, board.columns, 2), np.nan)
    known[places[inside, 1], places[inside, 0]] = grid_px[row[inside], column[inside]]
    # The board's square beyond its corner (0, 0) is dark; squares are of one colour where the sum of their middle's places is even.
    middle = placement.turn @ np.array([0.5, 0.5]) + placement.shift - 0.5
    is_like_first = int(np.rint(middle.sum())) % 2 == 0
    return NamedLattice(known, FieldLens(), is_bright == is_like_first)


def _are_at_discs(board: Board) -> Bool[ndarray, "n"]:
    """Which corners have a disc in a square beside them."""
    are_near = np.zeros((board.rows, board.columns), bool)
    for column, row in board.discs:
        are_near[row - 1 : row + 1, column - 1 : column + 1] = True
    return are_near.ravel()
