"""A rig watched over a stream: from the turns that pairs measured one by one to its drift, its jumps, and a verdict.

Errors that all pairs share (of the intrinsics, of a lens that its model does not follow) cancel in changes, so that jumps and the
rate of drift count the random part of each pair alone. Against the rig as it was, they do not: see :attr:`DriftTrack.level_sigma_deg`.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.findings import finding, refusal
from binocal.shapes import Float
from binocal.solvers.drift_filter import ALARM_LOG_ODDS, RATE_DEG_PER_HOUR, settled, start_filter, step_filter

MIN_MEASURED = 3
ASSUMED_INTERVAL_S = 0.1  # where no times are known: of a camera at 10 Hz
TOLD_RATE_SHARE = (
    0.5  # of what a rate is uncertain by before anything is measured, above which a stream does not tell it
)


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredTurn:
    """The turn of the rig that one pair, or some in a row, measured: pitch, yaw and roll with their random standard deviations.

    ``time_s`` is None where nothing says when.
    """

    name: str
    turn_deg: Float[ndarray, "3"]
    sigma_deg: Float[ndarray, "3"]
    time_s: float | None = None


@dataclass(frozen=True, slots=True)
class DriftJump:
    """A change of one angle (0 pitch, 1 yaw, 2 roll) at once: the first measurement after it, the one that told it, its size."""

    angle: int
    at: int
    told_at: int
    size_deg: float
    sigma_deg: float


@dataclass(frozen=True, slots=True, eq=False)
class DriftTrack:
    """The running estimate after each measurement, jumps, and the rate of drift.

    ``level_sigma_deg`` counts random errors that differ from pair to pair, as :class:`DriftJump` and the rate do; what pairs have
    in common comes on top. The rate is NaN where it is not told: too short a stream, or no times.
    """

    level_deg: Float[ndarray, "k 3"]
    level_sigma_deg: Float[ndarray, "k 3"]
    log_odds: Float[ndarray, "k 3"]
    jumps: tuple[DriftJump, ...]
    rate_deg_per_hour: Float[ndarray, "3"]
    rate_sigma_deg_per_hour: Float[ndarray, "3"]


def track_drift(turns: Sequence[MeasuredTurn]) -> DriftTrack:
    """The drift over a stream, by a filter of many hypotheses for each angle (:mod:`binocal.solvers.drift_filter`).

    Times that go back count as no time.

    Raises:
        DegenerateGeometryError: Too few measurements.
    """
    if len(turns) < MIN_MEASURED:
        raise refusal(finding("stream-too-few", n_told=len(turns), n_needed=MIN_MEASURED))
    state = start_filter(turns[0].turn_deg, turns[0].sigma_deg)
    levels, sigmas, odds = [turns[0].turn_deg], [turns[0].sigma_deg], [np.full(3, -np.inf)]
    jumps: list[DriftJump] = []
    for k, (before, turn) in enumerate(itertools.pairwise(turns), start=1):
        state = step_filter(state, turn.turn_deg, turn.sigma_deg, _elapsed_s(before, turn))
        mean, sigma = state.estimate
        levels.append(mean[:, 0])
        sigmas.append(sigma[:, 0])
        odds.append(state.log_odds)
        has_jumped = odds[-1] > ALARM_LOG_ODDS
        if has_jumped.any():
            for angle in np.flatnonzero(has_jumped):
                at = int(state.last_jump()[angle])
                size = float(levels[k][angle] - levels[at - 1][angle])
                size_sigma = float(np.hypot(sigmas[k][angle], sigmas[at - 1][angle]))
                jumps.append(DriftJump(int(angle), at, k, size, size_sigma))
            state = settled(state, has_jumped)
    mean, sigma = state.estimate
    has_times = all(turn.time_s is not None for turn in turns)
    is_told = has_times & (sigma[:, 1] < TOLD_RATE_SHARE * RATE_DEG_PER_HOUR)
    rate, rate_sigma = (np.where(is_told, values[:, 1], np.nan) for values in (mean, sigma))
    return DriftTrack(np.array(levels), np.array(sigmas), np.array(odds), tuple(jumps), rate, rate_sigma)


def _elapsed_s(before: MeasuredTurn, after: MeasuredTurn) -> float:
    if before.time_s is None or after.time_s is None:
        return ASSUMED_INTERVAL_S
    return max(after.time_s - before.time_s, 0.0)
