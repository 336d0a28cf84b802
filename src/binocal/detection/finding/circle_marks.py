"""Marked circles of a grid, which name all others: three larger ones or rings, in a triangle that has no symmetry.

Where all three are seen they name the grid. Two, or one, leave several ways to lay the board on what is seen; one of them is taken
where every other one is contradicted: by a plain circle where a mark should be, by circles beside the board, or by circles of the board
that should be in view and are not.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.boards.board import LARGE, MARKS
from binocal.detection.finding.blobs import Blobs
from binocal.detection.finding.circle_layout import assign_points, lattice_layouts
from binocal.detection.finding.planes import N_FOR_WHOLE_LENS
from binocal.detection.finding.point_lattice import LatticePoints, is_seen_from_behind
from binocal.kernels.image_lens import LensFitOptions, fit_image_lens
from binocal.shapes import Bool, Float, Int

LEAST_MARKED = 10  # points of a lattice, the marked ones among them
LEAST_LARGER = np.sqrt(LARGE)  # halfway between the others' size and the marked ones', as the lens sees them
LEAST_HOLLOW = 0.3  # by how much the middle is more like the background than the others' middles are: blur of half the hole leaves 0.4
MAX_SHARE_STRAY = 0.05  # of the lattice's points that lie beside the board
LEAST_BESIDE = 3  # points, by a way to lay the board that this contradicts: strays hardly lie where the lattice goes on
SURELY_PLAIN = 0.5  # of what makes a circle a marked one: more may be one that blur or glare has changed
MAX_SHARE_UNSEEN = 0.08  # of the board's circles in view that are not seen, by the one way that is taken
LEAST_SHARE_UNSEEN = 0.25  # likewise
LEAST_FOR_VIEW = 20  # points of a lattice, from which on it tells what of the board should be in view
MAX_UNLIKE_CIRCLES = (
    1.5  # the longer axis over the shorter one of the circles as laid on the board; sheared by a place they have 2.6
)
RIM_RADII = 1.6  # of the circle's centre from the image's border, to be surely in view


def match_marked(
    lattice: LatticePoints, blobs: Blobs, board: Board, size_wh: tuple[int, int]
) -> tuple[Int[ndarray, "n"] | None, bool]:
    """Index of each board point's spot, -1 where none is seen, by the marked circles; and whether the image is mirrored.

    None where what is seen of the marks allows no way to lay the board on the lattice, or more than one.
    """
    steps = _steps(lattice, blobs, size_wh)
    strength = _mark_strengths(lattice, blobs, board, steps)
    is_marked = strength > 1
    points = blobs.centres_px[lattice.members]
    if is_marked.sum() < len(MARKS):
        if steps is None or not is_marked.any() or len(points) < LEAST_FOR_VIEW:
            return None, False
        return _match_by_view(_Seen(lattice, points, strength, steps, size_wh), blobs, board), False
    for is_mirrored in (False, True):
        index = _match(lattice, points * ([-1, 1] if is_mirrored else [1, 1]), is_marked, board)
        if index is not None:
            return index, is_mirrored
    return None, False


def _mark_strengths(
    lattice: LatticePoints, blobs: Blobs, board: Board, steps: Float[ndarray, "m 2 2"] | None
) -> Float[ndarray, "m"]:
    """How far each of a lattice's spots is from a plain one: above 1 it is marked as the board's three are."""
    if board.circle_style == "hollow":
        hollowness = blobs.hollowness[lattice.members]
        return (hollowness - np.median(hollowness)) / LEAST_HOLLOW
    if steps is None:
        return np.zeros(len(lattice.members))
    size = blobs.radii_px[lattice.members] / np.sqrt(np.abs(np.linalg.det(steps)))
    return (size / np.nanmedian(size) - 1) / (LEAST_LARGER - 1)


def _steps(lattice: LatticePoints, blobs: Blobs, size_wh: tuple[int, int]) -> Float[ndarray, "m 2 2"] | None:
    """The image's steps (columns) along the lattice's two axes about each of its points, by the image's own lens, px."""
    cells, points = lattice.cells, blobs.centres_px[lattice.members]
    way = np.array([-1.0, 1.0]) if is_seen_from_behind(points, cells) else np.ones(2)
    step = 0.1
    around = cells[:, None] + step * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    options = LensFitOptions(is_robust=True, has_one_unknown=len(points) < N_FOR_WHOLE_LENS)
    lens = fit_image_lens(cells * way, points, size_wh, options, places_xy=(around * way).reshape(-1, 2))
    if lens is None:
        return None
    right, left, below, above = np.moveaxis(lens.images_px.reshape(around.shape), 1, 0)
    return np.stack([right - left, below - above], axis=-1) / (2 * step)


def _match(
    lattice: LatticePoints, points: Float[ndarray, "m 2"], is_marked: Bool[ndarray, "m"], board: Board
) -> Int[ndarray, "n"] | None:
    """The one way to lay the board on the lattice so that its marks are marked ones; None where there is none, or two."""
    found: dict[tuple[int, ...], ndarray] = {}
    origin = np.array(divmod(board.marked_points[0], board.columns))[::-1]
    most_stray = max(1, int(MAX_SHARE_STRAY * len(lattice.members)))
    for xy in lattice_layouts(lattice, points, "circles", turns=4):
        marked = {tuple(place) for place in xy[is_marked].tolist()}
        for x, y in marked:
            if not all((x + right, y + down) in marked for right, down in MARKS):
                continue
            index = assign_points(lattice, xy - [x, y] + origin, board)
            if (index >= 0).sum() >= len(lattice.members) - most_stray:
                found[tuple(index.tolist())] = index
    return next(iter(found.values())) if len(found) == 1 else None


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """A lattice in an image: its points, how marked each one is, and the steps about it."""

    lattice: LatticePoints
    points: Float[ndarray, "m 2"]
    strength: Float[ndarray, "m"]
    steps: Float[ndarray, "m 2 2"]
    size_wh: tuple[int, int]


def _match_by_view(seen: _Seen, blobs: Blobs, board: Board) -> Int[ndarray, "n"] | None:
    """The one way to lay the board on the lattice that nothing contradicts while all others are; None where there is none."""
    taken: dict[tuple[int, ...], ndarray] = {}
    n_open = 0
    for xy in _ways_by_marks(seen, blobs, board):
        index = assign_points(seen.lattice, xy, board)
        if tuple(index.tolist()) in taken:
            continue
        n_beside = len(seen.points) - int((index >= 0).sum())
        share_unseen = _share_unseen(seen, blobs, board, xy, index)
        if n_beside <= MAX_SHARE_STRAY * len(seen.points) and share_unseen <= MAX_SHARE_UNSEEN:
            taken[tuple(index.tolist())] = index
        elif n_beside < LEAST_BESIDE and not share_unseen >= LEAST_SHARE_UNSEEN:
            n_open += 1
    return next(iter(taken.values())) if len(taken) == 1 and not n_open else None


def _ways_by_marks(seen: _Seen, blobs: Blobs, board: Board) -> Iterator[Int[ndarray, "m 2"]]:
    """Columns and rows on the board of the lattice's points, in each way that no marked or plain circle contradicts."""
    is_marked, is_plain = seen.strength > 1, seen.strength < SURELY_PLAIN
    marks = np.array(np.divmod(board.marked_points, board.columns))[::-1].T
    first = int(np.flatnonzero(is_marked)[0])
    for xy in lattice_layouts(seen.lattice, seen.points, "circles", turns=4):
        if not _are_circles(seen, blobs, xy):
            continue
        for mark in marks:
            places = xy - xy[first] + mark
            is_of_mark = (places[:, None] == marks).all(axis=2).any(axis=1)
            if is_of_mark[is_marked].all() and not (is_of_mark & is_plain).any():
                yield places


def _are_circles(seen: _Seen, blobs: Blobs, xy: Int[ndarray, "m 2"]) -> bool:
    """Whether the spots would be circles on the board, and not sheared ones."""
    change = np.linalg.lstsq(seen.lattice.cells - seen.lattice.cells[0], xy - xy[0], rcond=None)[0].T
    J = seen.steps @ np.linalg.inv(change)
    members = seen.lattice.members
    angle, axes = blobs.angles_rad[members], blobs.axes_px[members]
    turn = np.stack([np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)], axis=-1).reshape(-1, 2, 2)
    on_board = np.linalg.svd(np.linalg.solve(J, turn * axes[:, None]), compute_uv=False)
    return bool(np.nanmedian(on_board[:, 0] / on_board[:, 1]) < MAX_UNLIKE_CIRCLES)


def _share_unseen(seen: _Seen, blobs: Blobs, board: Board, xy: Int[ndarray, "m 2"], index: Int[ndarray, "n"]) -> float:
    """Of the board's circles that should be in view if it lies so, the share that is not seen; NaN where no lens fits."""
    rows, columns = np.divmod(np.arange(board.n_points), board.columns)
    places = np.column_stack([columns, rows]).astype(float)
    lens = fit_image_lens(xy.astype(float), seen.points, seen.size_wh, LensFitOptions(is_robust=True), places_xy=places)
    if lens is None:
        return float("nan")
    rim = RIM_RADII * float(blobs.radii_px[seen.lattice.members].max())
    expected = lens.images_px
    with np.errstate(invalid="ignore"):
        is_in_view = ((expected > rim) & (expected < np.array(seen.size_wh) - 1 - rim)).all(axis=1)
    return float((index[is_in_view] < 0).mean()) if is_in_view.any() else float("nan")
