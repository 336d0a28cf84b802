"""Controllers side by side on matches that none of them was trained on: who finds the basin of the right matches.

A set of matches counts as found where the solve, polished as all are, ends within three standard deviations of the truth, by the
Cramér-Rao bound of the right matches (root mean square over the five unknowns). Differences to the agent are paired.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy import ndarray

from binocal.rl.epipolar_task import CHOSEN, N_STEPS, initial, observation, transition
from binocal.rl.match_batches import MATCH_SETS, MatchBatch, has_found, polished, sample_matches, sample_starts
from binocal.rl.policy import Policy
from binocal.shapes import Bool, Float
from binocal.solvers.arrays import choose_rigs
from binocal.solvers.epipolar import EpipolarProblem
from binocal.solvers.epipolar_descent import descend
from binocal.solvers.portfolio import PORTFOLIO, compete, cost_beside
from binocal.solvers.relative_pose import RelativePose

AGENT, ITS_MEAN, ITS_STEPS, OTHERS = (
    "agent, one solve",
    "its mean action",
    "its mean action of each step",
    "its actions on another problem",
)
TUNED, SCHEDULES, BOTH = "best tuned schedule", "4 schedules", "agent and 4 schedules"
MANY = "36 schedules"
MAGSAC, WITHOUT_AGENT, ALL = "MAGSAC, polished", "4 schedules and MAGSAC", "agent, 4 schedules and MAGSAC"
TRUTH = "started at the truth"
TUNING_PROBLEMS = 300
FIRST_PX, RATIOS, STEPS_EACH = (4.0, 8.0, 16.0, 32.0, 64.0, 128.0), (2.0, 4.0), (1, 2, 4)
"""Scales of the schedules that are tried: the first, by what it falls, and iterations under each, down to a pixel."""


@dataclass(frozen=True, slots=True)
class FoundRow:
    """One controller on one set: the share found, and by how much it is more than the agent's (nan: it is the agent)."""

    HEADER: ClassVar[tuple[str, ...]] = ("set", "controller", "found", "more than the agent", "settings")

    set_name: str
    controller: str
    settings: str
    n_rigs: int
    found: float
    standard_error: float
    more: float
    more_standard_error: float

    @property
    def cells(self) -> tuple[str, ...]:
        """The row as text."""
        more = "" if np.isnan(self.more) else f"{self.more:+.3f} ± {self.more_standard_error:.3f}"
        return (
            self.set_name,
            self.controller,
            f"{self.found:.3f} ± {self.standard_error:.3f}",
            more,
            self.settings,
        )


@dataclass(frozen=True, slots=True, eq=False)
class StreetCase:
    """Sets of matches and old rigs to evaluate on, and others of their kind to tune on."""

    name: str
    matches: MatchBatch
    start: RelativePose
    tuning: MatchBatch
    tuning_start: RelativePose


def street_case(name: str, n: int, seed: int) -> StreetCase:
    """The set of that name in ``MATCH_SETS``; the name is part of the seed."""
    options, place = MATCH_SETS[name], sorted(MATCH_SETS).index(name)
    batches = []
    for count, stream in ((n, 1), (TUNING_PROBLEMS, 2)):
        rng = np.random.default_rng([seed, place, stream])
        matches = sample_matches(options, count, rng)
        batches += [matches, sample_starts(matches, rng)]
    return StreetCase(name, *batches)


def compare_on_matches(
    case: StreetCase, policies: Mapping[str, Policy], guess: RelativePose | None = None
) -> list[FoundRow]:
    """Rows of the first policy and what it is compared with, then of the other policies.

    ``guess`` is what consensus of minimal sets found in each problem, which is no matter of this package.
    """
    (_, first), *more = policies.items()
    matches, problem, start = case.matches, case.matches.problem, case.start
    end, actions = solved_by(first, problem, start)
    _, tuned_actions = solved_by(first, case.tuning.problem, case.tuning_start)
    n = matches.n_rigs
    steps = tuned_actions.mean(axis=1)
    mean = steps.mean(axis=0)
    shown = ", ".join(f"{name} {value:+.2f}" for name, value in zip(CHOSEN, mean, strict=True))
    schedule = tune_schedule(case)
    ends: dict[str, tuple[RelativePose, str]] = {
        AGENT: (end, ""),
        ITS_MEAN: (replayed(problem, start, np.broadcast_to(mean, (N_STEPS, n, len(mean)))), shown),
        ITS_STEPS: (replayed(problem, start, np.repeat(steps[:, None], n, axis=1)), ""),
        OTHERS: (replayed(problem, start, np.roll(actions, 1, axis=1)), ""),
        TUNED: (descend(problem, start, schedule, steps_each=1), ", ".join(f"{scale:g}" for scale in schedule)),
        **{name: (estimate, "") for name, estimate in chosen_by_cost(case, end, guess).items()},
        MANY: (best_of_schedules(case), ""),
        TRUTH: (matches.truth, ""),
        **{name: (solved_by(policy, problem, start)[0], "") for name, policy in more},
    }
    found = {name: has_found(matches, estimate) for name, (estimate, _) in ends.items()}
    return [found_row(case.name, name, ends[name][1], is_found, found[AGENT]) for name, is_found in found.items()]


def chosen_by_cost(case: StreetCase, led: RelativePose, guess: RelativePose | None) -> dict[str, RelativePose]:
    """What wins among the portfolio, where the agent led, and a guess, by the cost that the set's bounds allow."""
    turn_deg, direction_deg = case.matches.options.bounds_deg
    problem, others = case.matches.problem, {AGENT: led}
    if guess is not None:
        others |= {MAGSAC: descend(problem, guess)}
    contest = compete(problem, case.start, PORTFOLIO, others, turn_deg=turn_deg, direction_deg=direction_deg)
    schedules = tuple(PORTFOLIO)
    chosen = {SCHEDULES: contest.of(schedules), BOTH: contest.of((*schedules, AGENT))}
    if guess is None:
        return {name: one.estimate for name, one in chosen.items()}
    chosen |= {WITHOUT_AGENT: contest.of((*schedules, MAGSAC)), ALL: contest}
    return {MAGSAC: guess} | {name: one.estimate for name, one in chosen.items()}


def best_of_schedules(case: StreetCase) -> RelativePose:
    """What wins among all schedules that are tried, by the cost that the set's bounds allow."""
    turn_deg, direction_deg = case.matches.options.bounds_deg
    problem, best, least = case.matches.problem, case.start, np.full(case.matches.n_rigs, np.inf)
    for scales in schedules():
        end = polished(problem, descend(problem, case.start, scales, steps_each=1))
        cost = cost_beside(problem, end, case.start, turn_deg, direction_deg)
        best, least = choose_rigs(cost < least, end, best), np.minimum(cost, least)
    return best


def found_row(
    set_name: str, name: str, settings: str, is_found: Bool[ndarray, "n"], by_agent: Bool[ndarray, "n"]
) -> FoundRow:
    """The row of what one controller found; without the difference where it is the agent's own."""
    root = np.sqrt(len(is_found))
    difference = is_found.astype(float) - by_agent
    is_agent = name == AGENT
    return FoundRow(
        set_name,
        name,
        settings,
        len(is_found),
        float(is_found.mean()),
        float(is_found.std() / root),
        np.nan if is_agent else float(difference.mean()),
        np.nan if is_agent else float(difference.std() / root),
    )


def solved_by(
    policy: Policy, problem: EpipolarProblem, start: RelativePose
) -> tuple[RelativePose, Float[ndarray, "steps cases 2"]]:
    """Where an agent's solves end, and its actions."""
    state, actions = initial(problem, start), []
    for _ in range(N_STEPS):
        actions.append(policy(observation(problem, state)))
        state = transition(problem, state, actions[-1])
    return state.loop.estimate, np.stack(actions)


def replayed(problem: EpipolarProblem, start: RelativePose, actions: Float[ndarray, "steps cases 2"]) -> RelativePose:
    """Where given actions lead; nothing looks at the state but the guards."""
    state = initial(problem, start)
    for action in actions:
        state = transition(problem, state, action)
    return state.loop.estimate


def schedules() -> Iterator[tuple[float, ...]]:
    """Every schedule that is tried: a scale for each iteration."""
    for first, ratio, each in itertools.product(FIRST_PX, RATIOS, STEPS_EACH):
        n_scales = int(np.log(first) / np.log(ratio) + 1e-9) + 1
        yield tuple(first / ratio**k for k in range(n_scales) for _ in range(each))


def tune_schedule(case: StreetCase) -> tuple[float, ...]:
    """The schedule that finds most of the tuning problems."""
    batch = case.tuning
    return max(
        schedules(),
        key=lambda scales: has_found(batch, descend(batch.problem, case.tuning_start, scales, steps_each=1)).mean(),
    )
