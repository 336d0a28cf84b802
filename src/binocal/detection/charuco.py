"""ChArUco boards: markers name the squares, the corners between the squares are measured."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.detection.finding.arrangements import charuco_squares
from binocal.detection.finding.marker_codes import CodeKind
from binocal.detection.finding.marker_grid import charuco_grid
from binocal.detection.finding.marker_search import (
    LEAST_SURE,
    MarkerSighting,
    choose_way,
    few_kept_note,
    search_markers,
)
from binocal.detection.finding.marker_surroundings import read_surroundings
from binocal.detection.finding.markers import find_markers, get_dictionary
from binocal.detection.finding.planes import apply_homography, grid_residuals
from binocal.detection.finding.regularity import keep_regular
from binocal.detection.finding.strays import find_strays, stray_note
from binocal.detection.finding.xcorners import read_rings
from binocal.detection.found import FoundBoard, not_found, several_boards
from binocal.detection.measuring.refinement import measure_corners
from binocal.kernels.corner_fits import BoardPlaces
from binocal.shapes import Bool, Float, Int, UInt8

Layout = Literal["", "current", "legacy"]
MIN_CORNERS = 4  # of one image: fewer carry no pose; the solver decides on more
MAX_MISFIT = 0.5  # distance of markers from a smooth plane, sides; a wrong board is off by a whole square
# Faces that must bear their markers in one layout and not in the other, for it to be believed: on real boards the wrong one had
# up to two more.
LEAST_MORE_READ = 4
LAYOUT_UNKNOWN = "the board's layout (current or legacy) cannot be seen in this image; current taken"
MIRRORED = "the image shows the board mirrored; give the images as the cameras took them"
MIN_LAYOUT_RATIO = 3.0  # by which one layout must fit better than the other to be believed


@dataclass(frozen=True, slots=True, eq=False)
class _Reading:
    """The markers of an image read in one layout: their squares (column, row) and how well they lie on one plane."""

    layout: Layout
    squares: Int[ndarray, "m 2"]
    misfit: float
    """Median distance from a smooth plane, marker sides."""
    worst: float
    """The greatest one."""


def marker_squares(board: Board, layout: Layout) -> Int[ndarray, "m 2"]:
    """Square (column, row) of each marker, by id.

    Both layouts fill the white squares row by row. They differ where the number of rows is even: the current one
    (OpenCV 4.6 on) has a dark square at the top left, the legacy one a white square with marker 0.
    """
    first = 0 if layout == "legacy" and board.rows % 2 == 0 else 1
    return charuco_squares(board.columns, board.rows, first)


def detect_charuco(
    grey: ndarray, stretched: UInt8[ndarray, "h w"], board: Board, layout: Layout = ""
) -> tuple[FoundBoard, Layout]:
    """The inner corners of a ChArUco board, partly visible or not, and the layout the image proves ("": neither).

    With a ``layout`` given it is taken; without, the one in which more of the board's faces bear their markers (the current one
    if both do, with a note). Where no lattice with markers is seen, OpenCV's search for the markers alone is tried.
    """
    found, proved, is_mirrored = _detect_by_lattice(grey, stretched, board, layout)
    if found is not None:
        return found, proved
    found, proved = _detect_by_markers(grey, stretched, board, layout)
    if is_mirrored and not found.is_found:
        found = not_found(board.n_points, MIRRORED)
    return found, proved


def _detect_by_lattice(
    grey: ndarray, stretched: UInt8[ndarray, "h w"], board: Board, layout: Layout
) -> tuple[FoundBoard | None, Layout, bool]:
    """The board by its lattice, None where none is seen; the layout that is proved; whether a mirror image was seen."""
    layouts: tuple[Layout, ...] = (
        (layout,) if layout else ("current", "legacy") if board.rows % 2 == 0 else ("current",)
    )
    grids = [charuco_grid(board, name == "legacy") for name in layouts]
    inset = grids[0].free
    kinds = [CodeKind(board.dictionary, border_bits, inset, inset / (1 - 2 * inset)) for border_bits in (1, 2)]
    search = search_markers(stretched, grids, kinds, board.first_tag_id, least_sure=1 if layout else LEAST_SURE)
    if search.is_several:
        return several_boards(board), "", False
    if not search.sightings:
        return None, "", search.is_mirrored
    best, is_alone = choose_way(search.sightings, LEAST_MORE_READ)
    proved = "current" if board.rows % 2 else layouts[best.way] if is_alone and not layout else ""
    predicted = best.points_px(board.n_points)
    spacing, height = best.steps_px(board.n_points)
    found = _measure(grey, stretched, board, predicted, spacing, height, best)
    if found.is_found:
        around = read_surroundings(stretched, board, best)
        if around.reason:
            return replace(not_found(board.n_points, around.reason), spec_seen=around.spec or "?"), proved, False
        notes = [LAYOUT_UNKNOWN] if not layout and not proved else []
        notes += [t for t in (few_kept_note(int(found.is_seen.sum()), best.n_predicted), around.note) if t]
        found = replace(found, note="; ".join(notes))
    return found, proved, False


def _detect_by_markers(
    grey: ndarray, stretched: UInt8[ndarray, "h w"], board: Board, layout: Layout
) -> tuple[FoundBoard, Layout]:
    """The board by its markers alone, which OpenCV finds: where blur or narrow margins leave no lattice."""
    ids, quads = find_markers(stretched, get_dictionary(board.dictionary))
    if len(ids) == 0:
        return not_found(board.n_points, f"no marker of {board.dictionary} found"), ""
    n_board = len(marker_squares(board, "legacy"))  # where the counts differ, the legacy layout has one more
    ids = ids - board.first_tag_id
    known = (ids >= 0) & (ids < n_board)
    if not known.any():
        first = board.first_tag_id
        has = f"the board has {first} to {first + n_board - 1}"
        return not_found(board.n_points, f"markers have ids from {ids.min() + first} on; {has}"), ""
    ids, quads = ids[known], quads[known]
    readings, is_stray = _read_without_strays(board, ids, quads, (grey.shape[1], grey.shape[0]))
    ids, quads = ids[~is_stray], quads[~is_stray]
    proved = _prove_layout(board, readings)
    reading = readings[layout or proved or "current"]
    if not reading.misfit < MAX_MISFIT:
        size = f"{board.columns}x{board.rows}"
        return not_found(board.n_points, f"its {len(ids)} markers do not lie as on a board of {size} squares"), proved
    predicted, spacing, height = _predict(board, quads, reading)
    found = _measure(grey, stretched, board, predicted, spacing, height)
    few = few_kept_note(int(found.is_seen.sum()), int(np.isfinite(predicted[:, 0]).sum()))
    notes = [few] if few else []
    if not layout and not proved and board.rows % 2 == 0:
        notes.append(LAYOUT_UNKNOWN)
    if is_stray.any():
        notes.append(stray_note(int(is_stray.sum()), "marker"))
    return replace(found, note="; ".join(notes)) if found.is_found else found, proved


def _read_without_strays(
    board: Board, ids: Int[ndarray, "m"], quads: Float[ndarray, "m 4 2"], size_wh: tuple[int, int]
) -> tuple[dict[str, _Reading], Bool[ndarray, "m"]]:
    """The markers read in both layouts, without those that are none of the board's, and which those are."""
    layouts: tuple[Layout, ...] = ("current", "legacy")
    readings = {name: _read_layout(board, name, ids, quads) for name in layouts}
    nowhere = np.zeros(len(ids), bool)
    if min(reading.worst for reading in readings.values()) < MAX_MISFIT:
        return readings, nowhere
    strays = (find_strays(_marker_places(board, readings[name].squares), quads, size_wh) for name in layouts)
    is_stray = min(strays, key=np.count_nonzero)
    if is_stray.all() or not is_stray.any():
        return readings, nowhere
    return {name: _read_layout(board, name, ids[~is_stray], quads[~is_stray]) for name in layouts}, is_stray


def _marker_places(board: Board, squares: Int[ndarray, "m 2"]) -> Float[ndarray, "m 4 2"]:
    """The corners of the markers in these squares, in the markers' own order, squares."""
    margin = 0.5 * (1 - board.marker_m / board.pitch_m)
    return squares[:, None] + np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * (1 - 2 * margin) + margin


def _read_layout(board: Board, layout: Layout, ids: ndarray, quads: ndarray) -> _Reading:
    by_id = marker_squares(board, layout)
    squares = by_id[np.minimum(ids, len(by_id) - 1)]
    residuals = grid_residuals(_marker_places(board, squares).reshape(-1, 2), quads.reshape(-1, 2))
    residuals = residuals / np.linalg.norm(quads - np.roll(quads, -1, axis=1), axis=-1).mean()
    return _Reading(layout, squares, float(np.median(residuals)), float(residuals.max()))


def _prove_layout(board: Board, readings: dict[str, _Reading]) -> Layout:
    """The layout that fits better by far; neither where the markers of one row, or too few, fit both."""
    if board.rows % 2:
        return "current"
    current, legacy = readings["current"].misfit, readings["legacy"].misfit
    if min(current, legacy) > MAX_MISFIT:
        return ""
    if current * MIN_LAYOUT_RATIO < legacy and legacy > 0.05:
        return "current"
    return "legacy" if legacy * MIN_LAYOUT_RATIO < current and current > 0.05 else ""


def _measure(
    grey: ndarray,
    stretched: ndarray,
    board: Board,
    predicted: Float[ndarray, "n 2"],
    spacing: Float[ndarray, "n"],
    height: Float[ndarray, "n"],
    sighting: MarkerSighting | None = None,
) -> FoundBoard:
    """The corners about their predictions; ``spacing`` and ``height`` are the squares' shortest side and least height there."""
    # The fit's bands end before the blurred edge of the markers begins: a window that reached 0.38 squares tripled the
    # residuals of a real set (640x480, squares of 20-40 px).
    margin = 0.5 * (1 - board.marker_m / board.pitch_m)
    points, covariance, cross = measure_corners(
        grey,
        predicted,
        BoardPlaces(board.object_points_m[:, :2], board.pitch_m),
        height,
        margin * height,
        per_reach=0.9 * margin,
    )
    points[np.linalg.norm(points - predicted, axis=1) > 0.25 * spacing] = np.nan
    if sighting is not None:
        is_measured = np.isfinite(points[:, 0])
        points[sighting.find_inconsistent(points, covariance, spacing)] = np.nan
        if is_measured.sum() >= MIN_CORNERS and not np.isfinite(points).any():
            return not_found(board.n_points, "the image is too blurred: the board's corners run into its markers")
    else:
        points[~_are_x_corners(stretched, points, spacing)] = np.nan
    seen = np.isfinite(points[:, 0])
    if seen.sum() >= MIN_CORNERS:
        points = keep_regular(board.object_points_m[:, :2], points, spacing, (grey.shape[1], grey.shape[0]))
        seen = np.isfinite(points[:, 0])
    if seen.sum() < MIN_CORNERS or not _span_plane(board.object_points_m[seen, :2]):
        return not_found(
            board.n_points,
            f"only {seen.sum()} corners seen beside its markers; at least {MIN_CORNERS} off one line needed",
        )
    covariance[~seen] = cross[~seen] = np.nan
    return FoundBoard(points, covariance, cross_covariance_px2=cross)


def _span_plane(xy: Float[ndarray, "n 2"]) -> bool:
    """Whether points spread in two directions."""
    values = np.linalg.svd(xy - xy.mean(axis=0), compute_uv=False)
    return bool(len(xy) >= 2 and values[1] > 0.1 * values[0])


def _predict(
    board: Board, quads: ndarray, reading: _Reading
) -> tuple[Float[ndarray, "n 2"], Float[ndarray, "n"], Float[ndarray, "n"]]:
    """Where each corner must be by the markers beside it, and the square's shortest side and least height there.

    NaN without a marker, or where two disagree.
    """
    columns, rows = board.columns - 1, board.rows - 1
    margin = 0.5 * (1 - board.marker_m / board.pitch_m)
    inner = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * (1 - 2 * margin) + margin
    inner = inner.astype(np.float32)
    outer = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float)
    guesses: list[list[ndarray]] = [[] for _ in range(columns * rows)]
    sides: list[list[float]] = [[] for _ in range(columns * rows)]
    heights: list[list[float]] = [[] for _ in range(columns * rows)]
    for (x, y), quad in zip(reading.squares, quads, strict=True):
        H = cv2.getPerspectiveTransform(inner, quad.astype(np.float32))
        square = apply_homography(H, outer)
        lengths = np.linalg.norm(square - np.roll(square, -1, axis=0), axis=1)
        diagonals = square[2] - square[0], square[3] - square[1]
        area = 0.5 * abs(diagonals[0][0] * diagonals[1][1] - diagonals[0][1] * diagonals[1][0])
        for corner, (dx, dy) in zip(square, outer.astype(int), strict=True):
            column, row = x + dx - 1, y + dy - 1
            if 0 <= column < columns and 0 <= row < rows:
                guesses[row * columns + column].append(corner)
                sides[row * columns + column].append(float(lengths.min()))
                heights[row * columns + column].append(float(area / lengths.max()))
    predicted, spacing = np.full((columns * rows, 2), np.nan), np.full(columns * rows, np.nan)
    height = spacing.copy()
    for i, (points, lengths) in enumerate(zip(guesses, sides, strict=True)):
        if points and np.ptp(points, axis=0).max() < 0.25 * min(lengths):
            predicted[i], spacing[i], height[i] = np.mean(points, axis=0), min(lengths), min(heights[i])
    return predicted, spacing, height


def _are_x_corners(stretched: ndarray, points: ndarray, spacing: ndarray) -> Bool[ndarray, "n"]:
    """Whether four sectors meet at each point.

    The ring stays within the gap between the corner and the marker's code.
    """
    is_corner = np.zeros(len(points), bool)
    radius = np.clip(np.nan_to_num(0.14 * spacing), 2.0, 8.0).round()
    for value in np.unique(radius):
        index = np.nonzero((radius == value) & np.isfinite(points[:, 0]))[0]
        is_corner[index] = read_rings(stretched, points[index].astype(np.float32), float(value))[0]
    return is_corner
