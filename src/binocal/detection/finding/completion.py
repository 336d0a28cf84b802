"""A grid completed and bounded by its edges: holes filled, weak border lines added, foreign ones taken off."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.detection.finding.grid import SIDES, add_line, is_before
from binocal.detection.finding.xcorners import WEAK_CONTRAST_DN, WEAK_UNLIKENESS, SaddleImage, read_rings
from binocal.kernels import images
from binocal.shapes import Float, Int

# A row of true corners has an edge between any two of them. Along the board's outer border only every second square
# differs from the margin, and chance corners of the clutter have no edges at all: 0.7 parts them.
MIN_BORDER_SHARE = 0.7
# Perspective and fisheye lenses change the step from one row to the next by up to 0.2; margins narrower than a square
# by more.
MAX_STEP_BREAK = 0.28
MIN_SHARE_OF_BORDER = 0.5  # of a border line's corners, else it is taken off; half of a line says where the rest is
MIN_SHARE_TO_TELL = 0.4  # of a border line's edges that must be known before "none is missing" counts as whole
MAX_SPREAD = 0.5  # of the spacing, between the predictions of one hole by its row and its column
SEARCH_REACH = 0.25  # of the spacing, about a prediction
MAX_FILLS = 3  # rounds; a hole three cells wide is filled from its rim


def fill_holes(saddles: SaddleImage, grid: ndarray, is_bright_first: bool, *, least: int = 2) -> ndarray:
    """The grid with holes filled where it predicts corners: half the contrast will do, most edges must be seen."""
    for _ in range(MAX_FILLS):
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


def extend_to(
    saddles: SaddleImage, grid: ndarray, is_bright_first: bool, size: tuple[int, int]
) -> tuple[ndarray, bool]:
    """The grid with weak border rows and columns added, as long as it stays within ``size`` (larger number first)."""
    while True:
        best_share, best = 0.0, None
        for side in SIDES:
            columns, rows = grid.shape[1] + (side >= 2), grid.shape[0] + (side < 2)
            if max(columns, rows) > size[0] or min(columns, rows) > size[1]:
                continue
            is_bright = is_bright_first ^ is_before(side)
            trial = fill_holes(saddles, add_line(grid, side), is_bright, least=1)
            share = border_shares(saddles.smooth, trial, is_bright)[side]
            if share > best_share:
                best_share, best = share, (trial, is_bright)
        if best is None or best_share < MIN_BORDER_SHARE:
            return grid, is_bright_first
        grid, is_bright_first = best


def _see_edges(
    smooth: ndarray, grid: ndarray, is_bright_first: bool
) -> tuple[Int[ndarray, "rows gaps_in_row"], Int[ndarray, "gaps_in_column columns"]]:
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
        is_open &= spread < MAX_SPREAD * spacing
    return np.where(is_open[..., None], mean, np.nan), spacing


def _search(saddles: SaddleImage, predicted: ndarray, spacing: ndarray) -> Float[ndarray, "n 3"]:
    """The X-corner (x, y, contrast) at the strongest saddle within SEARCH_REACH spacings of each prediction, or NaN."""
    height, width = saddles.response.shape
    rim = int(np.ceil(saddles.radius_px)) + 1
    reach = np.maximum(1, np.rint(SEARCH_REACH * spacing)).astype(int)
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
    centres = np.stack([columns[index, column], rows[index, row]], axis=-1).astype(float)
    found = np.full((len(predicted), 3), np.nan)
    is_corner, _, contrast = read_rings(
        saddles.smooth, centres, saddles.radius_px, min_contrast_dn=WEAK_CONTRAST_DN, max_unlikeness=WEAK_UNLIKENESS
    )
    found[index[is_corner], :2] = centres[is_corner]
    found[index[is_corner], 2] = contrast[is_corner]
    return found


def trim_borders(smooth: ndarray, grid: ndarray, is_bright_first: bool) -> tuple[ndarray, bool]:
    """The grid without border rows and columns that are not the board's."""
    while min(grid.shape[:2]) > 2:
        shares = border_shares(smooth, grid, is_bright_first)
        worst = int(np.argmin(shares))
        if shares[worst] >= MIN_BORDER_SHARE:
            break
        grid = (grid[1:], grid[:-1], grid[:, 1:], grid[:, :-1])[worst]
        is_bright_first ^= worst in (0, 2)
    return grid, is_bright_first


def border_shares(smooth: ndarray, grid: ndarray, is_bright_first: bool) -> list[float]:
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
        share = 1.0 if seen == known >= MIN_SHARE_TO_TELL * len(edges) else seen / len(edges)
        if np.isfinite(turned[0, :, 0]).mean() < MIN_SHARE_OF_BORDER or _step_break(turned[..., :2]) > MAX_STEP_BREAK:
            share = 0.0
        shares.append(share)
    return shares


def _step_break(grid: ndarray) -> float:
    """How far the first row is from the straight continuation of the next two, in steps (median).

    0 where too few corners are seen to say so.
    """
    if len(grid) < 3:
        return 0.0
    step = grid[1] - grid[2]
    off = np.linalg.norm(grid[0] - grid[1] - step, axis=-1) / np.maximum(np.linalg.norm(step, axis=-1), 1e-9)
    return float(np.median(off[np.isfinite(off)])) if np.isfinite(off).any() else 0.0
