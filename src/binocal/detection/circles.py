"""Circle grids, symmetric and staggered, dark on bright or bright on dark."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.boards.board import HOLE, LARGE
from binocal.detection.finding.blobs import Blobs, find_blobs
from binocal.detection.finding.circle_layout import MAX_SHARE_MISSING, match_circles, measure_lattice
from binocal.detection.finding.circle_marks import LEAST_MARKED, match_marked
from binocal.detection.finding.planes import N_FOR_WHOLE_LENS
from binocal.detection.finding.point_lattice import grow_point_lattices
from binocal.detection.finding.regularity import keep_regular
from binocal.detection.found import FoundBoard, not_found
from binocal.detection.measuring.ellipses import measure_spots
from binocal.kernels.image_lens import LensFitOptions, fit_image_lens
from binocal.shapes import Float, Float32, Int

MIRRORED = "the image shows the board mirrored; give the images as the cameras took them"
# Scale and polarity: at half the size first, which is four times as fast.
_LEVELS = ((2, True), (2, False), (1, True), (1, False))
LEAST_OF_UNKNOWN = 12  # circles of a grid of which nothing is known: fewer are found in clutter


def detect_circles(grey: ndarray, stretched: Float32[ndarray, "h w"], board: Board) -> FoundBoard:
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
    fullest: tuple[int, FoundBoard] | None = None
    n_most = 0
    is_mirrored = False
    for scale, is_dark in _LEVELS:
        blobs = find_blobs(stretched, is_dark=is_dark, scale=scale)
        n_most = max(n_most, len(blobs))
        for lattice in grow_point_lattices(blobs.centres_px, blobs.radii_px, size_wh, least=least, enough=enough):
            if board.marked_points:
                index, is_mirror = match_marked(lattice, blobs, board, size_wh)
                is_mirrored |= is_mirror
                index = None if is_mirror else index
            else:
                index = match_circles(lattice, blobs.centres_px, board)
            if index is not None:
                found = _finish(grey, board, blobs, index, is_dark)
                n_found = int(found.is_seen.sum())
                if n_found >= enough or not board.marked_points:
                    return found
                if found.is_found and (fullest is None or n_found > fullest[0]):
                    fullest = n_found, found
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


def find_circle_grid(stretched: Float32[ndarray, "h w"]) -> Board | None:
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
    centres[seen] -= _centroid_shift(xy[seen], centres[seen], areas_px2[seen], ratio[seen], size_wh)
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


def _relative_sizes(board: Board) -> tuple[Float[ndarray, "n"], Float[ndarray, "n"]]:
    """Each circle's diameter over a plain one's, and its hole's over its own."""
    ratio, hole = np.ones(board.n_points), np.full(board.n_points, HOLE if board.circle_style == "rings" else 0.0)
    marked = list(board.marked_points)
    ratio[marked] = LARGE if board.circle_style == "large" else 1.0
    hole[marked] = HOLE if board.circle_style == "hollow" else 0.0
    return ratio, hole


def _centroid_shift(
    xy: Float[ndarray, "n 2"],
    centres: Float[ndarray, "n 2"],
    areas_px2: Float[ndarray, "n"],
    ratio: Float[ndarray, "n"],
    size_wh: tuple[int, int],
) -> Float[ndarray, "n 2"]:
    """Centre of each disc's image minus the image of its centre, pixels.

    Source: Heikkilä 2000, "Geometric camera calibration using circular control points"; there ellipses under a
    homography, here outlines under a homography and the image's own lens,
    fitted to the centres as they get better. The discs' radius follows from their areas in the image.
    """
    shift = np.zeros_like(centres)
    step = 1e-3 * float(np.abs(xy - xy.mean(axis=0)).max())
    crosses = xy[:, None] + step * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    angle = np.arange(72) * (2 * np.pi / 72)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    for _ in range(2):  # the first round's centres are off by the shift itself, which bends the map by a tenth of it
        seen = _images_of(xy, centres - shift, crosses.reshape(-1, 2), size_wh)
        if seen is None:
            return np.zeros_like(centres)
        middle, right, left, below, above = np.moveaxis(seen.reshape(crosses.shape), 1, 0)
        dx, dy = (right - left) / (2 * step), (below - above) / (2 * step)
        magnification = np.abs(dx[:, 0] * dy[:, 1] - dx[:, 1] * dy[:, 0])
        radius = float(np.sqrt(np.nanmedian(areas_px2 / magnification / ratio**2) / np.pi))
        around = xy[:, None] + radius * ratio[:, None, None] * circle
        outline = _images_of(xy, centres - shift, around.reshape(-1, 2), size_wh)
        if outline is None:
            return np.zeros_like(centres)
        outline = outline.reshape(len(xy), -1, 2)
        following = np.roll(outline, -1, axis=1)
        cross = outline[..., 0] * following[..., 1] - outline[..., 1] * following[..., 0]
        centroid = ((outline + following) * cross[..., None]).sum(axis=1) / (3 * cross.sum(axis=1))[:, None]
        shift = np.nan_to_num(centroid - middle)
    return shift


def _images_of(
    xy: Float[ndarray, "n 2"], centres: Float[ndarray, "n 2"], places: Float[ndarray, "m 2"], size_wh: tuple[int, int]
) -> Float[ndarray, "m 2"] | None:
    """Places of the board's plane as the image's own lens sees them; None if it cannot be told from the centres."""
    options = LensFitOptions(has_one_unknown=len(xy) < N_FOR_WHOLE_LENS)
    lens = fit_image_lens(xy, centres, size_wh, options, places_xy=places)
    return None if lens is None else lens.images_px
