"""AprilGrids: grids of AprilTags whose corners touch small black squares, as Kalibr prints them, or touch nothing.

Prints differ in three ways that the images show: the tag's black border is one or two bits wide (Kalibr: two), ids
count from the top-left or from the bottom-left tag (Kalibr), and a tag's own up may be turned against the board's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.detection.finding.marker_codes import CodeKind
from binocal.detection.finding.marker_grid import april_grid
from binocal.detection.finding.marker_search import MarkerSighting, choose_way, few_kept_note, search_markers
from binocal.detection.finding.marker_surroundings import read_surroundings
from binocal.detection.finding.markers import find_markers, get_dictionary
from binocal.detection.finding.planes import grid_residuals
from binocal.detection.finding.regularity import keep_regular
from binocal.detection.finding.strays import find_strays, stray_note
from binocal.detection.finding.xcorners import read_rings
from binocal.detection.found import FoundBoard, not_found, several_boards
from binocal.detection.measuring.refinement import corner_covariance, measure_corners, refine_corners
from binocal.kernels.corner_fits import BoardPlaces
from binocal.shapes import Bool, Float, Int, UInt8

MIN_TAGS = 2  # one tag does not show how the ids run
L_CORNER_BIAS_PX = (
    0.1  # cornerSubPix on tag corners that touch nothing; measured 0.08 to 0.10 on rendered grids, blur 0.8 px
)
MUCH_MORE = 1.5  # times as many tags with the narrow border as with the wide one, for it to be the board's
LEAST_MORE_READ = 2  # tags that must be where one layout demands them and not where another does, for it to be believed
LAYOUT_UNKNOWN = "which way the ids run cannot be seen in this image; from the bottom taken"
MOST_GAP_OFF = 0.05  # of the distance of tags, for the SPEC's gap to be blamed where no corner could be measured
MIRRORED = "the image shows the board mirrored; give the images as the cameras took them"
MAX_STRAY = 0.5  # greatest distance from a smooth plane, tag sides: above it some tag may be none of the board's
MAX_MISFIT = 0.2  # median distance from a smooth plane, tag sides: a wrong hypothesis is off by a whole tag


@dataclass(frozen=True, slots=True)
class TagLayout:
    """How the tags were printed: ids from the bottom-left tag or the top-left one, and the tags' quarter turns."""

    is_bottom_up: bool
    turns: int


def detect_aprilgrid(
    grey: ndarray, stretched: UInt8[ndarray, "h w"], board: Board, layout: TagLayout | None = None
) -> tuple[FoundBoard, TagLayout | None]:
    """The tag corners of an AprilGrid, partly visible or not, and the layout that the image proves (None: none).

    Points are in the order of the board as it hangs upright, whichever way its ids run. With a ``layout`` given it is
    taken. Where no lattice with tags is seen (their corners may touch no squares), OpenCV's search for the tags alone is tried.
    """
    found, proved, is_mirrored = _detect_by_lattice(grey, stretched, board, layout)
    if found is not None:
        return found, proved
    found, proved = _detect_by_tags(grey, stretched, board, layout)
    if is_mirrored and not found.is_found:
        found = not_found(board.n_points, MIRRORED)
    return found, proved


def _detect_by_lattice(
    grey: ndarray, stretched: UInt8[ndarray, "h w"], board: Board, layout: TagLayout | None
) -> tuple[FoundBoard | None, TagLayout | None, bool]:
    """The board by its lattice, None where none is seen; the layout that is proved; whether a mirror image was seen."""
    layouts = (layout,) if layout else _LAYOUTS
    grids = [april_grid(board, each.is_bottom_up, each.turns, _border_share(board, 1)) for each in layouts]
    kinds = [CodeKind(board.marker_dictionary, border_bits, 0.0, board.tag_gap_ratio) for border_bits in (2, 1)]
    search = search_markers(stretched, grids, kinds, board.first_tag_id, least_sure=1 if layout else MIN_TAGS)
    if search.is_several:
        return several_boards(board), None, False
    if not search.sightings:
        return None, None, search.is_mirrored
    best, is_alone = choose_way(search.sightings, LEAST_MORE_READ)
    is_proved = layout is None and is_alone
    found = _measure_lattice(grey, board, best)
    if not found.is_found:
        column, row = np.moveaxis(best.grid.crossings, -1, 0)
        quads = best.known_px[row, column]
        is_whole = np.isfinite(quads).all(axis=(1, 2))
        found = _blame_gap(found, board, np.flatnonzero(is_whole), quads[is_whole])
    else:
        around = read_surroundings(stretched, board, best)
        if around.reason:
            other = replace(not_found(board.n_points, around.reason), spec_seen=around.spec or "?")
            return other, layouts[best.way] if is_proved else None, False
        notes = [LAYOUT_UNKNOWN] if layout is None and not is_proved else []
        notes += [t for t in (few_kept_note(int(found.is_seen.sum()), best.n_predicted), around.note) if t]
        found = replace(found, note="; ".join(notes))
    return found, layouts[best.way] if is_proved else None, False


def _detect_by_tags(
    grey: ndarray, stretched: UInt8[ndarray, "h w"], board: Board, layout: TagLayout | None
) -> tuple[FoundBoard, TagLayout | None]:
    """The board by its tags alone, which OpenCV finds: where their corners touch no squares there is no lattice."""
    ids, quads, border_bits = find_tags(stretched, board.columns * board.rows, board.marker_dictionary)
    if len(ids) == 0:
        return not_found(
            board.n_points, f"no tag of the family {(board.dictionary or 'tag36h11').removeprefix('tag')} found"
        ), None
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
    rough, side = np.full((board.n_points, 2), np.nan), np.full(board.n_points, np.nan)
    index = _point_indices(board, tags, chosen)
    rough[index.ravel()] = quads.reshape(-1, 2)
    side[index.ravel()] = np.repeat(np.linalg.norm(quads - np.roll(quads, -1, axis=1), axis=-1).min(axis=1), 4)
    found = _measure_tags(grey, stretched, board, rough, side, border_bits)
    if not found.is_found:
        return _blame_gap(found, board, tags, quads), proved
    notes = [found.note] if found.note else []
    if layout is None and proved is None:
        notes = [LAYOUT_UNKNOWN]
    if is_stray.any():
        notes.append(stray_note(int(is_stray.sum()), "tag"))
    return replace(found, note="; ".join(notes)) if found.is_found else found, proved


# In order of preference where several fit: Kalibr's ids run from the bottom.
_LAYOUTS = tuple(TagLayout(is_bottom_up, turns) for is_bottom_up in (True, False) for turns in range(4))


def find_tags(
    grey8: ndarray, n_tags: int, family: str = "DICT_APRILTAG_36h11"
) -> tuple[Int[ndarray, "n"], Float[ndarray, "n 4 2"], int]:
    """Tags of either border width, in the image with its dark parts thinned by a pixel and, if need be, as it is.

    Thinning parts the tags from the small squares that touch their corners and would merge them into one outline; it
    shrinks a tag by a pixel on each side, which refinement takes back.
    """
    dictionary = get_dictionary(family)
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


def _blame_gap(found: FoundBoard, board: Board, tags: Int[ndarray, "m"], quads: Float[ndarray, "m 4 2"]) -> FoundBoard:
    """A board whose corners could not be measured, because of the SPEC's gap where the tags contradict it."""
    gap = _gap_seen(board, tags, quads)
    if not abs(gap - board.tag_gap_ratio) > MOST_GAP_OFF * (1 + board.tag_gap_ratio):
        return found
    text = f"its tags lie about {gap:.2f} of their side apart, the SPEC says {board.tag_gap_ratio:g}; measure the gap"
    return not_found(board.n_points, text)


def _gap_seen(board: Board, tags: Int[ndarray, "m"], quads: Float[ndarray, "m 4 2"]) -> float:
    """The gap between neighbouring tags over their side, as far as a plane about each pair tells; NaN without neighbours."""
    place = {int(tag): i for i, tag in enumerate(tags)}
    gaps = []
    for tag, i in place.items():
        beside = [tag + 1] if (tag + 1) % board.columns else []
        for k in (place[other] for other in (*beside, tag + board.columns) if other in place):
            pair = quads[[i, k]].mean(axis=0)
            edges = 0.5 * (pair[[1, 3]] - pair[0] + pair[2] - pair[[3, 1]])
            if abs(np.linalg.det(edges)) > 1:
                gaps.append(np.abs(np.linalg.solve(edges.T, quads[k].mean(axis=0) - quads[i].mean(axis=0))).max() - 1)
    return float(np.median(gaps)) if gaps else np.nan


def _residuals(board: Board, tags: ndarray, quads: ndarray, layout: TagLayout) -> tuple[float, float]:
    """Median and greatest distance of the tag corners from a smooth image of the plane, in tag sides."""
    xy = board.object_points_m[_point_indices(board, tags, layout).ravel(), :2]
    side = float(np.linalg.norm(quads - np.roll(quads, -1, axis=1), axis=-1).mean())
    residuals = grid_residuals(xy, quads.reshape(-1, 2)) / side
    return float(np.median(residuals)), float(residuals.max())


def _measure_lattice(grey: ndarray, board: Board, sighting: MarkerSighting) -> FoundBoard:
    """The corners of a lattice, where tags and small squares meet."""
    rough = sighting.points_px(board.n_points)
    side, height = sighting.steps_px(board.n_points)
    border = _border_share(board, sighting.reading.kind.border_bits)
    # The window ends where the small square or the tag's code begins.
    points, covariance, cross = measure_corners(
        grey,
        rough,
        BoardPlaces(board.object_points_m[:, :2]),
        board.tag_gap_ratio * height,
        border * height,
        per_reach=0.75 * min(1.0, border / board.tag_gap_ratio),
    )
    points[~_are_near(points, rough, side)] = np.nan
    points[sighting.find_inconsistent(points, covariance, side)] = np.nan
    return _as_found(grey, board, points, covariance, cross, side)


def _measure_tags(
    grey: ndarray,
    stretched: UInt8[ndarray, "h w"],
    board: Board,
    rough: Float[ndarray, "n 2"],
    side: Float[ndarray, "n"],
    border_bits: int,
) -> FoundBoard:
    """The corners of tags about their rough places, NaN where unknown; ``side`` is the tags' there."""
    border = _border_share(board, border_bits)
    window_per_side = 0.75 * min(board.tag_gap_ratio, border)
    points = refine_corners(grey, rough, side, per_spacing=window_per_side)
    seen = np.isfinite(points[:, 0])
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
    points[~_are_near(points, rough, side)] = np.nan
    found = _as_found(grey, board, points, covariance, cross, side)
    if touches or not found.is_found:
        return found
    note = "the tags' corners touch no black squares, which costs accuracy (about 0.1 px); Kalibr's print has them"
    return replace(found, note=note)


def _border_share(board: Board, border_bits: int) -> float:
    """Width of the tags' border, in their sides."""
    return border_bits / (get_dictionary(board.marker_dictionary).markerSize + 2 * border_bits)


def _are_near(points: ndarray, rough: ndarray, side: Float[ndarray, "n"]) -> Bool[ndarray, "n"]:
    with np.errstate(invalid="ignore"):
        return np.linalg.norm(points - rough, axis=1) <= np.maximum(0.15 * side, 2.5)


def _as_found(
    grey: ndarray, board: Board, points: ndarray, covariance: ndarray, cross: ndarray, side: Float[ndarray, "n"]
) -> FoundBoard:
    """The board of the corners that lie as on a plane behind a lens."""
    seen = np.isfinite(points[:, 0])
    if seen.sum() >= 4:
        points = keep_regular(board.object_points_m[:, :2], points, 0.5 * side, (grey.shape[1], grey.shape[0]))
        seen = np.isfinite(points[:, 0])
    if seen.sum() < 4:
        return not_found(
            board.n_points,
            f"only {seen.sum()} tag corners could be measured; the image is too blurred or the tags are too small",
        )
    covariance[~seen] = cross[~seen] = np.nan
    return FoundBoard(points, covariance, cross_covariance_px2=cross)
