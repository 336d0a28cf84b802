"""Which minimum the pose from natural images is: many starts, of which the one wins that explains the matches best.

Wrong matches leave false minima, along the direction of the translation above all, which matches tell least. From an old rig the agent
leads and a portfolio of schedules follows (:mod:`binocal.calibrators.natural_solves`); the old rig also holds solves as a prior where
matches are silent, and further starts lie around it and around the best end. All ends compete by one cost, so that the result is never
worse than the portfolio's whatever the weights are. They look at the same few hundred matches, which tell the minimum as well as
thousands do. Without an old rig the agent is not asked: from an unknown start consensus of minimal sets finds twice as much.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.calibrators.natural_solves import AGENT, ONE_SCHEDULE, solves_of
from binocal.evidence.point_matches import PointMatches
from binocal.findings import finding, refusal
from binocal.geometry import SE3
from binocal.shapes import Bool, Float
from binocal.solvers.arrays import join_rigs, map_arrays, take_rigs
from binocal.solvers.epipolar import NOISE_FLOOR_PX, EpipolarProblem
from binocal.solvers.epipolar_covariance import covariance_of_noise
from binocal.solvers.epipolar_descent import NEAR_PX, EpipolarMinimum, descend, finish, steer
from binocal.solvers.portfolio import (
    OLD_RIG_DIRECTION_DEG,
    OLD_RIG_TURN_DEG,
    Led,
    cost_of_seen,
    is_near,
)
from binocal.solvers.relative_pose import PosePrior, RelativePose

MOST_MATCHES = 400  # that starts compete on; more tell the noise better, not the minimum
HELD_TURN_DEG, HELD_DIRECTION_DEG, LOOSE_DIRECTION_DEG = 5.0, 2.0, 4.0
"""Standard deviations of priors: of an old rig, and of the direction where starts lie around the best end."""
AROUND_OLD, AROUND_OLD_PX = ((6, 3.0), (12, 6.0)), (4.0, 2.0, 1.0, 0.5)
AROUND_BEST, AROUND_BEST_PX = ((6, 1.5), (7, 3.5)), (2.0, 1.0, 0.5)
"""Circles of starts about a direction of the translation, each so many at so many degrees, and how their kernel closes."""
AGREED_SHARE, AGREED_SIGMAS = 0.9, 0.1
"""Of the matches that an end must explain, and how near each other all solves from the old rig must end, for the search to stop."""
LEAST_NEAR = 8  # matches within a few pixels, for an end to be looked at
COMPARED_STEPS = 8  # under Tukey's kernel, before ends are compared
COMPARED_NOISE, MOST_COMPARED_PX = 1.5, 1.0
"""The kernel's scale for the comparison, over the least noise of all ends; match noise is known to lie below 1 px."""
MANY_SHARE = 0.5  # of the matches that the end which has most of them has, for an end's noise to count
EQUAL_COST = 0.05  # a tenth of one wrong match: the same minimum, reached by another way
OPEN_SIGMAS = 3.0
FAR_FITS, NEAR_SHARE = 0.6, 0.7
"""A pose far from the old rig that explains so much of all matches is the images', where the best near it explains so much less."""
OLD, AROUND_IT, MATCHES, AROUND_THE_BEST = "old rig", "around the old rig", "matches", "around the best"

Guess = Callable[[PointMatches], SE3 | None]


@dataclass(frozen=True, slots=True, eq=False)
class BestStart:
    """Where the kernel closed, from which start, and who led there (for the result's provenance)."""

    estimate: RelativePose
    start: str
    led_by: Mapping[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class _Ends:
    """Minima of one problem, a batch, and by which way each was reached."""

    names: tuple[str, ...]
    minima: EpipolarMinimum

    def and_also(self, more: _Ends | None) -> _Ends:
        return self if more is None else _Ends(self.names + more.names, join_rigs([self.minima, more.minima]))


def best_start(
    problem: EpipolarProblem,
    matches: PointMatches,
    old: SE3 | None,
    guess: Guess | None,
    rng: np.random.Generator,
    calibrator: str,
) -> BestStart:
    """The end that explains the matches best; ``guess`` is what matches alone give, and competes.

    Raises:
        InconsistentViewsError: No start leads to a pose that a handful of the matches agree with.
    """
    n = len(matches)
    some = problem if n <= MOST_MATCHES else problem.select(np.sort(rng.permutation(n)[:MOST_MATCHES]))
    solves = {} if old is None else solves_of(calibrator)
    old_pose = None if old is None else RelativePose.of(old)
    ends = _finished(some, _from_nothing(some) if old_pose is None else _led(some, old_pose, solves))
    if ends is None or old_pose is None or not _agree(ends, old_pose, len(solves)):
        guessed = guess(matches) if guess is not None else None
        ends = _searched(some, ends, old_pose, guessed, is_wide=calibrator != ONE_SCHEDULE)
    if ends is None:
        raise refusal(finding("matches-contradict", n_right=0, n_matches=n, noise_px=NEAR_PX))
    compared = _compared(some, ends, old_pose)
    won = ends.names[compared.best]
    start = won if old is None or won == MATCHES else OLD
    report = {"asked": AGENT in solves, "won": won, "n_matches": min(n, MOST_MATCHES)} | compared.report(ends.names)
    if old is None:
        report["reason"] = "no old rig"
    return BestStart(take_rigs(ends.minima.estimate, compared.best), start, report)


def _led(problem: EpipolarProblem, old: RelativePose, solves: Mapping[str, Led]) -> list[tuple[str, RelativePose]]:
    """Where the kernel closes from an old rig, whoever leads."""
    return [(name, _alone(steer(problem, old, led.controller, led.n_iterations))) for name, led in solves.items()]


def _agree(ends: _Ends, old: RelativePose, n_solves: int) -> bool:
    """Whether several solves led to one minimum near the old rig that explains most matches: nothing is left to search."""
    if not len(ends.names) == n_solves > 1 or not _is_near(old, ends.minima).all():
        return False
    weights = ends.minima.equations.weights
    if (weights > 0).mean(axis=-1).min() < AGREED_SHARE:
        return False
    first = take_rigs(ends.minima.estimate, 0)
    away = first.step_to(ends.minima.estimate)
    apart = np.einsum("ki,kij,kj->k", away, ends.minima.equations.information, away) / ends.minima.scale_px**2
    return bool(apart.max() < AGREED_SIGMAS**2)


def _searched(
    problem: EpipolarProblem, ends: _Ends | None, old: RelativePose | None, guessed: SE3 | None, *, is_wide: bool
) -> _Ends | None:
    """What the old rig holds and what lies around it, what matches alone give, and then what lies around the best of all."""
    closed: list[tuple[str, RelativePose]] = []
    if old is not None and is_wide:
        held = replace(problem, prior=_held(old, HELD_DIRECTION_DEG))
        closed.append((OLD, _alone(descend(held, old))))
        closed.append((AROUND_IT, descend(held, _around(old, AROUND_OLD), AROUND_OLD_PX)))
    if guessed is not None:
        closed.append((MATCHES, _alone(descend(problem, RelativePose.of(guessed)))))
    more = _finished(problem, closed) if closed else None
    ends = more if ends is None else ends.and_also(more)
    if ends is None or not is_wide:
        return ends
    best = take_rigs(ends.minima.estimate, _compared(problem, ends, old).best)
    held = replace(problem, prior=_held(best, LOOSE_DIRECTION_DEG))
    around = _finished(problem, [(AROUND_THE_BEST, descend(held, _around(best, AROUND_BEST), AROUND_BEST_PX))])
    return ends.and_also(around)


def _from_nothing(problem: EpipolarProblem) -> list[tuple[str, RelativePose]]:
    """Where it closes from guesses of which none is known to be near."""
    guesses = {"side by side": [-1.0, 0.0, 0.0], "one above the other": [0.0, -1.0, 0.0]}
    return [(name, _alone(descend(problem, RelativePose(np.eye(3), np.array(t))))) for name, t in guesses.items()]


def _finished(problem: EpipolarProblem, closed: Sequence[tuple[str, RelativePose]]) -> _Ends | None:
    """The minima there; None where no end has a handful of matches near."""
    poses = join_rigs([pose for _, pose in closed])
    names = np.array([name for name, pose in closed for _ in pose.t])
    has_some = (np.abs(problem.residuals_px(poses)) < NEAR_PX).sum(axis=-1) >= LEAST_NEAR
    if not has_some.any():
        return None
    minima = finish(problem, take_rigs(poses, np.flatnonzero(has_some)), max_iterations=COMPARED_STEPS)
    return _Ends(tuple(names[has_some].tolist()), minima)


@dataclass(frozen=True, slots=True, eq=False)
class _Compared:
    """What ends cost, in squares of a kernel's scale."""

    costs: Float[ndarray, "k"]
    scale_px: float

    @property
    def is_best(self) -> Bool[ndarray, "k"]:
        """Which have the lowest cost."""
        return np.asarray(self.costs <= self.costs.min() + EQUAL_COST)

    @property
    def best(self) -> int:
        """The first of them."""
        return int(np.argmax(self.is_best))

    def report(self, names: Sequence[str]) -> dict[str, Any]:
        """The least cost of each way, and how many ways lead to the best."""
        least: dict[str, float] = {}
        for name, cost in zip(names, self.costs.tolist(), strict=True):
            least[name] = min(cost, least.get(name, np.inf))
        agreeing = {name for name, is_best in zip(names, self.is_best, strict=True) if is_best}
        return {"agreeing": len(agreeing), "costs": least, "compared_at_px": self.scale_px}


def _compared(problem: EpipolarProblem, ends: _Ends, old: RelativePose | None) -> _Compared:
    """The cost of each end; what the old rig does not allow costs more than all else."""
    minima = ends.minima
    is_close = np.ones(len(ends.names), dtype=bool) if old is None else _is_near(old, minima)
    if not is_close.any():
        is_close = ~is_close
    n_right = (minima.equations.weights > 0).sum(axis=-1)
    has_many = is_close & (n_right >= MANY_SHARE * n_right[is_close].max())
    noise_px = max(float(minima.scale_px[has_many].min()), NOISE_FLOOR_PX)
    scale_px = min(COMPARED_NOISE * noise_px, MOST_COMPARED_PX)
    costs = np.where(
        is_close,
        cost_of_seen(problem, minima.estimate, old, scale_px),
        cost_of_seen(problem, minima.estimate, None, scale_px),
    )
    is_allowed = ~is_close if _is_elsewhere(problem, costs, is_close) else is_close
    return _Compared(costs + np.where(is_allowed, 0.0, 0.5 * problem.n_matches(())), scale_px)


def _is_elsewhere(problem: EpipolarProblem, costs: Float[ndarray, "k"], is_close: Bool[ndarray, "k"]) -> bool:
    """Whether an end far from the old rig explains most matches where what is near explains far fewer: another rig's images."""
    explained = 1 - costs / (0.5 * problem.n_matches(()))
    far, near = (float(np.max(np.where(group, explained, 0.0))) for group in (~is_close, is_close))
    return far > FAR_FITS and near < NEAR_SHARE * far


def _is_near(old: RelativePose, minima: EpipolarMinimum) -> Bool[ndarray, "k"]:
    """Which may be the old rig: what the matches themselves leave open does not count against them."""
    covariance = covariance_of_noise(minima.equations, minima.scale_px)
    open_deg = OPEN_SIGMAS * np.degrees(np.sqrt(np.maximum(np.diagonal(covariance, axis1=-2, axis2=-1), 0.0)))
    turn_deg = OLD_RIG_TURN_DEG + open_deg[..., :3].max(axis=-1)
    direction_deg = OLD_RIG_DIRECTION_DEG + open_deg[..., 3:].max(axis=-1)
    return is_near(old, minima.estimate, turn_deg, direction_deg)


def _held(pose: RelativePose, direction_deg: float) -> PosePrior:
    return PosePrior(pose, np.radians(HELD_TURN_DEG), np.radians(direction_deg))


def _around(pose: RelativePose, circles: Sequence[tuple[int, float]]) -> RelativePose:
    """Poses whose direction of translation lies on circles about that of a pose."""
    turns = []
    for n, distance_deg in circles:
        angles = 2 * np.pi * np.arange(n) / n
        turns.append(np.radians(distance_deg) * np.stack([np.cos(angles), np.sin(angles)], axis=1))
    directions = np.concatenate(turns)
    xi = np.concatenate([np.zeros((len(directions), 3)), directions], axis=1)
    return map_arrays(lambda a: np.broadcast_to(a, (len(xi), *a.shape)), pose).stepped(xi)


def _alone(pose: RelativePose) -> RelativePose:
    """A batch of one."""
    return map_arrays(lambda a: a[None], pose)
