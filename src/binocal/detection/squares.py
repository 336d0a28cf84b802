"""Grids of separate squares, dark on bright or bright on dark."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.boards.board import SQUARE_GAP_RATIOS
from binocal.detection.finding.blobs import LARGE_BLOCKS, SMALL_BLOCKS, USUAL_BLOCKS
from binocal.detection.finding.circle_layout import MAX_SHARE_MISSING, match_circles, measure_lattice
from binocal.detection.finding.planes import N_FOR_WHOLE_LENS
from binocal.detection.finding.point_lattice import LatticePoints, grow_point_lattices, is_seen_from_behind
from binocal.detection.finding.quads import Quads, find_quads
from binocal.detection.finding.regularity import keep_regular
from binocal.detection.found import FoundBoard, not_found
from binocal.detection.measuring.squares import measure_squares
from binocal.kernels.image_lens import LensFitOptions, fit_image_lens
from binocal.shapes import Float, Int, UInt8

# Scale, polarity and thresholds, as of circles: at half the size first, which shows all squares but the smallest.
_LEVELS = (
    (2, True, USUAL_BLOCKS), (2, False, USUAL_BLOCKS), (1, True, SMALL_BLOCKS), (1, False, SMALL_BLOCKS),
    (2, True, LARGE_BLOCKS), (2, False, LARGE_BLOCKS),
)  # fmt: skip
N_FOR_LENS = 6  # squares: such grids are small, and clutter that is four-sided is rarer than round spots
LEAST_OF_UNKNOWN = 9  # squares of a grid that is not the board: fewer are found in clutter
MOST_OFF = 0.3  # of a square's shortest side, that its corners may be from where the squares' middles put them


def detect_squares(grey: ndarray, stretched: UInt8[ndarray, "h w"], board: Board) -> FoundBoard:
    """The squares' corners; the whole board must be visible.

    A grid of squares looks the same turned by half (a square one by a quarter); the orientation whose rows run most to the lower
    right of the image is chosen, as with chessboards and circles.
    """
    centres = Board("circles", board.columns, board.rows, is_metric=False)
    least, enough = max(4, centres.n_points // 2), int(0.95 * centres.n_points)
    size_wh = grey.shape[1], grey.shape[0]
    best: tuple[int, tuple[int, int]] | None = None
    refused: FoundBoard | None = None
    n_most = 0
    for scale, is_dark, blocks in _LEVELS:
        quads = find_quads(stretched, is_dark=is_dark, scale=scale, blocks=blocks)
        n_most = max(n_most, len(quads))
        for lattice in grow_point_lattices(
            quads.centres_px, quads.radii_px, size_wh, least=least, enough=enough, n_for_lens=N_FOR_LENS
        ):
            index = match_circles(lattice, quads.centres_px, centres)
            if index is not None:
                found = _finish(grey, board, quads, index, is_dark)
                if found.is_found:
                    return found
                refused = refused or found
                continue
            (columns, rows), n_seen = measure_lattice(lattice, quads.centres_px, "circles")
            if min(columns, rows) < 2 or n_seen < max(LEAST_OF_UNKNOWN, (1 - MAX_SHARE_MISSING) * columns * rows):
                continue  # a chance lattice of the clutter
            if best is None or n_seen > best[0]:
                best = n_seen, (max(columns, rows), min(columns, rows))
    return refused or _not_found(board, best, n_most)


def _not_found(board: Board, best: tuple[int, tuple[int, int]] | None, n_quads: int) -> FoundBoard:
    """Why: by the number of squares and the size of the fullest grid, if any was seen."""
    spec, n = f"{board.columns}x{board.rows}", board.columns * board.rows
    if best is None:
        return not_found(board.n_points, f"no grid of squares found ({n_quads} four-sided spots seen)")
    n_seen, size = best
    if n_seen > n and size[0] * size[1] > n:
        text = f"the grid continues beyond the SPEC's {spec} squares; the SPEC is probably squares:{size[0]}x{size[1]}"
        return not_found(board.n_points, text, size_seen=size)
    text = f"only {n_seen} of the {n} squares seen ({size[0]}x{size[1]})"
    return not_found(board.n_points, text, size_seen=size)


def find_square_grid(stretched: UInt8[ndarray, "h w"]) -> Board | None:
    """The fullest grid of squares in an image, its side 1 and its gap as the image shows it; None where there is none."""
    fullest: tuple[int, Board] | None = None
    size_wh = stretched.shape[1], stretched.shape[0]
    for is_dark in (True, False):
        quads = find_quads(stretched, is_dark=is_dark, scale=2, blocks=USUAL_BLOCKS)
        enough = max(LEAST_OF_UNKNOWN, len(quads) // 2)
        for lattice in grow_point_lattices(
            quads.centres_px, quads.radii_px, size_wh, least=LEAST_OF_UNKNOWN, enough=enough, n_for_lens=N_FOR_LENS
        ):
            (columns, rows), n = measure_lattice(lattice, quads.centres_px, "circles")
            gap = _gap_over_side(quads, lattice, size_wh)
            if min(columns, rows) < 2 or n < (1 - MAX_SHARE_MISSING) * columns * rows:
                continue
            if SQUARE_GAP_RATIOS[0] < gap < SQUARE_GAP_RATIOS[1] and (fullest is None or n > fullest[0]):
                size = max(columns, rows), min(columns, rows)
                fullest = n, Board("squares", *size, is_metric=False, gap_m=round(gap, 2))
    return None if fullest is None else fullest[1]


def _gap_over_side(quads: Quads, lattice: LatticePoints, size_wh: tuple[int, int]) -> float:
    """NaN where no lens sees the squares' middles as a lattice."""
    points = quads.centres_px[lattice.members]
    way = [1.0, -1.0] if is_seen_from_behind(points, lattice.cells) else [1.0, 1.0]
    options = LensFitOptions(tolerance_px=1.0, has_one_unknown=len(points) < N_FOR_WHOLE_LENS)
    lens = fit_image_lens(lattice.cells * way, points, size_wh, options)
    if lens is None:
        return float("nan")
    corners = lens.to_board(quads.corners_px[lattice.members].reshape(-1, 2)).reshape(-1, 4, 2)
    side = float(np.median(np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=-1)))  # of the lattice's step
    return (1 - side) / side


def _finish(grey: ndarray, board: Board, quads: Quads, index: Int[ndarray, "n"], is_dark: bool) -> FoundBoard:
    size_wh = grey.shape[1], grey.shape[0]
    order = _points_of_squares(board)
    xy = board.object_points_m[:, :2] / board.pitch_m
    corners_xy = xy[order]
    start = _name_corners(quads, index, corners_xy, size_wh)
    n, n_least = len(index), (1 - MAX_SHARE_MISSING) * len(index)
    if np.isfinite(start[:, 0, 0]).sum() < n_least:
        gap = f"gaps {board.gap_m / board.pitch_m:.2g} times as wide as squares"
        return not_found(board.n_points, f"a grid of {n} squares seen, but not with {gap}, as the SPEC says")
    options = LensFitOptions(is_robust=True, has_one_unknown=bool(4 * n < N_FOR_WHOLE_LENS))
    measured = measure_squares(grey, start, corners_xy, board.gap_m / board.pitch_m, options, is_dark=is_dark)
    points = np.full((board.n_points, 2), np.nan)
    covariance = np.full((board.n_points, 2, 2), np.nan)
    points[order], covariance[order] = measured.corners_px, measured.covariance_px2
    if np.isfinite(points[:, 0]).sum() < n_least * 4:
        return not_found(board.n_points, "the squares are too faint, or too much covered, to measure")
    apart = np.linalg.norm(points[:, None] - points[None], axis=-1) + np.where(np.eye(len(points)), np.inf, 0)
    spacing = np.where(np.isfinite(apart), apart, np.inf).min(axis=1)
    points = keep_regular(xy, points, spacing, size_wh)
    n_seen = int(np.isfinite(points[:, 0]).sum())
    if n_seen < (1 - MAX_SHARE_MISSING) * board.n_points:
        text = f"the squares' corners do not lie on a smooth grid ({n_seen} of {board.n_points} do)"
        return not_found(board.n_points, text)
    seen = np.isfinite(points)[:, :1, None]
    notes = [] if n_seen == board.n_points else [f"{n_seen} of {board.n_points} corners seen"]
    if measured.has_other_lengths:
        wide = "wider" if measured.spread_px > 0 else "narrower"
        notes.append(
            f"squares {2 * abs(measured.spread_px):.1f} px {wide} than the SPEC says: are their side and gap right?"
        )
    note = "; ".join(notes)
    return FoundBoard(points, np.where(seen, covariance, np.nan), note=note)


def _points_of_squares(board: Board) -> Int[ndarray, "n 4"]:
    """The board's points that are each square's corners, row by row, clockwise as printed from the top left."""
    grid = np.arange(board.n_points).reshape(2 * board.rows, 2 * board.columns)
    corners = grid[::2, ::2], grid[::2, 1::2], grid[1::2, 1::2], grid[1::2, ::2]
    return np.stack([corner.ravel() for corner in corners], axis=-1)


def _name_corners(
    quads: Quads, index: Int[ndarray, "n"], corners_xy: Float[ndarray, "n 4 2"], size_wh: tuple[int, int]
) -> Float[ndarray, "n 4 2"]:
    """Each board square's corners, in the board's order, of the quadrilaterals at these indices; NaN where they do not fit.

    The image's lens, by the squares' middles, says where the corners should be.
    """
    named = np.full(corners_xy.shape, np.nan)
    seen = np.flatnonzero(index >= 0)
    options = LensFitOptions(tolerance_px=1.0, is_robust=True, has_one_unknown=bool(len(seen) < N_FOR_WHOLE_LENS))
    lens = fit_image_lens(
        corners_xy.mean(axis=1)[seen], quads.centres_px[index[seen]], size_wh, options,
        places_xy=corners_xy[seen].reshape(-1, 2),
    )  # fmt: skip
    if lens is None:
        return named
    expected = lens.images_px.reshape(-1, 4, 2)
    corners = quads.corners_px[index[seen]]
    turned = np.stack([np.roll(corners, turn, axis=1) for turn in range(4)])
    off = np.linalg.norm(turned - expected, axis=-1).max(axis=-1)
    best = np.where(np.isfinite(off), off, np.inf).argmin(axis=0)
    side = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=-1).min(axis=1)
    fits = off[best, np.arange(len(seen))] < np.maximum(MOST_OFF * side, 2.0)
    named[seen[fits]] = turned[best, np.arange(len(seen))][fits]
    return named
