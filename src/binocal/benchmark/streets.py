"""The agent for streets beside schedules, their portfolio and MAGSAC: who finds the right matches' basin, and how long it takes."""

from __future__ import annotations

import time
from dataclasses import asdict
from typing import Any

import numpy as np

from binocal.geometry import so3
from binocal.matching.relative_pose import estimate_relative_pose
from binocal.rl.agent_kind import AgentKind
from binocal.rl.epipolar_task import N_STEPS
from binocal.rl.evaluation import format_rows
from binocal.rl.match_batches import MATCH_SETS
from binocal.rl.policy import LearnedController, Policy, shipped_policy
from binocal.rl.street_evaluation import AGENT, FoundRow, StreetCase, compare_on_matches, street_case
from binocal.simulation.matches import sample_match_problems
from binocal.solvers.arrays import stack_rigs, take_rigs
from binocal.solvers.epipolar_descent import steer
from binocal.solvers.portfolio import PORTFOLIO, Led
from binocal.solvers.relative_pose import RelativePose

N_TIMED = 50


def compare_on_streets(
    *, n_problems: int, seed: int, policies: dict[str, Policy] | None = None
) -> tuple[list[FoundRow], dict[str, float]]:
    """Rows of all sets, and median milliseconds of whole solves of single problems of the hard one."""
    policies = policies or {AGENT: shipped_policy(AgentKind.DRL_STREETS)}
    rows: list[FoundRow] = []
    ms: dict[str, float] = {}
    for name in MATCH_SETS:
        case = street_case(name, n_problems, seed)
        rows += compare_on_matches(case, policies, _by_magsac(case, seed))
        if name == "drift_hard":
            ms = _time(case, next(iter(policies.values())))
    return rows, ms


def streets_document(n_problems: int, seed: int) -> dict[str, Any]:
    """The part of the agent's benchmark that is about streets."""
    rows, ms = compare_on_streets(n_problems=n_problems, seed=seed)
    shown = ", ".join(f"{name} {value:.1f}" for name, value in ms.items())
    text = f"{format_rows(rows)}\n\nms of a single problem of drift_hard, median of {N_TIMED}: {shown}"
    return {"n_problems": n_problems, "rows": [asdict(row) for row in rows], "median_ms": ms, "text": text}


def _by_magsac(case: StreetCase, seed: int) -> RelativePose:
    """OpenCV's estimate of each problem; the old rig where it gives none.

    The problems are drawn again as evidence, from the seed that the case was drawn from.
    """
    place = sorted(MATCH_SETS).index(case.name)
    drawn = sample_match_problems(
        case.matches.options.matches, case.matches.n_rigs, np.random.default_rng([seed, place, 1])
    )
    poses = []
    for index in range(len(drawn)):
        one = drawn.problem(index)
        found = estimate_relative_pose((one.rig.left, one.rig.right), one.matches.left_px, one.matches.right_px)
        old = take_rigs(case.start, index)
        poses.append(old if found is None else RelativePose(so3.project_to_rotation(found.R), found.t))
    return stack_rigs(poses)


def _time(case: StreetCase, policy: Policy) -> dict[str, float]:
    """Solves in turn, polishing left out."""
    ways = {AGENT: Led(LearnedController(policy), N_STEPS), **PORTFOLIO}
    elapsed: dict[str, list[float]] = {name: [] for name in ways}
    for index in range(min(N_TIMED, case.matches.n_rigs)):
        problem, start = take_rigs(case.matches.problem, index), take_rigs(case.start, index)
        for name, led in ways.items():
            began = time.perf_counter()
            steer(problem, start, led.controller, led.n_iterations)
            elapsed[name].append(1e3 * (time.perf_counter() - began))
    return {name: float(np.median(values)) for name, values in elapsed.items()}
