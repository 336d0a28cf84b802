"""Circle grids, symmetric and staggered, dark on bright or bright on dark."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.boards.board import HOLE, LARGE
from binocal.detection.finding.blobs import LARGE_BLOCKS, SMALL_BLOCKS, USUAL_BLOCKS, Blobs, find_blobs
from binocal.detection.finding.circle_layout import MAX_SHARE_MISSING, match_circles, measure_lattice, shows_another
from binocal.detection.finding.circle_marks import LEAST_MARKED, match_marked
from binocal.detection.finding.equal_circles import GridSpots, are_equal_circles
from binocal.detection.finding.planes import N_FOR_WHOLE_LENS, determine_plane, expected_points
from binocal.detection.finding.point_lattice import grow_point_lattices
from binocal.detection.finding.regularity import keep_regular
from binocal.detection.found import FoundBoard, not_found, several_boards
from binocal.detection.measuring.circle_shift import measure_circle_shift
from binocal.detection.measuring.ellipses import measure_spots
from binocal.kernels.image_lens import LensFitOptions
from binocal.shapes import Float, Int, UInt8

MIRRORED = "the image shows the board mirrored; give the images as the cameras took them"
# Scale, polarity and thresholds: at half the size first, which is four times as fast and shows all circles but the smallest.
_LEVELS = (
    (2, True, USUAL_BLOCKS), (2, False, USUAL_BLOCKS), (1, True, SMALL_BLOCKS), (1, False, SMALL_BLOCKS),
    (2, True, LARGE_BLOCKS), (2, False, LARGE_BLOCKS),
)  # fmt: skip
LEAST_OF_UNKNOWN = 12  # circles of a grid of which nothing is known: fewer are found in clutter


def detect_circles(grey: ndarray, stretched: UInt8[ndarray, "h w"], board: Board) -> FoundBoard:
    """The circles' centres; the whole board must be visible, unless three of its circles are marked.

    Centres are those of the circles themselves: the shift of a disc's centroid under perspective is taken out with the
    homography of the whole grid. A symmetric grid looks the same turned by half (a square one by a quarter); the
    orientation whose rows run most to the lower right of the image is chosen, as with chessboards. Marked circles say
    which way round a board is, and which part of it is seen.
    """
    least, enough = max(4, board.n_points // 2), int(0.95 * board.n_points)
    if board.marked_points:
        least = LEAST_MARKED
    size_wh = grey.shape[1], grey.shape[0]
    best: tuple[int, tuple[int, int]] | None = None
    fullest: tuple[int, FoundBoard, bool] | None = None
    refused: FoundBoard | None = None
    n_most = 0
    is_mirrored = False
    for scale, is_dark, blocks in _LEVELS:
        if fullest is not None and (scale, is_dark) != (1, fullest[2]):
            continue  # at full size more of its circles may be seen
        blobs = find_blobs(stretched, is_dark=is_dark, scale=scale, blocks=blocks)
        n_most = max(n_most, len(blobs))
        lattices = grow_point_lattices(blobs.centres_px, blobs.radii_px, size_wh, least=least, enough=enough)
        for k, lattice in enumerate(lattices):
            if board.marked_points:
                index, is_mirror = match_marked(lattice, blobs, board, size_wh)
                is_mirrored |= is_mirror
                index = None if is_mirror else index
            else:
                index = match_circles(lattice, blobs.centres_px, board)
            if index is not None:
                if not board.marked_points and shows_another(lattices[k + 1 :], blobs.centres_px, board):
                    return several_boards(board)
                found = _finish(grey, board, blobs, index, is_dark)
                if not found.is_found:
                    refused = refused or found
                    continue
                n_found = int(found.is_seen.sum())
                radii_px = blobs.radii_px[index[index >= 0]]
                if n_found >= enough or not board.marked_points or _is_all_in_view(found, board, radii_px, size_wh):
                    return found
                if fullest is None or n_found > fullest[0]:
                    fullest = n_found, found, is_dark
                continue
            (columns, rows), n_seen = measure_lattice(lattice, blobs.centres_px, board.kind)
            if board.marked_points:
                n_seen = len(lattice.members)
            elif min(columns, rows) < 2 or n_seen < (1 - MAX_SHARE_MISSING) * columns * rows:
                continue  # a chance lattice of the clutter
            if best is None or n_seen > best[0]:
                best = n_seen, (columns, rows)
    if fullest is not None:
        return fullest[1]
    if is_mirrored:
        return not_found(board.n_points, MIRRORED)
    if refused is not None:
        return refused
    return _not_found(board, best, n_most)


def _not_found(board: Board, best: tuple[int, tuple[int, int]] | None, n_spots: int) -> FoundBoard:
    """Why: by the number of circles and the size of the fullest grid, if any was seen."""
    spec = f"{board.columns}x{board.rows}"
    if best is None:
        return not_found(board.n_points, f"no circle grid found ({n_spots} round spots seen)")
    n_seen, (columns, rows) = best
    if board.marked_points:
        text = f"a lattice of {n_seen} circles seen, but not the three {board.circle_style} ones that name them"
        return not_found(board.n_points, text)
    if board.kind == "circles":  # either way round is the same grid
        columns, rows = max(columns, rows), min(columns, rows)
    if n_seen > board.n_points and columns * rows > board.n_points:
        return not_found(
            board.n_points,
            f"the grid continues beyond the SPEC's {spec} circles; the SPEC is probably {board.kind}:{columns}x{rows}",
            size_seen=(columns, rows),
        )
    return not_found(
        board.n_points,
        f"only {n_seen} of the {board.n_points} circles seen ({columns}x{rows})",
        size_seen=(columns, rows),
    )


def find_circle_grid(stretched: UInt8[ndarray, "h w"]) -> Board | None:
    """The fullest circle grid in an image, of either kind (its pitch is not known); None where there is none."""
    fullest: tuple[int, Board] | None = None
    for is_dark in (True, False):
        blobs = find_blobs(stretched, is_dark=is_dark)
        enough = max(LEAST_OF_UNKNOWN, len(blobs) // 2)
        for lattice in grow_point_lattices(
            blobs.centres_px, blobs.radii_px, stretched.shape[::-1], least=LEAST_OF_UNKNOWN, enough=enough
        ):
            for kind in ("circles", "acircles"):
                (columns, rows), n = measure_lattice(lattice, blobs.centres_px, kind)
                if min(columns, rows) < 2 or n < (1 - MAX_SHARE_MISSING) * columns * rows:
                    continue
                if kind == "circles":
                    columns, rows = max(columns, rows), min(columns, rows)
                if fullest is None or n > fullest[0]:
                    fullest = n, Board(kind, columns, rows, is_metric=False)
    return None if fullest is None else fullest[1]


def _finish(grey: ndarray, board: Board, blobs: Blobs, index: Int[ndarray, "n"], is_dark: bool) -> FoundBoard:
    spots = blobs.select(index)
    start = np.where(index[:, None] < 0, np.nan, spots.centres_px)
    ratio, hole = _relative_sizes(board)
    measured = measure_spots(grey, start, spots.axes_px, spots.angles_rad, is_dark=is_dark, holes=hole)
    centres, areas_px2 = measured.centres_px.copy(), measured.areas_px2
    xy = board.object_points_m[:, :2]
    seen = np.isfinite(centres[:, 0])
    if seen.sum() < 4:
        return not_found(board.n_points, "the circles are too faint to measure")
    size_wh = grey.shape[1], grey.shape[0]
    if determine_plane(xy[seen]):
        options = LensFitOptions(has_one_unknown=bool(seen.sum() < N_FOR_WHOLE_LENS))
        if not are_equal_circles(GridSpots(xy / board.pitch_m, ratio, measured, spots), size_wh, options):
            return not_found(board.n_points, "the spots on the grid are no equal circles")
        centres[seen] -= measure_circle_shift(xy[seen], centres[seen], areas_px2[seen], size_wh, options, ratio[seen])
    gaps = np.linalg.norm(centres[:, None] - centres[None], axis=-1) + np.where(np.eye(len(centres)), np.inf, 0)
    spacing = np.nanmin(np.where(np.isfinite(gaps), gaps, np.inf), axis=1)
    centres = keep_regular(xy, centres, spacing, size_wh)
    n_seen = int(np.isfinite(centres[:, 0]).sum())
    n_least = 0.8 * (index >= 0).sum() if board.marked_points else (1 - MAX_SHARE_MISSING) * board.n_points
    if n_seen < n_least:
        return not_found(board.n_points, f"the circles do not lie on a smooth grid ({n_seen} of {board.n_points} do)")
    note = "" if n_seen == board.n_points else f"{n_seen} of {board.n_points} circles seen"
    covariance = np.where(np.isfinite(centres)[:, :1, None], measured.covariance_px2, np.nan)
    return FoundBoard(centres, covariance, note=note)


def _is_all_in_view(found: FoundBoard, board: Board, radii_px: Float[ndarray, "m"], size_wh: tuple[int, int]) -> bool:
    """Whether those circles that are not seen lie outside of the image; ``radii_px`` are those of the others."""
    if found.is_seen.sum() < N_FOR_WHOLE_LENS:
        return False
    spacing = 2 * float(np.median(radii_px)) / board.circle_diameter_ratio
    expected = expected_points(board.object_points_m[:, :2] / board.pitch_m, found.points_px, spacing, size_wh)
    rim = float(radii_px.max())  # those that touch the border are not seen
    with np.errstate(invalid="ignore"):
        is_in_view = ((expected > rim) & (expected < np.array(size_wh) - 1 - rim)).all(axis=1)
    return not (is_in_view & ~found.is_seen).any()


def _relative_sizes(board: Board) -> tuple[Float[ndarray, "n"], Float[ndarray, "n"]]:
    """Each circle's diameter over a plain one's, and its hole's over its own."""
    ratio, hole = np.ones(board.n_points), np.full(board.n_points, HOLE if board.circle_style == "rings" else 0.0)
    marked = list(board.marked_points)
    ratio[marked] = LARGE if board.circle_style == "large" else 1.0
    hole[marked] = HOLE if board.circle_style == "hollow" else 0.0
    return ratio, hole
