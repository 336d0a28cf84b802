"""PuzzleBoards: any part of one is found, and named by the dots on its edges.

The lattice of X-corners comes first, whatever its size; the dots on the edges between its corners say which part of the board it
is; from there it grows over what else is seen of the board.
"""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.boards.puzzle_code import DOT_RADIUS
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
from binocal.detection.finding.edge_bits import agreement_at, locate, read_edges
from binocal.detection.finding.groups import link_corners
from binocal.detection.finding.lattice import MIN_CORNERS
from binocal.detection.finding.marker_grid import puzzle_grid
from binocal.detection.finding.marker_search import ENOUGH_SHARE
from binocal.detection.finding.search import scaled_saddles
from binocal.detection.finding.xcorners import SaddleImage, XCorners, find_saddles
from binocal.detection.found import FoundBoard, not_found
from binocal.kernels.marker_grids import FieldLens
from binocal.shapes import Bool, Float, UInt8

MOST_GROUPS = 8  # of linked corners, that are looked at
REACH = 0.5 - DOT_RADIUS  # squares, from a corner to the nearest dot's rim
LEAST_AGREEMENT, AGREEMENT_REACH = (
    0.4,
    2,
)  # of the dots within so many corners of one with the code, for it to keep its name


def detect_puzzleboard(grey: ndarray, image: UInt8[ndarray, "h w"], board: Board) -> FoundBoard:
    """The inner corners of a PuzzleBoard, partly visible or not; ``image`` is ``grey`` stretched to 8 bits.

    Where the dots leave open which part of the board is seen, nothing is found.
    """
    grid = puzzle_grid(board)
    size_wh = image.shape[1], image.shape[0]
    sighting: NamedLattice | None = None
    refusal = Refusal()
    for saddles, scale in scaled_saddles(image, level_settings):
        corners, peaks = find_saddles(saddles, most=most_saddles(board))
        sighting = _recognise(image, board, saddles, corners, scale, refusal, sighting)
        if sighting is None:
            continue
        grow(sighting, grid, board, (saddles.smooth, scale, peaks), size_wh)
        n_known = int(np.isfinite(sighting.known_px[..., 0]).sum())
        if n_known >= ENOUGH_SHARE * count_visible(grid, sighting.known_px, sighting.lens, size_wh):
            break
    if sighting is None:
        return not_found(board.n_points, refusal.text)
    lattice = sighting
    return measure(
        grey, board, grid, lattice, REACH, find_misnamed=lambda points: _are_misnamed(image, board, points, lattice)
    )


def _recognise(
    image: UInt8[ndarray, "h w"],
    board: Board,
    saddles: SaddleImage,
    corners: XCorners,
    scale: float,
    refusal: Refusal,
    sighting: NamedLattice | None,
) -> NamedLattice | None:
    """What is known already with the groups of linked corners whose dots name them; the first group that does counts before others."""
    for group in link_corners(saddles, corners, has_dots=True)[:MOST_GROUPS]:
        if len(group) < MIN_CORNERS:
            break
        cells, grid_px = lay_out(group, corners, scale)
        rows, columns = grid_px.shape[:2]
        if min(columns, rows) < 2:
            continue
        is_bright = is_bright_first(group, cells)
        readings = read_edges(image, grid_px, FieldLens(), is_bright_first=is_bright)
        decoding = locate(board, cells, readings, is_bright_first=is_bright)
        if decoding.place is None:
            refusal.consider(decoding.rank, f"a lattice of {columns}x{rows} corners {decoding.reason}")
            continue
        places = decoding.place.corners(cells) - np.array(board.start)
        inside = ((places >= 0) & (places < [board.columns, board.rows])).all(axis=1)
        known = np.full((board.rows, board.columns, 2), np.nan)
        known[places[inside, 1], places[inside, 0]] = grid_px[cells[inside, 1], cells[inside, 0]]
        if sighting is None:
            sighting = NamedLattice(known, FieldLens(), decoding.place.is_inverted)
        elif sighting.is_inverted == decoding.place.is_inverted:
            is_new = np.isnan(sighting.known_px[..., :1])
            sighting.known_px = np.where(is_new, known, sighting.known_px)
    return sighting


def _are_misnamed(
    image: UInt8[ndarray, "h w"], board: Board, points_px: Float[ndarray, "n 2"], sighting: NamedLattice
) -> Bool[ndarray, "n"]:
    """At which corners the dots around have another code, or none can be read: a lattice may have gone astray there."""
    grid_px = points_px.reshape(board.rows, board.columns, 2)
    is_bright = (sum(board.start) % 2 == 1) != sighting.is_inverted
    readings = read_edges(image, grid_px, sighting.lens, is_bright_first=is_bright)
    agreement = agreement_at(grid_px, board, readings, AGREEMENT_REACH).ravel()
    if sighting.is_inverted:
        agreement = -agreement
    return ~(agreement >= LEAST_AGREEMENT)
