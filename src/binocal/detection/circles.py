"""Circle grids, symmetric and staggered, dark on bright or bright on dark."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.detection.finding.blobs import Blobs, find_blobs
from binocal.detection.finding.planes import apply_homography, fit_homography
from binocal.detection.finding.point_lattice import LatticePoints, grow_point_lattices
from binocal.detection.finding.regularity import keep_regular
from binocal.detection.found import FoundBoard, not_found
from binocal.detection.measuring.ellipses import measure_spots
from binocal.shapes import Float, Float32, Int

MAX_SHARE_MISSING = 0.1  # of a grid whose outline is complete
LEAST_OF_UNKNOWN = 12  # circles of a grid of which nothing is known: fewer are found in clutter
# Every change of basis that can turn a lattice's own steps into the board's: whole numbers -1 to 1, area kept.
_BASES = [
    np.array([[a, b], [c, d]])
    for a in (-1, 0, 1) for b in (-1, 0, 1) for c in (-1, 0, 1) for d in (-1, 0, 1)
    if abs(a * d - b * c) == 1
]  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class _Match:
    """Blobs as the board's points: index of each board point's blob, -1 where none.

    None where the board does not fit.
    """

    blob_of_point: Int[ndarray, "n"] | None
    size_seen: tuple[int, int]
    way: float
    """How far the rows run to the lower right, -1.4 to 1.4.

    Decides between orientations that nothing else distinguishes.
    """


def detect_circles(grey: ndarray, stretched: Float32[ndarray, "h w"], board: Board) -> FoundBoard:
    """The circles' centres; the whole board must be visible.

    Centres are those of the circles themselves: the shift of a disc's centroid under perspective is taken out with the
    homography of the whole grid. A symmetric grid looks the same turned by half (a square one by a quarter); the
    orientation whose rows run most to the lower right of the image is chosen, as with chessboards.
    """
    least = max(4, board.n_points // 2)
    best: tuple[int, tuple[int, int]] | None = None
    n_most = 0
    for is_dark in (True, False):
        blobs = find_blobs(stretched, is_dark=is_dark)
        n_most = max(n_most, len(blobs))
        for lattice in grow_point_lattices(blobs.centres_px, blobs.radii_px, least=least):
            match = _match(lattice, blobs, board)
            if match.blob_of_point is not None:
                return _finish(grey, board, blobs, match.blob_of_point, is_dark)
            columns, rows = match.size_seen
            if min(columns, rows) < 2 or len(lattice.members) < (1 - MAX_SHARE_MISSING) * columns * rows:
                continue  # a chance lattice of the clutter
            if best is None or len(lattice.members) > best[0]:
                best = len(lattice.members), match.size_seen
    spec = f"{board.columns}x{board.rows}"
    if best is None:
        return not_found(board.n_points, f"no circle grid found ({n_most} round spots seen)")
    n_seen, (columns, rows) = best
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
        for lattice in grow_point_lattices(blobs.centres_px, blobs.radii_px, least=LEAST_OF_UNKNOWN):
            n = len(lattice.members)
            for kind in ("circles", "acircles"):
                columns, rows = _match(lattice, blobs, Board(kind, 2, 2, is_metric=False)).size_seen
                if min(columns, rows) < 2 or n < (1 - MAX_SHARE_MISSING) * columns * rows:
                    continue
                if kind == "circles":
                    columns, rows = max(columns, rows), min(columns, rows)
                if fullest is None or n > fullest[0]:
                    fullest = n, Board(kind, columns, rows, is_metric=False)
    return None if fullest is None else fullest[1]


def _match(lattice: LatticePoints, blobs: Blobs, board: Board) -> _Match:
    """The best way to lay the lattice's cells on the board."""
    points = blobs.centres_px[lattice.members]
    best: _Match | None = None
    fewest: tuple[int, tuple[int, int]] | None = None
    for basis in _BASES:
        for shift in (0, 1) if board.kind == "acircles" else (0,):
            cells = lattice.cells @ basis.T
            if board.kind == "acircles":  # steps of the staggered lattice are diagonal: (+1, +1) and (-1, +1) pitches
                cells = np.stack([cells[:, 0] - cells[:, 1], cells[:, 0] + cells[:, 1]], axis=-1)
            cells = cells - cells.min(axis=0)
            row = cells[:, 1]
            offset = (row + shift) % 2 if board.kind == "acircles" else np.zeros(len(row), int)
            doubled = cells[:, 0] - offset
            if board.kind == "acircles" and np.any(doubled % 2):
                continue
            column = doubled // 2 if board.kind == "acircles" else cells[:, 0]
            if column.min() < 0:
                continue
            columns, rows = int(column.max()) + 1, int(row.max()) + 1
            n_gaps = columns * rows - len(cells)
            if fewest is None or n_gaps < fewest[0]:
                fewest = n_gaps, (columns, rows)
            if (columns, rows) != (board.columns, board.rows) or n_gaps > MAX_SHARE_MISSING * board.n_points or shift:
                continue
            way, is_mirrored = _direction(cells, points)
            if is_mirrored:
                continue
            blob_of_point = np.full(board.n_points, -1)
            blob_of_point[row * columns + column] = lattice.members
            match = _Match(blob_of_point, (columns, rows), way)
            if best is None or match.way > best.way:
                best = match
    return best or _Match(None, fewest[1] if fewest else (0, 0), 0.0)


def _direction(cells: ndarray, points: ndarray) -> tuple[float, bool]:
    """How far +x runs to the lower right in the image, and whether x towards y turns the wrong way."""
    step = np.linalg.lstsq(np.column_stack([cells, np.ones(len(cells))]), points, rcond=None)[0]
    return float(step[0].sum() / np.linalg.norm(step[0])), bool(step[0, 0] * step[1, 1] - step[0, 1] * step[1, 0] <= 0)


def _finish(grey: ndarray, board: Board, blobs: Blobs, index: Int[ndarray, "n"], is_dark: bool) -> FoundBoard:
    spots = blobs.select(index)
    start = np.where(index[:, None] < 0, np.nan, spots.centres_px)
    measured = measure_spots(grey, start, spots.axes_px, spots.angles_rad, is_dark=is_dark)
    centres, areas_px2 = measured.centres_px.copy(), measured.areas_px2
    xy = board.object_points_m[:, :2]
    seen = np.isfinite(centres[:, 0])
    if seen.sum() < 4:
        return not_found(board.n_points, "the circles are too faint to measure")
    centres[seen] -= _centroid_shift(xy[seen], centres[seen], areas_px2[seen])
    gaps = np.linalg.norm(centres[:, None] - centres[None], axis=-1) + np.where(np.eye(len(centres)), np.inf, 0)
    spacing = np.nanmin(np.where(np.isfinite(gaps), gaps, np.inf), axis=1)
    centres = keep_regular(xy, centres, spacing, (grey.shape[1], grey.shape[0]))
    n_seen = int(np.isfinite(centres[:, 0]).sum())
    if n_seen < (1 - MAX_SHARE_MISSING) * board.n_points:
        return not_found(board.n_points, f"the circles do not lie on a smooth grid ({n_seen} of {board.n_points} do)")
    note = "" if n_seen == board.n_points else f"{n_seen} of {board.n_points} circles seen"
    covariance = np.where(np.isfinite(centres)[:, :1, None], measured.covariance_px2, np.nan)
    return FoundBoard(centres, covariance, note=note)


def _centroid_shift(
    xy: Float[ndarray, "n 2"], centres: Float[ndarray, "n 2"], areas_px2: Float[ndarray, "n"]
) -> Float[ndarray, "n 2"]:
    """Centre of each disc's image minus the image of its centre, pixels.

    Source: Heikkilä 2000, "Geometric camera calibration using circular control points"; there ellipses under a
    homography, here outlines under a homography and a polynomial for the lens, fitted to the centres as they get better.
    The discs' radius follows from their areas in the image.
    """
    scale = np.abs(xy - xy.mean(axis=0)).max()
    plane = (xy - xy.mean(axis=0)) / scale
    shift = np.zeros_like(centres)
    angle = np.arange(72) * (2 * np.pi / 72)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    for _ in range(2):  # the first round's centres are off by the shift itself, which bends the map by a tenth of it
        to_image = _fit_smooth_map(plane, centres - shift)
        if to_image is None:
            return np.zeros_like(centres)
        step = 1e-3
        along_x, along_y = np.array([step, 0.0]), np.array([0.0, step])
        dx = (to_image(plane + along_x) - to_image(plane - along_x)) / (2 * step)
        dy = (to_image(plane + along_y) - to_image(plane - along_y)) / (2 * step)
        magnification = np.abs(dx[:, 0] * dy[:, 1] - dx[:, 1] * dy[:, 0])
        radius = float(np.sqrt(np.median(areas_px2 / magnification) / np.pi))
        outline = to_image((plane[:, None] + radius * circle).reshape(-1, 2)).reshape(len(plane), -1, 2)
        following = np.roll(outline, -1, axis=1)
        cross = outline[..., 0] * following[..., 1] - outline[..., 1] * following[..., 0]
        centroid = ((outline + following) * cross[..., None]).sum(axis=1) / (3 * cross.sum(axis=1))[:, None]
        shift = centroid - to_image(plane)
    return shift


def _fit_smooth_map(plane: Float[ndarray, "n 2"], points: Float[ndarray, "n 2"]) -> Callable[[ndarray], ndarray] | None:
    """Plane to image: a homography and, where points are enough, a polynomial; None if degenerate."""
    H = fit_homography(plane, points)
    if not np.isfinite(H).all():
        return None
    degree = 4 if len(plane) >= 30 else 3 if len(plane) >= 24 else 2 if len(plane) >= 15 else 0
    powers = [(i, k - i) for k in range(degree + 1) for i in range(k + 1)]

    def basis(xy: ndarray) -> ndarray:
        return np.stack([xy[:, 0] ** i * xy[:, 1] ** j for i, j in powers], axis=-1)

    lens = np.linalg.lstsq(basis(plane), points - apply_homography(H, plane), rcond=None)[0]
    return lambda xy: apply_homography(H, xy) + basis(xy) @ lens
