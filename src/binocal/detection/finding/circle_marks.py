"""Marked circles of a grid, which name all others: three larger ones or rings, in a triangle that has no symmetry."""

from __future__ import annotations

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


def match_marked(
    lattice: LatticePoints, blobs: Blobs, board: Board, size_wh: tuple[int, int]
) -> tuple[Int[ndarray, "n"] | None, bool]:
    """Index of each board point's spot, -1 where none is seen, by the marked circles; and whether the image is mirrored.

    None where the lattice does not show all three marks, or shows more than they are in a place that would do as well.
    """
    is_marked = find_marked(lattice, blobs, board, size_wh)
    if is_marked.sum() < len(MARKS):
        return None, False
    points = blobs.centres_px[lattice.members]
    for is_mirrored in (False, True):
        index = _match(lattice, points * ([-1, 1] if is_mirrored else [1, 1]), is_marked, board)
        if index is not None:
            return index, is_mirrored
    return None, False


def find_marked(lattice: LatticePoints, blobs: Blobs, board: Board, size_wh: tuple[int, int]) -> Bool[ndarray, "m"]:
    """Which of a lattice's spots are marked as the board's three are."""
    members = lattice.members
    if board.circle_style == "hollow":
        hollowness = blobs.hollowness[members]
        return hollowness > np.median(hollowness) + LEAST_HOLLOW
    points = blobs.centres_px[members]
    scale = _magnification(lattice.cells, points, size_wh)
    if scale is None:
        return np.zeros(len(members), bool)
    size = blobs.radii_px[members] / np.sqrt(scale)
    return size > LEAST_LARGER * np.nanmedian(size)


def _magnification(
    cells: Int[ndarray, "m 2"], points: Float[ndarray, "m 2"], size_wh: tuple[int, int]
) -> Float[ndarray, "m"] | None:
    """Area of a cell about each point, by the image's own lens, px²."""
    way = np.array([-1.0, 1.0]) if is_seen_from_behind(points, cells) else np.ones(2)
    step = 0.1
    around = cells[:, None] + step * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    options = LensFitOptions(is_robust=True, has_one_unknown=len(points) < N_FOR_WHOLE_LENS)
    lens = fit_image_lens(cells * way, points, size_wh, options, places_xy=(around * way).reshape(-1, 2))
    if lens is None:
        return None
    right, left, below, above = np.moveaxis(lens.images_px.reshape(around.shape), 1, 0)
    dx, dy = (right - left) / (2 * step), (below - above) / (2 * step)
    return np.abs(dx[:, 0] * dy[:, 1] - dx[:, 1] * dy[:, 0])


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
