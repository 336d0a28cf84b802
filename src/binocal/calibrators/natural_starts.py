"""Where the kernel closes on matches of natural images: from an old rig by the agent and classical schedules, else from guesses.

The agent leads and a portfolio of schedules follows; the lowest cost wins, so that the result is never worse than the portfolio's
whatever the weights are. All of them look at the same few hundred matches, which tell the minimum as well as thousands do. Without
an old rig the agent is not asked: from an unknown start consensus of minimal sets finds twice as much.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from binocal.calibrators.registry import WEIGHTS_SUFFIX
from binocal.errors import FormatError
from binocal.rl.agent_kind import AgentKind
from binocal.rl.epipolar_task import N_STEPS
from binocal.rl.policy import LearnedController, Policy, load_policy, shipped_policy
from binocal.solvers.epipolar import EpipolarProblem
from binocal.solvers.epipolar_descent import cost_at, descend
from binocal.solvers.portfolio import PORTFOLIO, Contest, Led, compete
from binocal.solvers.relative_pose import RelativePose

MOST_MATCHES = 500  # that solves from an old rig look at: as many as the agent ever saw
WHOLE_PX = (1.0, 1.0)  # from their minimum to that of all matches
FAR_FITS, NEAR_SHARE = 0.6, 0.7
"""A pose far from the old rig that explains so much of all matches is the images', where the best near it explains so much less."""
AGENT = "agent"
NATURAL_CALIBRATORS = ("drl", "portfolio", "lm")
"""The agent and the schedules; the schedules; one schedule."""


@dataclass(frozen=True, slots=True, eq=False)
class ClosedStart:
    """Where the kernel closed, from which start, and who led there (for the result's provenance)."""

    estimate: RelativePose
    start: str
    led_by: Mapping[str, Any]


def solves_of(calibrator: str) -> dict[str, Led]:
    """The solves that start at an old rig, the leader first; ``calibrator`` may be a file of weights.

    Raises:
        ValueError: No such calibrator; the text names those that are known.
        FormatError: The file of weights cannot be read, or is not of an agent for streets.
    """
    if calibrator.endswith(WEIGHTS_SUFFIX):
        policy = load_policy(calibrator)
        if policy.kind != AgentKind.DRL_STREETS:
            raise FormatError(
                calibrator, f"weights of {policy.kind}, which sees boards; train with --agent {AgentKind.DRL_STREETS}."
            )
        return {AGENT: led_by_agent(policy), **PORTFOLIO}
    if calibrator == "drl":
        return {AGENT: led_by_agent(shipped_policy(AgentKind.DRL_STREETS)), **PORTFOLIO}
    if calibrator == "portfolio":
        return dict(PORTFOLIO)
    if calibrator == "lm":
        return dict(list(PORTFOLIO.items())[:1])
    known = ", ".join(NATURAL_CALIBRATORS)
    raise ValueError(f"unknown calibrator {calibrator!r}; known: {known}, or a {WEIGHTS_SUFFIX} file")


def led_by_agent(policy: Policy) -> Led:
    """An agent's solve."""
    return Led(LearnedController(policy), N_STEPS)


def closed_from_old_rig(
    problem: EpipolarProblem, old: RelativePose, guess: RelativePose | None, solves: Mapping[str, Led], seed: int
) -> ClosedStart:
    """The lowest cost that the old rig allows; ``guess`` is what matches alone give, and competes."""
    n = problem.left.directions.shape[0]
    some = problem
    if n > MOST_MATCHES:
        some = problem.select(np.sort(np.random.default_rng(seed).permutation(n)[:MOST_MATCHES]))
    others = {} if guess is None else {"matches": descend(some, guess)}
    contest = compete(some, old, solves, others)
    place = _clearly_elsewhere(some, contest)
    place = int(contest.winner) if place is None else place
    won = contest.names[place]
    report = {
        "asked": AGENT in solves,
        "won": won,
        "agreeing": int(contest.n_agreeing),
        "costs": dict(zip(contest.names, contest.costs.tolist(), strict=True)),
        "n_matches": min(n, MOST_MATCHES),
    }
    start = "old rig" if won in solves else won
    estimate = RelativePose(contest.estimates.R[place], contest.estimates.t[place])
    return ClosedStart(descend(problem, estimate, WHOLE_PX), start, report)


def _clearly_elsewhere(problem: EpipolarProblem, contest: Contest) -> int | None:
    """Which solve ended far from the old rig and explains most matches, where what is near explains far fewer: another rig's images."""
    most = 0.5 * problem.left.directions.shape[0]
    is_far = contest.costs > most
    ends = [RelativePose(R, t) for R, t in zip(contest.estimates.R, contest.estimates.t, strict=True)]
    explained = [
        1 - float(cost_at(problem, end) if far else cost) / most
        for end, cost, far in zip(ends, contest.costs, is_far, strict=True)
    ]
    best = int(np.argmax(np.where(is_far, explained, -np.inf)))
    near = float(np.max(np.where(is_far, 0.0, explained)))
    return best if is_far[best] and explained[best] > FAR_FITS and near < NEAR_SHARE * explained[best] else None


def closed_from_guesses(problem: EpipolarProblem, guesses: Mapping[str, RelativePose]) -> ClosedStart:
    """The lowest cost from starts of which none is known to be near."""
    ends = {name: descend(problem, guess) for name, guess in guesses.items()}
    best = min(ends, key=lambda name: float(cost_at(problem, ends[name])))
    return ClosedStart(ends[best], best, {"asked": False, "won": best, "reason": "no old rig"})
