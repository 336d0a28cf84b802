"""Lattices of X-corners: neighbours are linked along their edges, links grow into grids with integer coordinates.

Nothing here knows the board: every chessboard pattern in the image comes out with its own number of columns and rows,
which is what tells a wrong SPEC, a second board or a half-hidden one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.detection.finding.regularity import fit_homography
from binocal.detection.finding.xcorners import SaddleImage, XCorners, _wrap, read_rings
from binocal.kernels import images
from binocal.shapes import Float, Int

MAX_TURN_RAD = np.radians(25)  # between an edge at a corner and the way to the neighbour; fisheye edges bend up to 15
# A row of true corners has an edge between any two of them. Along the board's outer border only every second square
# differs from the margin, and chance corners of the clutter have no edges at all: 0.7 parts them.
MIN_BORDER_SHARE = 0.7
# Perspective and fisheye lenses change the step from one row to the next by up to 0.2; margins narrower than a square
# by more.
MAX_STEP_BREAK = 0.28
MIN_TO_JOIN = 12  # corners that fix a homography well enough to look two cells ahead


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """A grid of corners: ``points_px[row, column]``, NaN where none was seen.

    Columns x rows turns as x towards y in the image.
    ``is_dark_first`` tells that the square beyond corner (0, 0), outwards, is dark.
    """

    points_px: Float[ndarray, "rows columns 2"]
    is_dark_first: bool
    contrast_dn: float
    """Bright minus dark at a typical corner, of 255."""

    @property
    def n_seen(self) -> int:
        """Number of corners seen."""
        return int(np.isfinite(self.points_px[..., 0]).sum())

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows, the larger first."""
        rows, columns = self.points_px.shape[:2]
        return max(rows, columns), min(rows, columns)


@dataclass(frozen=True, slots=True, eq=False)
class CornerGroup:
    """Corners linked along their edges: indices, integer cells (column, row), turns of their rays, number of links."""

    members: Int[ndarray, "m"]
    cells: Int[ndarray, "m 2"]
    turns: Int[ndarray, "m"]
    n_links: int

    def __len__(self) -> int:
        return len(self.members)

    def is_whole(self, size: tuple[int, int] | None) -> bool:
        """Whether it is a grid of ``size`` without holes and (nearly) without missing links."""
        columns, rows = (int(n) for n in np.ptp(self.cells, axis=0) + 1)
        n_edges = 2 * columns * rows - columns - rows
        is_full = len(self) == columns * rows and self.n_links >= 0.97 * n_edges
        return is_full and size == (max(columns, rows), min(columns, rows))


def link_corners(saddles: SaddleImage, corners: XCorners) -> list[CornerGroup]:
    """The corners in connected groups, the largest first."""
    if len(corners) < 2:
        return []
    neighbour, back_ray = images.link_corners(
        saddles.smooth, corners.points_px, corners.rays_rad, corners.contrast_dn, MAX_TURN_RAD
    )
    n_ends = (neighbour >= 0).sum(axis=1)
    groups = [
        CornerGroup(*group, int(n_ends[group[0]].sum()) // 2)
        for group in images.grow_groups(corners.points_px, neighbour, back_ray)
    ]
    return sorted(groups, key=lambda group: -len(group))


def find_lattices(
    saddles: SaddleImage,
    corners: XCorners,
    groups: list[CornerGroup],
    *,
    least: int = 9,
    size: tuple[int, int] | None = None,
) -> list[Lattice]:
    """The lattices of at least ``least`` corners, the largest first.

    With a ``size`` (corners along the longer and the shorter side) weak border rows are looked for until it is reached.
    """
    lattices = []
    joined = np.zeros(len(corners), bool)
    for group in groups:
        if len(group) < least or 2 * joined[group.members].sum() > len(group):
            continue
        is_whole = group.is_whole(size)
        members, cells, turns = group.members, group.cells, group.turns
        if not is_whole:
            members, cells = _join(corners, group)
        joined[members] = True
        low = cells.min(axis=0)
        columns, rows = cells.max(axis=0) - low + 1
        if min(columns, rows) < 2 or columns * rows > 4 * len(members) + 16:
            continue
        grid = np.full((rows, columns, 3), np.nan)
        grid[cells[:, 1] - low[1], cells[:, 0] - low[0], :2] = corners.points_px[members]
        grid[cells[:, 1] - low[1], cells[:, 0] - low[0], 2] = corners.contrast_dn[members]
        # Ray 0 has its bright sector after it: with turn 0 the sector between steps +x and +y is bright, so is the one
        # opposite.
        column, row = cells[0] - low
        is_bright_first = (turns[0] % 2 == 0) ^ bool((column + row) % 2)
        if is_whole:
            lattices.append(Lattice(grid[..., :2], not is_bright_first, float(np.median(grid[..., 2]))))
            continue
        grid = _fill(saddles, grid, is_bright_first)
        grid, is_bright_first = _trim(saddles.smooth, grid, is_bright_first)
        if size is not None and 2 * len(members) > size[0] * size[1]:
            grid, is_bright_first = _extend(saddles, grid, is_bright_first, size)
        lattices.append(Lattice(grid[..., :2], not is_bright_first, float(np.nanmedian(grid[..., 2]))))
    return sorted((lattice for lattice in lattices if lattice.n_seen >= least), key=lambda lattice: -lattice.n_seen)


def _join(corners: XCorners, group: CornerGroup) -> tuple[Int[ndarray, "k"], Int[ndarray, "k 2"]]:
    """The group with corners beyond gaps in it: those that its homography puts on free cells, with the right colours.

    A shadow's border, or a blurred strip, breaks the links between two parts of one board. At most two cells are
    bridged at a time, so that the lens's distortion stays within the fifth of a cell that is allowed.
    """
    members, cells, turns = group.members, group.cells, group.turns
    extent = np.ptp(cells, axis=0) + 1
    if len(members) < MIN_TO_JOIN or extent.min() < 3:
        return members, cells
    parity_of_first = (turns[0] + cells[0].sum()) % 2  # of ray 0's turn at even cells
    is_free = np.ones(len(corners), bool)
    is_free[members] = False
    for _ in range(4):
        H = fit_homography(cells.astype(float), corners.points_px[members].astype(float))
        free = np.nonzero(is_free)[0]
        if len(free) == 0 or not np.isfinite(H).all():
            break
        points = corners.points_px[free].astype(float)
        back = np.linalg.inv(H)
        homogeneous = points @ back[:, :2].T + back[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            uv = homogeneous[:, :2] / homogeneous[:, 2:]
        side = (cells @ H[2, :2] + H[2, 2]).mean()
        near = np.rint(np.clip(np.nan_to_num(uv, nan=1e6, posinf=1e6, neginf=-1e6), -1e6, 1e6))
        is_near = (np.abs(uv - near) < 0.2).all(axis=1) & (homogeneous[:, 2] * side > 0)
        is_near &= ((near >= cells.min(axis=0) - 2) & (near <= cells.max(axis=0) + 2)).all(axis=1)
        # The direction of the step to the next column, from the homography's derivative.
        w = near @ H[2, :2] + H[2, 2]
        step = H[:2, 0] - points * H[2, 0]
        heading = np.arctan2(step[:, 1] * np.sign(w), step[:, 0] * np.sign(w))
        turn = np.abs(_wrap(heading[:, None] - corners.rays_rad[free]))
        ray = turn.argmin(axis=1)
        is_near &= (turn.min(axis=1) < MAX_TURN_RAD) & ((ray + near.sum(axis=1)) % 2 == parity_of_first)
        new, places = free[is_near], near[is_near].astype(int)
        taken = {tuple(cell) for cell in cells.tolist()}
        chosen = [i for i, cell in enumerate(map(tuple, places.tolist())) if cell not in taken and not taken.add(cell)]
        if not chosen:
            break
        members, cells = np.r_[members, new[chosen]], np.concatenate([cells, places[chosen]])
        is_free[new[chosen]] = False
    return members, cells


def _fill(saddles: SaddleImage, grid: ndarray, is_bright_first: bool, *, least: int = 2) -> ndarray:
    """The grid with holes filled where it predicts corners: half the contrast will do, most edges must be seen."""
    for _ in range(3):
        if np.isfinite(grid[..., 0]).all():
            break
        predicted, spacing = predict_missing(grid[..., :2], least=least)
        rows, columns = np.nonzero(np.isfinite(predicted[..., 0]))
        if len(rows) == 0:
            break
        trial = grid.copy()
        trial[rows, columns] = _search(saddles, predicted[rows, columns], spacing[rows, columns])
        along_row, along_column = _see_edges(saddles.smooth, trial, is_bright_first)
        is_found = np.isfinite(trial[..., 0]) & ~np.isfinite(grid[..., 0])
        is_found &= _count_neighbours(along_row, along_column, 1) > _count_neighbours(along_row, along_column, -1)
        if not is_found.any():
            break
        grid = np.where(is_found[..., None], trial, grid)
    return grid


def _extend(saddles: SaddleImage, grid: ndarray, is_bright_first: bool, size: tuple[int, int]) -> tuple[ndarray, bool]:
    """The grid with weak border rows and columns added, as long as it stays within ``size`` (larger number first)."""
    while True:
        best_share, best = 0.0, None
        for side in range(4):  # top, bottom, left, right
            columns, rows = grid.shape[1] + (side >= 2), grid.shape[0] + (side < 2)
            if max(columns, rows) > size[0] or min(columns, rows) > size[1]:
                continue
            pad = [(0, 0), (0, 0), (0, 0)]
            pad[side // 2] = (1, 0) if side % 2 == 0 else (0, 1)
            trial = np.pad(grid, pad, constant_values=np.nan)
            is_bright = is_bright_first ^ (side % 2 == 0)
            trial = _fill(saddles, trial, is_bright, least=1)
            share = _border_shares(saddles.smooth, trial, is_bright)[side]
            if share > best_share:
                best_share, best = share, (trial, is_bright)
        if best is None or best_share < MIN_BORDER_SHARE:
            return grid, is_bright_first
        grid, is_bright_first = best


def _see_edges(
    smooth: ndarray, grid: ndarray, is_bright_first: bool
) -> tuple[Int[ndarray, "r c-1"], Int[ndarray, "r-1 c"]]:
    """Edges between neighbours along rows and along columns: 1 seen, -1 not seen, 0 an end is missing."""
    rows, columns = grid.shape[:2]
    parity = np.where((np.add.outer(np.arange(rows), np.arange(columns)) % 2 == 0) == is_bright_first, 1.0, -1.0)
    edges = []
    for start, end, turn in ((grid[:, :-1], grid[:, 1:], 1.0), (grid[:-1], grid[1:], -1.0)):
        sign = turn * parity[: start.shape[0], : start.shape[1]]
        is_whole = np.isfinite(start[..., 0]) & np.isfinite(end[..., 0])
        a, b = start[is_whole], end[is_whole]
        way = b[:, :2] - a[:, :2]
        is_seen = images.follow_edges(smooth, a[:, :2], way, sign[is_whole], np.minimum(a[:, 2], b[:, 2]))
        edge = np.zeros(is_whole.shape, int)
        edge[is_whole] = np.where(is_seen, 1, -1)
        edges.append(edge)
    return edges[0], edges[1]


def _count_neighbours(along_row: ndarray, along_column: ndarray, value: int) -> Int[ndarray, "r c"]:
    """How many edges of ``value`` end at each corner."""
    count = np.zeros((along_row.shape[0], along_column.shape[1]), int)
    count[:, :-1] += along_row == value
    count[:, 1:] += along_row == value
    count[:-1] += along_column == value
    count[1:] += along_column == value
    return count


def predict_missing(
    grid: Float[ndarray, "rows columns 2"], *, least: int = 2
) -> tuple[Float[ndarray, "rows columns 2"], Float[ndarray, "rows columns"]]:
    """Where a missing corner should be, by straight continuation of its row and column.

    NaN where present or unpredictable.
    """
    rows, columns = grid.shape[:2]
    padded = np.pad(grid, ((2, 2), (2, 2), (0, 0)), constant_values=np.nan)
    core = (slice(2, rows + 2), slice(2, columns + 2))

    def shifted(dy: int, dx: int) -> ndarray:
        return padded[2 + dy : rows + 2 + dy, 2 + dx : columns + 2 + dx]

    guesses, steps = [], []
    for dy, dx in ((0, 1), (1, 0)):
        before, after = shifted(-dy, -dx), shifted(dy, dx)
        guesses.append(0.5 * (before + after))
        steps.append(np.linalg.norm(after - before, axis=-1) / 2)
        for sign in (1, -1):
            near, far = shifted(sign * dy, sign * dx), shifted(2 * sign * dy, 2 * sign * dx)
            guesses.append(2 * near - far)
            steps.append(np.linalg.norm(near - far, axis=-1))
    guess, step = np.stack(guesses), np.stack(steps)
    usable = np.isfinite(step)
    count = usable.sum(axis=0)
    with np.errstate(invalid="ignore"):
        mean = np.where(usable[..., None], guess, 0).sum(axis=0) / count[..., None]
        spread = np.where(usable, np.linalg.norm(guess - mean, axis=-1), 0).max(axis=0)
    spacing = np.where(usable, step, np.inf).min(axis=0)
    is_open = ~np.isfinite(padded[core][..., 0]) & (count >= least)
    with np.errstate(invalid="ignore"):
        is_open &= spread < 0.5 * spacing
    return np.where(is_open[..., None], mean, np.nan), spacing


def _search(saddles: SaddleImage, predicted: ndarray, spacing: ndarray) -> Float[ndarray, "n 3"]:
    """The X-corner (x, y, contrast) at the strongest saddle within 0.25 spacings of each prediction, or NaN."""
    height, width = saddles.response.shape
    rim = int(np.ceil(saddles.radius_px)) + 1
    reach = np.maximum(1, np.rint(0.25 * spacing)).astype(int)
    step = np.arange(-reach.max(), reach.max() + 1)
    at = np.rint(predicted).astype(int)
    columns, rows = at[:, :1] + step, at[:, 1:] + step
    is_far = np.abs(step) > reach[:, None]
    is_column = ~is_far & (columns >= rim) & (columns < width - rim)
    is_row = ~is_far & (rows >= rim) & (rows < height - rim)
    columns, rows = np.clip(columns, 0, width - 1), np.clip(rows, 0, height - 1)
    window = saddles.response[rows[:, :, None], columns[:, None, :]]
    window = np.where(is_row[:, :, None] & is_column[:, None, :], window, 0).reshape(len(at), -1)
    best = window.argmax(axis=1)
    each = np.arange(len(at))
    index = np.nonzero(window[each, best] > 0)[0]
    row, column = np.divmod(best[index], len(step))
    centres = np.stack([columns[index, column], rows[index, row]], axis=-1)
    found = np.full((len(predicted), 3), np.nan)
    is_corner, _, contrast = read_rings(
        saddles.smooth, centres, saddles.radius_px, min_contrast_dn=3.0, max_unlikeness=0.6
    )
    found[index[is_corner], :2] = centres[is_corner]
    found[index[is_corner], 2] = contrast[is_corner]
    return found


def _trim(smooth: ndarray, grid: ndarray, is_bright_first: bool) -> tuple[ndarray, bool]:
    """The grid without border rows and columns that are not the board's."""
    while min(grid.shape[:2]) > 2:
        shares = _border_shares(smooth, grid, is_bright_first)
        worst = int(np.argmin(shares))
        if shares[worst] >= MIN_BORDER_SHARE:
            break
        grid = (grid[1:], grid[:-1], grid[:, 1:], grid[:, :-1])[worst]
        is_bright_first ^= worst in (0, 2)
    return grid, is_bright_first


def _border_shares(smooth: ndarray, grid: ndarray, is_bright_first: bool) -> list[float]:
    """Share of edges seen along the top, bottom, left and right border row; 1 where none is missing between two corners.

    0 where half of the row's corners is missing, or where the step to it breaks with the step before it.
    """
    along_row, along_column = _see_edges(smooth, grid, is_bright_first)
    shares = []
    for turned, edges in (
        (grid, along_row[0]),
        (grid[::-1], along_row[-1]),
        (grid.transpose(1, 0, 2), along_column[:, 0]),
        (grid.transpose(1, 0, 2)[::-1], along_column[:, -1]),
    ):
        seen, known = np.count_nonzero(edges > 0), np.count_nonzero(edges)
        share = 1.0 if seen == known >= 0.4 * len(edges) else seen / len(edges)
        if np.isfinite(turned[0, :, 0]).mean() < 0.5 or _step_break(turned[..., :2]) > MAX_STEP_BREAK:
            share = 0.0
        shares.append(share)
    return shares


def _step_break(grid: ndarray) -> float:
    """How far the first row is from the straight continuation of the next two, in steps (median).

    0 where it cannot be told.
    """
    if len(grid) < 3:
        return 0.0
    step = grid[1] - grid[2]
    off = np.linalg.norm(grid[0] - grid[1] - step, axis=-1) / np.maximum(np.linalg.norm(step, axis=-1), 1e-9)
    return float(np.median(off[np.isfinite(off)])) if np.isfinite(off).any() else 0.0


def continues_beyond(saddles: SaddleImage, corners: XCorners, lattice: Lattice) -> bool:
    """Whether the lattice goes on beyond one of its borders: the printed board is larger than the lattice.

    A row counts where every corner and every edge of it is seen, with the lattice's own contrast; margins that are
    thinner than the blur let some outer corners of a board look like X-corners (shares of 0.9, or contrasts of 0.5 or
    1.6, on real boards).
    """
    contrast = np.where(np.isfinite(lattice.points_px[..., :1]), lattice.contrast_dn, np.nan)
    grid = np.concatenate([lattice.points_px, contrast], axis=-1)
    for side in _sides_to_try(corners, lattice.points_px):
        pad = [(0, 0), (0, 0), (0, 0)]
        pad[side // 2] = (1, 0) if side % 2 == 0 else (0, 1)
        is_bright = (not lattice.is_dark_first) ^ (side % 2 == 0)
        trial = _fill(saddles, np.pad(grid, pad, constant_values=np.nan), is_bright, least=1)
        line = (trial[0], trial[-1], trial[:, 0], trial[:, -1])[side]
        ratio = line[:, 2] / lattice.contrast_dn
        is_alike = bool(np.all((ratio > 0.65) & (ratio < 1.5)))  # False where a corner is missing
        if is_alike and _border_shares(saddles.smooth, trial, is_bright)[side] == 1:
            return True
    return False


def _sides_to_try(corners: XCorners, grid: Float[ndarray, "rows columns 2"]) -> list[int]:
    """The sides (top, bottom, left, right) beyond which half of the next row's corners are among the ``corners``."""
    if len(corners) == 0:
        return []
    lines = ((grid[0], grid[1]), (grid[-1], grid[-2]), (grid[:, 0], grid[:, 1]), (grid[:, -1], grid[:, -2]))
    near, far = (np.concatenate(points) for points in zip(*lines, strict=True))
    step = near - far
    x, y = (near + step).T
    off2 = ((x[:, None] - corners.points_px[:, 0]) ** 2 + (y[:, None] - corners.points_px[:, 1]) ** 2).min(axis=1)
    length2 = step[:, 0] ** 2 + step[:, 1] ** 2
    votes = np.where(np.isfinite(length2), np.where(off2 < 0.3**2 * length2, 1, -1), 0)
    ends = np.cumsum([len(points) for points, _ in lines])
    return [side for side, of_line in enumerate(np.split(votes, ends[:-1])) if of_line.sum() >= 0]
