"""How the markers of an image are arranged, read from their ids and places alone: a ChArUco board, an AprilGrid, or neither.

Ids count the markers row by row, so that the number of columns decides where each marker belongs. It is the one for which all
of them lie on a smooth plane and are squares there; where several do, as for a single row, none is known.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy import ndarray

from binocal.detection.finding.planes import apply_homography, fit_homography, grid_residuals
from binocal.shapes import Float, Int

MIN_MARKERS = 6  # 12 coordinates of their centres beside the 8 of a homography
MAX_MISFIT = 0.08  # median distance from a smooth plane, pitches: 0.005 to 0.03 of the right arrangement, a wrong one 0.2 and more
MOST_COLUMNS = 30
MAX_SKEW = 0.25  # of a marker's side, by which its edges may be slanted or differ: on the right board 0.02 to 0.08
NEAREST = 6  # markers that say where a place beyond them lies


@dataclass(frozen=True, slots=True, eq=False)
class Arrangement:
    """Markers as part of a board."""

    kind: Literal["charuco", "aprilgrid"]
    columns: int
    rows: int
    """As far down as markers were seen."""
    is_whole: bool
    """Whether the image shows that no row of markers follows the last one seen, nor comes before the first."""
    side: float
    """Of a marker, in squares of a ChArUco board or in distances of an AprilGrid's tags."""
    n_markers: int


def charuco_squares(columns: int, rows: int, first: int) -> Int[ndarray, "m 2"]:
    """Column and row of each marker's square, by id: the squares with (column + row) mod 2 equal to ``first``."""
    return np.array([(x, y) for y in range(rows) for x in range(columns) if (x + y) % 2 == first])


def find_arrangement(
    ids: Int[ndarray, "m"], quads_px: Float[ndarray, "m 4 2"], size_wh: tuple[int, int]
) -> Arrangement | None:
    """The arrangement of an image's markers, None where none or several fit; ``size_wh`` is the image's, pixels."""
    if len(ids) < MIN_MARKERS:
        return None
    centres = quads_px.mean(axis=1)
    fitting: list[tuple[str, int, int, ndarray, float]] = []
    for kind in ("charuco", "aprilgrid"):
        for first in (1, 0) if kind == "charuco" else (0,):
            for columns in range(2, MOST_COLUMNS + 1):
                places = _places(kind, columns, first, int(ids.max()) + 1)[ids]
                if _lie_on_plane(places, centres) and np.isfinite(side := _square_side(places, quads_px)):
                    fitting.append((kind, columns, first, places, side))
    if len({(kind, columns) for kind, columns, *_ in fitting}) != 1:
        return None
    kind, columns, first, places, side = fitting[0]
    first_row, last_row = int(places[:, 1].min()), int(places[:, 1].max())
    is_possible = first == 1 or kind == "aprilgrid" or last_row % 2 == 1  # the legacy layout has an even number of rows
    is_whole = first_row == 0 and is_possible and _is_end(kind, columns, first, last_row + 1, places, centres, size_wh)
    return Arrangement(kind, columns, last_row + 1, is_whole, side, len(ids))  # type: ignore[arg-type]


def _places(kind: str, columns: int, first: int, n_ids: int) -> Float[ndarray, "m 2"]:
    """Middles of the markers by id, a unit apart along rows and columns of squares or tags; row and column from 0 on."""
    if kind == "charuco":
        return charuco_squares(columns, 2 * n_ids // columns + 2, first).astype(float)
    row, column = np.divmod(np.arange(n_ids), columns)
    return np.stack([column, row], axis=-1).astype(float)


def _lie_on_plane(places: Float[ndarray, "m 2"], centres: Float[ndarray, "m 2"]) -> bool:
    """Whether the markers lie as their places say, seen from the front; of tags the ids may run upwards."""
    if np.ptp(places, axis=0).min() < 1:
        return False
    apart = np.linalg.norm(centres[:, None] - centres, axis=-1) + np.where(np.eye(len(centres)), np.inf, 0)
    of_places = np.linalg.norm(places[:, None] - places, axis=-1) + np.where(np.eye(len(places)), np.inf, 0)
    pitch_px = float(np.median(apart.min(axis=1)) / of_places.min())
    return any(
        float(np.median(grid_residuals(places * [1, up], centres))) < MAX_MISFIT * pitch_px for up in (1.0, -1.0)
    )


def _is_end(
    kind: str, columns: int, first: int, rows: int, places: ndarray, centres: ndarray, size_wh: tuple[int, int]
) -> bool:
    """Whether some marker of the row after the last would lie well inside the image, where it was not seen."""
    following = _places(kind, columns, first, columns * (rows + 2))
    following = following[following[:, 1] == rows]
    return any(_lies_inside(place, places, centres, size_wh) for place in following)


def _lies_inside(place: ndarray, places: ndarray, centres: ndarray, size_wh: tuple[int, int]) -> bool:
    nearest = np.argsort(np.linalg.norm(places - place, axis=1), kind="stable")[:NEAREST]
    H = fit_homography(places[nearest], centres[nearest])
    if not np.isfinite(H).all():
        return False
    around = apply_homography(H, place + np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]))
    return bool(((around > 0) & (around < np.array(size_wh) - 1)).all())


def _square_side(places: ndarray, quads_px: ndarray) -> float:
    """The markers' side in units of the places, NaN where on such a board they were no upright squares."""
    centres, edges = quads_px.mean(axis=1), []
    for place, quad in zip(places, quads_px, strict=True):
        nearest = np.argsort(np.linalg.norm(places - place, axis=1), kind="stable")[:NEAREST]
        H = fit_homography(centres[nearest], places[nearest])
        if np.isfinite(H).all():
            on_board = apply_homography(H, quad)
            edges.append(np.abs(np.roll(on_board, -1, axis=0) - on_board))
    if not edges:
        return float("nan")
    short, long = np.sort(np.median(edges, axis=0), axis=1).T  # of the four edges, along the board's axes
    side = float(long.mean())
    return side if short.max() < MAX_SKEW * side and np.ptp(long) < MAX_SKEW * side else float("nan")
