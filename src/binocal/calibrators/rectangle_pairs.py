"""Pairs of ``rectangles`` solved one after the other, and the corners' noise that their residuals tell."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from binocal.cameras import StereoRig
from binocal.evidence.rectangles import RectanglePairs
from binocal.solvers.turning_cameras import PairSolve, Rectangle, solve_pair

ASSUMED_NOISE_PX = 0.3  # of a corner, to begin with
NOISE_ROUNDS = 3
LEAST_NOISE_PX = 1e-3
MOST_CHI2 = 8.0  # over the freedom: a pair beyond does not show what it should; the worst of 1200 good ones had 2.9

Solves = list[PairSolve | None]


def settle(
    rig: StereoRig, pairs: RectanglePairs, stated_noise_px: float | None, check_stop: Callable[[], None]
) -> tuple[float, Solves]:
    """The noise of a corner's coordinate, pixels, as stated or as the pairs tell it, and every pair solved with it."""
    noise_px = stated_noise_px or ASSUMED_NOISE_PX
    solves = follow(rig, pairs, noise_px)
    for _ in range(0 if stated_noise_px else NOISE_ROUNDS):
        check_stop()
        noise_px = left_noise_px(solves)
        solves = follow(rig, pairs, noise_px, solves)
    check_stop()
    return noise_px, solves


def follow(rig: StereoRig, pairs: RectanglePairs, noise_px: float, near: Sequence[PairSolve | None] = ()) -> Solves:
    """Every pair solved in its turn, each rectangle known from the pairs before; None where a pair has no solution.

    A pair that does not fit says nothing of its rectangle. ``near`` are solves of nearly the same pairs to start from.
    """
    known: dict[int, Rectangle] = {}
    solves: Solves = []
    for i, number in enumerate(pairs.rectangle.tolist()):
        solve = solve_pair(
            rig,
            np.stack([pairs.left_px[i], pairs.right_px[i]]),
            np.stack([pairs.left_attitude_rad[i], pairs.right_attitude_rad[i]]),
            float(pairs.attitude_sigma_rad[i]),
            noise_px,
            known.get(number),
            near[i] if near else None,
        )
        solves.append(solve)
        if solve is not None and is_fitting(solve):
            known[number] = solve.rectangle
    return solves


def is_fitting(solve: PairSolve | None) -> bool:
    """Whether corners, attitudes and rectangle agree within what their standard deviations allow."""
    return solve is not None and solve.chi2 < MOST_CHI2 * solve.freedom


def left_noise_px(solves: Sequence[PairSolve | None]) -> float:
    """Standard deviation of a coordinate from what all pairs leave; their median, so that a bad pair has no say."""
    ratios = [float(np.sum(s.residuals_px**2)) / s.pixel_freedom for s in solves if s is not None]
    if not ratios:
        return ASSUMED_NOISE_PX
    good = [
        s
        for s, ratio in zip((s for s in solves if s is not None), ratios, strict=True)
        if ratio < 9 * np.median(ratios)
    ]
    total = sum(float(np.sum(s.residuals_px**2)) for s in good) / sum(s.pixel_freedom for s in good)
    return max(float(np.sqrt(total)), LEAST_NOISE_PX)
