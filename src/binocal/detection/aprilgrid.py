"""AprilGrids: grids of 36h11 tags whose corners touch small black squares, as Kalibr prints them, or touch nothing.

Prints differ in three ways that the images show: the tag's black border is one or two bits wide (Kalibr: two), ids
count from the top-left or from the bottom-left tag (Kalibr), and a tag's own up may be turned against the board's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.detection.finding.markers import find_markers, get_dictionary, to_8_bit
from binocal.detection.finding.planes import grid_residuals
from binocal.detection.finding.regularity import keep_regular
from binocal.detection.finding.strays import find_strays, stray_note
from binocal.detection.finding.xcorners import read_rings
from binocal.detection.found import FoundBoard, not_found
from binocal.detection.measuring.refinement import corner_covariance, measure_corners, refine_corners
from binocal.kernels.corner_fits import BoardPlaces
from binocal.shapes import Bool, Float, Float32, Int

MIN_TAGS = 2  # one tag does not show how the ids run
L_CORNER_BIAS_PX = (
    0.1  # cornerSubPix on tag corners that touch nothing; measured 0.08 to 0.10 on rendered grids, blur 0.8 px
)
MUCH_MORE = 1.5  # times as many tags with the narrow border as with the wide one, for it to be the board's
MAX_STRAY = 0.5  # greatest distance from a smooth plane, tag sides: above it some tag may be none of the board's
MAX_MISFIT = 0.2  # median distance from a smooth plane, tag sides: a wrong hypothesis is off by a whole tag


@dataclass(frozen=True, slots=True)
class TagLayout:
    """How the tags were printed: ids from the bottom-left tag or the top-left one, and the tags' quarter turns."""

    is_bottom_up: bool
    turns: int


def detect_aprilgrid(
    grey: ndarray, stretched: Float32[ndarray, "h w"], board: Board, layout: TagLayout | None = None
) -> tuple[FoundBoard, TagLayout | None]:
    """The tag corners of an AprilGrid, partly visible or not, and the layout that the image proves (None: none).

    Points are in the order of the board as it hangs upright, whichever way its ids run. With a ``layout`` given it is
    taken.
    """
    ids, quads, border_bits = find_tags(to_8_bit(stretched), board.columns * board.rows)
    if len(ids) == 0:
        return not_found(board.n_points, "no tag of the family 36h11 found"), None
    tags = ids - board.first_tag_id
    known = (tags >= 0) & (tags < board.columns * board.rows)
    if not known.any():
        last = board.first_tag_id + board.columns * board.rows - 1
        return not_found(
            board.n_points,
            f"tags with ids {ids.min()} to {ids.max()} found; the board has {board.first_tag_id} to {last}",
        ), None
    tags, quads = tags[known], quads[known]
    if len(tags) < MIN_TAGS:
        return not_found(board.n_points, f"only {len(tags)} tag of the board found; at least {MIN_TAGS} needed"), None
    is_stray = _find_strays(board, tags, quads, (grey.shape[1], grey.shape[0]))
    tags, quads = tags[~is_stray], quads[~is_stray]
    ranked = sorted(
        ((_residuals(board, tags, quads, choice)[0], i, choice) for i, choice in enumerate(_LAYOUTS)),
        key=lambda r: r[:2],
    )
    is_proved = ranked[0][0] < MAX_MISFIT and ranked[1][0] > max(3 * ranked[0][0], 0.05)
    proved = ranked[0][2] if is_proved else None
    alike = {choice for misfit, _, choice in ranked if misfit <= max(3 * ranked[0][0], 0.05)}
    chosen = layout or proved or next(choice for choice in _LAYOUTS if choice in alike or choice == ranked[0][2])
    if not _residuals(board, tags, quads, chosen)[0] < MAX_MISFIT:
        return not_found(
            board.n_points,
            f"its {len(tags)} tags do not lie as on a {board.columns}x{board.rows} grid, gap {board.tag_gap_ratio:g}",
        ), proved
    found = _measure(grey, stretched, board, tags, quads, chosen, border_bits)
    notes = [found.note] if found.note else []
    if layout is None and proved is None:
        notes = ["which way the ids run cannot be seen in this image; from the bottom taken"]
    if is_stray.any():
        notes.append(stray_note(int(is_stray.sum()), "tag"))
    return replace(found, note="; ".join(notes)) if found.is_found else found, proved


# In order of preference where several fit: Kalibr's ids run from the bottom.
_LAYOUTS = tuple(TagLayout(is_bottom_up, turns) for is_bottom_up in (True, False) for turns in range(4))


def find_tags(grey8: ndarray, n_tags: int) -> tuple[Int[ndarray, "n"], Float[ndarray, "n 4 2"], int]:
    """Tags of either border width, in the image with its dark parts thinned by a pixel and, if need be, as it is.

    Thinning parts the tags from the small squares that touch their corners and would merge them into one outline; it
    shrinks a tag by a pixel on each side, which refinement takes back.
    """
    dictionary = get_dictionary("DICT_APRILTAG_36h11")
    thinned = cv2.dilate(grey8, np.ones((3, 3), np.uint8))
    best: tuple[ndarray, ndarray, int] = (np.zeros(0, int), np.zeros((0, 4, 2)), 2)
    for image, grow in ((thinned, 1.0), (grey8, 0.0)):
        for border_bits in (2, 1):
            ids, quads = find_markers(image, dictionary, border_bits=border_bits)
            # A wide border is read as a narrow one too: a stray tag of that kind must not decide.
            if len(ids) > len(best[0]) * (MUCH_MORE if border_bits < best[2] else 1.0):
                best = ids, np.array([_grow(quad, grow) for quad in quads]), border_bits
            if len(best[0]) >= max(4, n_tags // 2):
                return best
    return best


def _grow(quad: Float[ndarray, "4 2"], by_px: float) -> Float[ndarray, "4 2"]:
    """A quadrilateral whose corners moved outwards along its diagonals, so that its sides move by about ``by_px``."""
    way = quad - quad.mean(axis=0)
    return quad + np.sqrt(2) * by_px * way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)


def _point_indices(board: Board, tags: Int[ndarray, "m"], layout: TagLayout) -> Int[ndarray, "m 4"]:
    """The board's point for each corner of each tag, in the tag's own corner order."""
    row, column = np.divmod(tags, board.columns)
    if layout.is_bottom_up:
        row = board.rows - 1 - row
    corner = (np.arange(4) + layout.turns) % 4
    return 4 * (row * board.columns + column)[:, None] + corner


def _find_strays(board: Board, tags: ndarray, quads: ndarray, size_wh: tuple[int, int]) -> Bool[ndarray, "m"]:
    """Tags that are none of the board's, where without them the others fit a layout and with them not all do."""
    nowhere = np.zeros(len(tags), bool)
    if min(_residuals(board, tags, quads, choice)[1] for choice in _LAYOUTS) < MAX_STRAY:
        return nowhere
    xy = board.object_points_m[:, :2] / (board.pitch_m * (1 + board.tag_gap_ratio))
    strays = (find_strays(xy[_point_indices(board, tags, choice)], quads, size_wh) for choice in _LAYOUTS)
    is_stray = min(strays, key=np.count_nonzero)
    return nowhere if is_stray.all() else is_stray


def _residuals(board: Board, tags: ndarray, quads: ndarray, layout: TagLayout) -> tuple[float, float]:
    """Median and greatest distance of the tag corners from a smooth image of the plane, in tag sides."""
    xy = board.object_points_m[_point_indices(board, tags, layout).ravel(), :2]
    side = float(np.linalg.norm(quads - np.roll(quads, -1, axis=1), axis=-1).mean())
    residuals = grid_residuals(xy, quads.reshape(-1, 2)) / side
    return float(np.median(residuals)), float(residuals.max())


def _measure(
    grey: ndarray, stretched: ndarray, board: Board, tags: ndarray, quads: ndarray, layout: TagLayout, border_bits: int
) -> FoundBoard:
    n = board.n_points
    rough, side = np.full((n, 2), np.nan), np.full(n, np.nan)
    index = _point_indices(board, tags, layout)
    rough[index.ravel()] = quads.reshape(-1, 2)
    side[index.ravel()] = np.repeat(np.linalg.norm(quads - np.roll(quads, -1, axis=1), axis=-1).min(axis=1), 4)
    # The window ends where the small square or the tag's code begins.
    window_per_side = 0.75 * min(board.tag_gap_ratio, border_bits / (6 + 2 * border_bits))
    points = refine_corners(grey, rough, side, per_spacing=window_per_side)
    seen = np.isfinite(points[:, 0])
    border = border_bits / (6 + 2 * border_bits)
    radius = max(2.0, 0.5 * float(np.nanmedian(side)) * min(board.tag_gap_ratio, border))
    touches = bool(seen.any()) and read_rings(stretched, points[seen], radius)[0].mean() >= 0.5
    if touches:
        start = np.where(seen[:, None], points, rough)
        xy = board.object_points_m[:, :2]
        points, covariance, cross = measure_corners(
            grey,
            start,
            BoardPlaces(xy),
            board.tag_gap_ratio * side,
            border * side,
            per_reach=window_per_side / board.tag_gap_ratio,
        )
    else:
        covariance = corner_covariance(grey, points, side, per_spacing=window_per_side) + L_CORNER_BIAS_PX**2 * np.eye(
            2
        )
        cross = np.zeros_like(covariance)
    points[np.linalg.norm(points - rough, axis=1) > np.maximum(0.15 * side, 2.5)] = np.nan
    seen = np.isfinite(points[:, 0])
    if seen.sum() >= 4:
        points = keep_regular(board.object_points_m[:, :2], points, 0.5 * side, (grey.shape[1], grey.shape[0]))
        seen = np.isfinite(points[:, 0])
    if seen.sum() < 4:
        return not_found(
            n, f"only {seen.sum()} tag corners could be measured; the image is too blurred or the tags are too small"
        )
    covariance[~seen] = cross[~seen] = np.nan
    note = ""
    if not touches:
        note = "the tags' corners touch no black squares, which costs accuracy (about 0.1 px); Kalibr's print has them"
    return FoundBoard(points, covariance, note=note, cross_covariance_px2=cross)
