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
from binocal.simulation.matches import MatchDistribution, sample_match_problems
from binocal.solvers.arrays import SHARED, take_rigs
from binocal.solvers.epipolar import EpipolarProblem, Rays
from binocal.solvers.epipolar_descent import EpipolarState, descend
from binocal.solvers.portfolio import POLISH_PX
from binocal.solvers.relative_pose import RelativePose

FOUND_SIGMA = 3.0  # root mean square over the five unknowns


@dataclass(frozen=True, slots=True)
class MatchSet:
    """Match problems and old rigs for them: angles from the truth about any axis, and of the direction of T; uniform."""

    matches: MatchDistribution
    turn_deg: tuple[float, float]
    direction_deg: tuple[float, float]

    @property
    def bounds_deg(self) -> tuple[float, float]:
        """Turn and turn of the direction of T that a result may be away from the old rig, a tenth and a fifth more than it is."""
        return 1.1 * self.turn_deg[1], 1.2 * self.direction_deg[1]


_NOISE_PX = (0.2, 1.0)

MATCH_SETS: dict[str, MatchSet] = {
    "drift_easy": MatchSet(
        MatchDistribution(noise_px=_NOISE_PX, n_matches=(100, 300), wrong_share=(0.1, 0.4)), (0.0, 5.0), (0.0, 5.0)
    ),
    "drift_hard": MatchSet(
        MatchDistribution(noise_px=_NOISE_PX, n_matches=(100, 300), wrong_share=(0.5, 0.8)), (0.0, 5.0), (0.0, 5.0)
    ),
    "mid": MatchSet(
        MatchDistribution(noise_px=_NOISE_PX, n_matches=(100, 300), wrong_share=(0.3, 0.7)), (5.0, 20.0), (0.0, 20.0)
    ),
    "unseen": MatchSet(
        MatchDistribution(focal_px=(250.0, 2400.0), noise_px=_NOISE_PX, n_matches=(80, 500), wrong_share=(0.6, 0.85)),
        (2.0, 15.0),
        (2.0, 15.0),
    ),
}
"""The sets on which every controller is evaluated; nothing trains on ``unseen``, which has more wrong matches and other lenses."""


@dataclass(frozen=True, slots=True, eq=False)
class MatchBatch:
    """Sets of matches, filled up to the same number.

    ``optimum`` is where a solve ends that starts at the truth. ``whitening`` turns a step from the truth into standard deviations of
    the Cramér-Rao bound of the right matches.
    """

    options: MatchSet = field(metadata=SHARED)
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


def sample_matches(options: MatchSet, n: int, rng: np.random.Generator) -> MatchBatch:
    """Sets of matches of a distribution, each solved from the truth."""
    drawn = sample_match_problems(options.matches, n, rng)
    left = _pinhole_rays(drawn.left_parameters, drawn.left_px)
    right = _pinhole_rays(drawn.right_parameters, drawn.right_px)
    problem = EpipolarProblem(left, right, drawn.is_present.astype(float), 1.0)
    truth = RelativePose.of(drawn.T_right_left)
    J = problem.linearize(truth, drawn.noise_px, "squared").jacobian * drawn.is_right[..., None]
    H = J.swapaxes(-1, -2) @ J / drawn.noise_px[:, None, None] ** 2
    size = np.sqrt(np.maximum(np.diagonal(H, axis1=-2, axis2=-1), 1e-300))
    scaled = H / (size[:, :, None] * size[:, None, :]) + 1e-12 * np.eye(5)
    whitening = np.linalg.cholesky(scaled).swapaxes(-1, -2) * size[:, None, :]
    return MatchBatch(options, problem, truth, polished(problem, truth), whitening)


def _pinhole_rays(parameters: Float[ndarray, "cases 9"], px: Float[ndarray, "cases n 2"]) -> Rays:
    """Unit rays of cameras without distortion and skew, and their derivatives by the pixels."""
    focal, centre = parameters[:, None, :2], parameters[:, None, 2:4]
    ahead = np.concatenate([(px - centre) / focal, np.ones((*px.shape[:-1], 1))], axis=-1)
    length = np.linalg.norm(ahead, axis=-1, keepdims=True)
    directions = ahead / length
    across = np.eye(3)[:, :2] - directions[..., :, None] * directions[..., None, :2]
    return Rays(directions, across / (focal[..., None, :] * length[..., None]))


def polished(problem: EpipolarProblem, estimate: RelativePose) -> RelativePose:
    """The minimum of the cost under a kernel of one pixel that lies next."""
    return descend(problem, estimate, POLISH_PX)


def sample_starts(matches: MatchBatch, rng: np.random.Generator) -> RelativePose:
    """An old rig for each set."""
    n, options = matches.n_rigs, matches.options
    axis = rng.standard_normal((n, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    turn = np.radians(rng.uniform(*options.turn_deg, (n, 1))) * axis
    angle = rng.uniform(0, 2 * np.pi, n)
    about = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    direction = np.radians(rng.uniform(*options.direction_deg, (n, 1))) * about
    return matches.truth.stepped(np.concatenate([turn, direction], axis=1))


def distance_sigma(matches: MatchBatch, goal: RelativePose, estimate: RelativePose) -> Float[ndarray, "cases"]:
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
