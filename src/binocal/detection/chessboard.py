"""Chessboards: lattices of X-corners compared with the SPEC, oriented, refined and checked."""

from __future__ import annotations

import cv2
import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.detection.finding.grid import grid_reach, grid_spacing
from binocal.detection.finding.growth import grow
from binocal.detection.finding.lattice import Lattice, continues_beyond
from binocal.detection.finding.planes import expected_points
from binocal.detection.finding.regularity import find_irregular
from binocal.detection.finding.search import SearchLevel, search_levels
from binocal.detection.finding.xcorners import read_rings
from binocal.detection.found import FoundBoard, not_found
from binocal.detection.measuring.refinement import measure_corners
from binocal.detection.measuring.saddles import localize_saddles
from binocal.kernels import images
from binocal.shapes import Bool, Float, UInt8

# Of a board whose outline is complete; below it the view is too doubtful to keep. The border of a shadow across a board of
# eight columns costs a fifth of the corners.
MIN_SHARE_SEEN = 0.75
MIN_SHARE_TO_LOOK_AGAIN = 0.4  # of the corners, to say where the missing ones are
MIN_SHARE_OF_OTHER = 0.85  # of a board of another size, which is only a board if it is nearly whole
SHARE_THAT_WILL_DO = 0.95  # with fewer corners at one scale, the next is searched too
_RIVAL_SPACING = (
    0.4  # a second board counts from this share of the first one's spacing on: an image on a screen does not
)


def detect_chessboard(grey: ndarray, image: UInt8[ndarray, "h w"], board: Board) -> FoundBoard:
    """The inner corners of a chessboard; ``image`` is ``grey`` stretched to 8 bits.

    Orientation: rows and columns turn as in the board's frame. Where the colours of the outer squares tell the board's
    two (or four) orientations apart, the square outside corner (0, 0) is dark; where not, the row that runs most to the
    lower right of the image is chosen, which is the same in both cameras of a rig unless the board is turned by 135
    degrees.
    """
    size = (max(board.columns, board.rows), min(board.columns, board.rows))
    seen: list[tuple[Lattice, SearchLevel]] = []  # lattices of the board's size, nearly whole
    least, most_seen = MIN_SHARE_SEEN * board.n_points, 0
    other: Lattice | None = None
    part: tuple[Lattice, SearchLevel] | None = None  # the largest lattice of all, whole or not
    several: list[Lattice] = []
    previous: tuple[int, int] | None = None
    failed: FoundBoard | None = None
    for level in search_levels(image, size):
        if level.is_stretched and (failed or several):
            break  # a part of the image must not overrule what the whole of it showed
        exact = [lattice for lattice in level.lattices if lattice.size == size]
        is_second_look = bool(seen)
        if exact:
            most_seen = max(most_seen, exact[0].n_seen)
            if exact[0].n_seen >= least:
                seen.append((exact[0], level))
        if seen and (is_second_look or most_seen >= SHARE_THAT_WILL_DO * board.n_points):
            # A finer look seldom shows more than the second.
            for lattice, where in sorted(seen, key=lambda candidate: -candidate[0].n_seen):
                found = _finish(grey, image, board, lattice, where)
                if found.is_found:
                    return found
                failed = failed or found
            seen = []
        if exact:
            continue
        rivals = _boards(level.lattices)
        if len(rivals) > 1:
            several = several or rivals  # or pieces of one, which a finer look puts together
            continue
        for lattice in level.lattices:
            if min(lattice.points_px.shape[:2]) >= 3 and (part is None or lattice.n_seen > part[0].n_seen):
                part = lattice, level
        if rivals and (other is None or rivals[0].n_seen > other.n_seen):
            other = rivals[0]
        larger = rivals[0].size if rivals and (rivals[0].size[0] > size[0] or rivals[0].size[1] > size[1]) else None
        if larger is not None and larger == previous:
            break  # two levels agree on a larger board
        previous = larger
    for lattice, where in seen:
        found = _finish(grey, image, board, lattice, where)
        if found.is_found:
            return found
        failed = failed or found
    if failed is not None:
        return failed
    if several:
        return _several(board, several)
    if part is not None and (whole := _grown(grey, image, board, *part)) is not None:
        return whole
    spec = f"{board.columns}x{board.rows}"
    if other is None or most_seen >= other.n_seen:
        text = f"only {most_seen} of the {board.n_points} corners were seen" if most_seen else "no chessboard found"
        return not_found(board.n_points, text)
    columns, rows = other.size
    if columns > size[0] or rows > size[1]:
        return _too_large(board, other.size)
    return not_found(
        board.n_points, f"only {columns}x{rows} corners of the board's {spec} were seen", size_seen=other.size
    )


def find_chessboard_size(image: UInt8[ndarray, "h w"]) -> tuple[int, int] | None:
    """Columns and rows (the larger first) of the largest complete chessboard in an image."""
    best: Lattice | None = None
    for level in search_levels(image, None):
        for lattice in _boards(level.lattices)[:1]:
            if best is None or lattice.n_seen > best.n_seen:
                best = lattice
    return best.size if best else None


def _boards(lattices: list[Lattice], main: Lattice | None = None) -> list[Lattice]:
    """The lattices that are boards: regular, nearly complete, not much smaller than the main one (else the largest)."""
    boards = [] if main is None else [main]
    for lattice in lattices:
        rows, columns = lattice.points_px.shape[:2]
        if lattice is main or min(rows, columns) < 3 or lattice.n_seen < MIN_SHARE_OF_OTHER * rows * columns:
            continue
        if boards and (
            lattice.n_seen < 0.4 * boards[0].n_seen
            or np.nanmedian(grid_spacing(lattice.points_px))
            < _RIVAL_SPACING * np.nanmedian(grid_spacing(boards[0].points_px))
            or any(_overlap(lattice, board) for board in boards)
        ):
            continue
        if _is_regular(lattice):
            boards.append(lattice)
    return boards


def _is_regular(lattice: Lattice) -> bool:
    xy = _cells(lattice.points_px)
    seen = np.isfinite(lattice.points_px[..., 0]).ravel()
    points, spacing = lattice.points_px.reshape(-1, 2)[seen], grid_spacing(lattice.points_px).ravel()[seen]
    return not find_irregular(xy[seen], points, spacing).any()


def _overlap(lattice: Lattice, board: Lattice) -> bool:
    """Whether most of a lattice lies inside the outline of a board."""
    corners = board.points_px[[0, 0, -1, -1], [0, -1, -1, 0]]
    if not np.isfinite(corners).all():
        corners = board.points_px[np.isfinite(board.points_px[..., 0])]
    hull = cv2.convexHull(corners.astype(np.float32))
    centre = np.nanmean(lattice.points_px.reshape(-1, 2), axis=0)
    return cv2.pointPolygonTest(hull, (float(centre[0]), float(centre[1])), False) >= 0


def _cells(grid: Float[ndarray, "rows columns 2"]) -> Float[ndarray, "n 2"]:
    rows, columns = grid.shape[:2]
    return np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2).astype(float)


def _finish(
    grey: ndarray, image: UInt8[ndarray, "h w"], board: Board, lattice: Lattice, level: SearchLevel
) -> FoundBoard:
    """Orient, refine at full resolution and check a lattice of the board's size."""
    rivals = _boards(level.lattices, lattice)[1:]
    if len(rivals) > 1 or any(rival.size == lattice.size for rival in rivals):
        return _several(board, [lattice, *rivals])
    if continues_beyond(level.saddles, level.corners, lattice):
        return _too_large(board, None)
    if _are_squares_patterned(level.saddles.smooth, lattice.points_px, lattice.is_dark_first):
        return not_found(
            board.n_points, "the bright squares hold patterns; is this a ChArUco board (charuco:... in the SPEC)?"
        )
    grid = level.to_image(_orient(lattice, board))
    spacing = grid_spacing(grid).ravel()
    coarse = localize_saddles(image, grid.reshape(-1, 2), spacing)
    points, covariance = measure_corners(grey, coarse, board.object_points_m[:, :2], grid_reach(grid).ravel())
    points[np.linalg.norm(points - coarse, axis=1) > 0.3 * spacing] = np.nan
    points[_are_faint(level, points, grid)] = np.nan
    xy = board.object_points_m[:, :2]
    _drop_irregular(xy, points, spacing, MIN_SHARE_SEEN)
    seen = np.isfinite(points[:, 0])
    if not seen.all() and seen.sum() >= max(12, MIN_SHARE_TO_LOOK_AGAIN * board.n_points):
        _look_again(grey, image, level, xy, points, covariance, grid.shape)
        seen = np.isfinite(points[:, 0])
    if seen.sum() < max(4, MIN_SHARE_SEEN * board.n_points):
        return not_found(
            board.n_points,
            f"the corners do not lie on a smooth grid ({seen.sum()} of {board.n_points} do); too blurred or covered?",
        )
    notes = []
    if not seen.all():
        notes.append(f"{seen.sum()} of {board.n_points} corners seen")
    if rivals:
        notes.append(f"another board of {rivals[0].size[0]}x{rivals[0].size[1]} corners is in the image")
    covariance[~seen] = np.nan
    return FoundBoard(points, covariance, note="; ".join(notes))


def _grown(
    grey: ndarray, image: UInt8[ndarray, "h w"], board: Board, part: Lattice, level: SearchLevel
) -> FoundBoard | None:
    """The board that a lattice of fewer lines is a part of, None if there is none."""
    size = (max(board.columns, board.rows), min(board.columns, board.rows))
    if part.size[0] > size[0] or part.size[1] > size[1] or part.size == size:
        return None
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 0.8)
    grown = grow(grey, smooth, level.to_image(part.points_px), size)
    if grown is None:
        return None
    points, n_before = grown
    whole = Lattice(level.from_image(points), part.is_dark_first ^ bool(n_before % 2), part.contrast_dn)
    found = _finish(grey, image, board, whole, level)
    return found if found.is_found else None


def _drop_irregular(
    xy: Float[ndarray, "n 2"], points: Float[ndarray, "n 2"], spacing: Float[ndarray, "n"], least_share: float
) -> None:
    """Points off the smooth image of the board become NaN, if there are enough to say so."""
    seen = np.isfinite(points[:, 0])
    if seen.sum() >= max(4, least_share * len(points)):
        points[np.nonzero(seen)[0][find_irregular(xy[seen], points[seen], spacing[seen])]] = np.nan


def _look_again(
    grey: ndarray,
    image: UInt8[ndarray, "h w"],
    level: SearchLevel,
    xy: Float[ndarray, "n 2"],
    points: Float[ndarray, "n 2"],
    covariance: Float[ndarray, "n 2 2"],
    shape: tuple[int, ...],
) -> None:
    """Corners that are missing, once more, from where the others say that they are: a lattice may lose its way."""
    seen = np.isfinite(points[:, 0])
    expected = expected_points(xy, points, float(np.nanmedian(grid_spacing(points.reshape(shape)))))
    height, width = image.shape
    if not ((expected > 0) & (expected < [width - 1, height - 1])).all():
        expected[~((expected > 0) & (expected < [width - 1, height - 1])).all(axis=1)] = np.nan
    whole = np.where(seen[:, None], points, expected).reshape(shape)
    spacing, reach = grid_spacing(whole).ravel(), grid_reach(whole).ravel()
    coarse = localize_saddles(image, np.where(seen[:, None], np.nan, expected), spacing)
    found, of_found = measure_corners(grey, coarse, xy, reach)
    found[~(np.linalg.norm(found - expected, axis=1) < 0.3 * spacing)] = np.nan
    points[~seen], covariance[~seen] = found[~seen], of_found[~seen]
    points[_are_faint(level, points, whole) & ~seen] = np.nan
    _drop_irregular(xy, points, spacing, MIN_SHARE_TO_LOOK_AGAIN)


def _are_squares_patterned(smooth: ndarray, grid: Float[ndarray, "rows columns 2"], is_dark_first: bool) -> bool:
    """Whether the bright squares are not plain: a marker fills most of its square with dark, shading only tints it.

    Each bright square is compared with the dark squares beside it, for shadows may lie on the board.
    """
    corners = np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]], axis=2)  # (rows, columns, 4, 2)
    share = np.linspace(0.2, 0.8, 7)
    v, u = (axis.ravel() for axis in np.meshgrid(share, share, indexing="ij"))
    weights = np.stack([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v], axis=-1)
    places = np.tensordot(corners, weights, axes=(2, 1)).transpose(0, 1, 3, 2)  # (rows, columns, samples, 2)
    values = images.sample(smooth, places)
    rows, columns = values.shape[:2]
    is_whole = np.isfinite(corners[..., 0]).all(axis=2)
    is_bright = ((np.add.outer(np.arange(rows), np.arange(columns)) % 2 == 1) ^ (not is_dark_first)) & is_whole
    middle = np.where(is_whole & ~is_bright, values.mean(axis=-1), np.nan)
    around = np.full((rows + 2, columns + 2), np.nan)
    around[1:-1, 1:-1] = middle
    dark = np.fmax(np.fmax(around[:-2, 1:-1], around[2:, 1:-1]), np.fmax(around[1:-1, :-2], around[1:-1, 2:]))
    usable = is_bright & np.isfinite(dark)
    if not usable.any():
        return False
    values, dark = values[usable], dark[usable]
    share_dark = np.mean(values < 0.5 * (dark + values.max(axis=-1))[:, None], axis=-1)
    return bool(np.median(share_dark) > 0.25)


def _are_faint(
    level: SearchLevel, points_px: Float[ndarray, "n 2"], grid_px: Float[ndarray, "rows columns 2"]
) -> Bool[ndarray, "n"]:
    """Which points of the image do not look like the others, likely covered: no X-corner, or one with a third of their contrast.

    Contrast is taken absolutely and relative to the brightness about the corner, because a shadow dims both. Says
    nothing (all False) where most points fail: an image too blurred for rings of this size is not covered everywhere.
    """
    smooth, points = level.saddles.smooth, level.from_image(points_px)
    spacing = grid_spacing(level.from_image(grid_px)).ravel()
    seen = np.isfinite(points[:, 0])
    faint = np.zeros(len(points), bool)
    if not seen.any():
        return faint
    radius = float(np.clip(0.2 * np.median(spacing[seen]), 2.5, 8.0))
    is_corner, _, contrast = read_rings(smooth, points[seen], radius, min_contrast_dn=3.0, max_unlikeness=0.6)
    if is_corner.mean() > 0.5:
        relative = contrast / (images.sample(smooth, points[seen]) + 1)
        faint[seen] = ~is_corner
        faint[seen] |= (contrast < np.median(contrast[is_corner]) / 3) & (relative < np.median(relative[is_corner]) / 3)
    return faint


def _orient(lattice: Lattice, board: Board) -> Float[ndarray, "rows columns 2"]:
    """The lattice's corners as the board's rows and columns, without mirroring."""
    choices = []
    grid, is_dark_first = lattice.points_px, lattice.is_dark_first
    for _ in range(4):
        if grid.shape[:2] == (board.rows, board.columns):
            ways = grid[:, -1] - grid[:, 0]
            way = ways[np.isfinite(ways[:, 0])].mean(axis=0)
            choices.append((is_dark_first, float(way.sum() / np.linalg.norm(way)), grid))
        # The next first corner is the present row's last; its outward square is of the other colour unless the row is
        # even.
        is_dark_first ^= bool(grid.shape[1] % 2)
        grid = np.rot90(grid)
    return max(choices, key=lambda choice: choice[:2])[2]


def _several(board: Board, rivals: list[Lattice]) -> FoundBoard:
    sizes = ", ".join(f"{columns}x{rows}" for columns, rows in (rival.size for rival in rivals[:6]))
    more = ", ..." if len(rivals) > 6 else ""
    return not_found(
        board.n_points,
        f"more than one board in the image ({len(rivals)}: {sizes}{more}); show one at a time, or cover the others",
    )


def _too_large(board: Board, size: tuple[int, int] | None) -> FoundBoard:
    spec = f"{board.columns}x{board.rows}"
    if size is None:
        return not_found(
            board.n_points, f"the printed board continues beyond {spec} corners; count its inner corners again"
        )
    return not_found(
        board.n_points,
        f"the printed board continues beyond {spec} corners; the SPEC is probably chessboard:{size[0]}x{size[1]}",
        size_seen=size,
    )
