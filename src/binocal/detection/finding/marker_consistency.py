"""Measured corners of a lattice that those around them contradict: beside a hand, in glare, on another saddle than the board's."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.detection.finding.crossings import median_of
from binocal.detection.finding.marker_grid import MarkerGrid
from binocal.kernels.marker_grids import FieldLens, predict_each
from binocal.shapes import Bool, Float

# Limits of a corner's distance from where its neighbours put it: in medians of all such distances, in steps of the lattice, which
# a lens, a bent board and noise have their part in; in its own sigmas; and at least. The lattice's rim is extrapolated.
MOST_MEDIANS, MOST_SIGMAS, LEAST_PX, RIM_FACTOR = 6.0, 4.0, 0.3, 2.5
LEAST_MEDIAN_PX = 0.02
# Where half of the corners are off by more steps, and pixels, none is right: the blur has merged them with their markers (from 1.3
# margins on; cornerSubPix is then off by up to 8 px). Sharp real boards have up to 0.02 steps, blurred ones that are right 0.008.
MOST_SCATTER, MOST_SCATTER_BLURRED, MOST_SCATTER_PX = 0.04, 0.01, 0.5
MOST_ROUNDS = 8
REACH = 2  # lines: of corners that contradict each other the worst goes first, for the others may be right without it


def find_inconsistent(
    grid: MarkerGrid,
    lens: FieldLens,
    points_px: Float[ndarray, "n 2"],
    covariance_px2: Float[ndarray, "n 2 2"],
    step_px: Float[ndarray, "n"],
    *,
    is_blurred: bool = False,
) -> Bool[ndarray, "n"]:
    """Which of the board's points, in its own order, lie elsewhere than their neighbours put them.

    ``step_px`` is the shorter side of a marker's face at each; ``is_blurred`` says that markers were read through much blur.
    """
    known = points_px[grid.points].copy()
    sigma = np.sqrt(0.5 * np.trace(covariance_px2, axis1=1, axis2=2))[grid.points]
    step = step_px[grid.points]
    most = MOST_SCATTER_BLURRED if is_blurred else MOST_SCATTER
    is_wrong = np.zeros(known.shape[:2], bool)
    for _ in range(MOST_ROUNDS):
        off = np.linalg.norm(predict_each(grid.lines, known, lens, _trust(sigma)) - known, axis=-1)
        is_told = np.isfinite(off)
        if not is_told.any():
            break
        median = median_of((off / step)[is_told])
        if median_of((off / np.maximum(most * step, MOST_SCATTER_PX))[is_told]) > 1:
            return np.isfinite(points_px[:, 0])
        factor = np.where(_is_rim(np.isfinite(known[..., 0])), RIM_FACTOR, 1.0)
        ratio = np.nan_to_num(off / (np.maximum(factor * MOST_MEDIANS * median * step, LEAST_PX) + MOST_SIGMAS * sigma))
        rows, columns = np.nonzero(ratio > 1)
        worst = [
            (r, c)
            for r, c in zip(rows, columns, strict=True)
            if ratio[r, c] >= ratio[max(r - REACH, 0) : r + REACH + 1, max(c - REACH, 0) : c + REACH + 1].max()
        ]
        if not worst:
            break
        for place in worst:
            is_wrong[place] = True
            known[place] = np.nan
    found = np.zeros(len(points_px), bool)
    found[grid.points] = is_wrong
    return found


def _is_rim(is_known: Bool[ndarray, "rows columns"]) -> Bool[ndarray, "rows columns"]:
    """Corners that have no known one beyond them on some side."""
    padded = np.pad(is_known, 1)
    return ~(padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:])


def _trust(sigma: Float[ndarray, "rows columns"]) -> Float[ndarray, "rows columns"]:
    """Weights: corners that are known ten times worse than most say little of their neighbours."""
    known = np.where(np.isfinite(sigma), sigma, 0)
    typical = max(median_of(known[known > 0]), LEAST_MEDIAN_PX) if (known > 0).any() else 1.0
    return typical**2 / (typical**2 + known**2)
