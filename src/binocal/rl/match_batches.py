"""Simulated sets of matches on which the agent for streets trains and is evaluated: rays, truth, starts, what may be reached.

A case is a set of matches of one pair, many of them wrong, seen by cameras whose intrinsics are known; an episode starts at an old
rig, which is the true one turned by an angle that is drawn anew every time.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy import ndarray

from binocal.rl.epipolar_task import FOUND_REWARD, N_STEPS
from binocal.rl.task import Judgement, TaskState
from binocal.shapes import Bool, Float
from binocal.solvers.arrays import SHARED, take_rigs
from binocal.solvers.epipolar import EpipolarProblem, EpipolarState, RelativePose, descend

FOUND_SIGMA = 3.0
"""Root mean square over the five unknowns, in standard deviations of the Cramér-Rao bound of the right matches."""
POLISH_PX = (1.0,) * 8
"""The common end of every solve that is compared: the kernel of one pixel."""


@dataclass(frozen=True, slots=True)
class StartDistribution:
    """Angles of an old rig from the truth about any axis, and of its direction of T; uniform."""

    turn_deg: tuple[float, float]
    direction_deg: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class MatchBatch:
    """Sets of matches of one family, filled up to the same number.

    ``optimum`` is where a solve ends that starts at the truth. ``whitening`` turns a step from the truth into standard deviations of the bound.
    """

    starts: StartDistribution = field(metadata=SHARED)
    problem: EpipolarProblem
    truth: RelativePose
    optimum: RelativePose
    whitening: Float[ndarray, "cases 5 5"]

    @property
    def n_rigs(self) -> int:
        """Sets of the batch, each of a rig of its own."""
        return len(self.whitening)

    def select(self, index: ndarray) -> MatchBatch:
        """Those sets."""
        return take_rigs(self, index)


def solved_matches(
    starts: StartDistribution,
    problem: EpipolarProblem,
    truth: RelativePose,
    is_right: Bool[ndarray, "cases n"],
    noise_px: Float[ndarray, "cases"],
) -> MatchBatch:
    """The batch of a problem whose truth is known, with the bound of its right matches."""
    at_truth = problem.linearize(truth, noise_px, "squared")
    J = at_truth.jacobian * is_right[..., None] / noise_px[:, None, None]
    information = J.swapaxes(-1, -2) @ J
    whitening = np.linalg.cholesky(information).swapaxes(-1, -2)
    return MatchBatch(starts, problem, truth, polished(problem, truth), whitening)


def polished(problem: EpipolarProblem, estimate: RelativePose) -> RelativePose:
    """The minimum of the cost under a kernel of one pixel that lies next."""
    return descend(problem, estimate, POLISH_PX)


def sample_starts(matches: MatchBatch, rng: np.random.Generator) -> RelativePose:
    """An old rig for each set."""
    n, starts = matches.n_rigs, matches.starts
    axis = rng.standard_normal((n, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    turn = np.radians(rng.uniform(*starts.turn_deg, (n, 1))) * axis
    angle = rng.uniform(0, 2 * np.pi, n)
    about = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    direction = np.radians(rng.uniform(*starts.direction_deg, (n, 1))) * about
    return matches.truth.stepped(np.concatenate([turn, direction], axis=1))


def distance_sigma(
    matches: MatchBatch, goal: RelativePose, estimate: RelativePose
) -> Float[ndarray, "cases"]:
    """Distance between poses in standard deviations of the bound, root mean square over the five unknowns."""
    xi = goal.step_to(estimate)
    return np.linalg.norm((matches.whitening @ xi[..., None])[..., 0], axis=-1) / np.sqrt(5)


def remaining_sigma(matches: MatchBatch, loop: EpipolarState) -> Float[ndarray, "cases"]:
    """What is left to where a start at the truth ends."""
    return distance_sigma(matches, matches.optimum, loop.estimate)


def has_found(
    matches: MatchBatch, estimate: RelativePose, tolerance_sigma: float = FOUND_SIGMA
) -> Bool[ndarray, "cases"]:
    """Where polishing leads to within the tolerance of the truth."""
    return distance_sigma(matches, matches.truth, polished(matches.problem, estimate)) < tolerance_sigma


def judge(
    matches: MatchBatch, before_sigma: Float[ndarray, "cases"], state: TaskState, tolerance_sigma: float
) -> Judgement:
    """The fall of the log distance to the optimum of the right matches' basin; a reward for ending in it.

    Distances below 1 count as 1. An episode ends after twelve steps; it has arrived where polishing leads to within
    ``tolerance_sigma`` of the truth.
    """
    sigma = remaining_sigma(matches, state.loop)
    earned = np.log10(np.maximum(before_sigma, 1.0) / np.maximum(sigma, 1.0))
    is_over = state.n_steps >= N_STEPS
    has_arrived = np.zeros(is_over.shape, dtype=bool)
    if is_over.any():
        has_arrived = is_over & has_found(matches, state.loop.estimate, tolerance_sigma)
        earned = earned + FOUND_REWARD * has_arrived
    return Judgement(sigma, earned, is_over, has_arrived)
