"""Controllers side by side on rigs that none of them was trained on.

One iteration is one candidate evaluated, rejections counted; a solve that has not come within the tolerance of the robust
optimum after ``MAX_STEPS`` counts ``MAX_STEPS``. All controllers run in the same loop.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy import ndarray

from binocal.rl.agent_kind import AgentKind
from binocal.rl.policy import Policy
from binocal.rl.registration import MAX_STEPS
from binocal.rl.rig_batches import RIG_SETS, RigBatch, remaining_sigma, sample_rigs, sample_starts
from binocal.rl.street_evaluation import FoundRow
from binocal.rl.task import KERNEL, n_actions
from binocal.shapes import Bool, Float, Int
from binocal.solvers.arrays import take_rigs
from binocal.solvers.board_views import BundleEstimate
from binocal.solvers.controllers import Marquardt, Nielsen, Schedule
from binocal.solvers.loop import advance, begin
from binocal.solvers.loop_state import Controller

TOLERANCE_SIGMA = {"stress": 0.3}
DEFAULT_TOLERANCE_SIGMA = 0.1
COMPACTION_SHARE = 0.8  # a batch is packed when fewer of its rigs than this still run


@dataclass(frozen=True, slots=True, eq=False)
class SolveOutcome:
    """How solves ended. ``mean_action`` is that of the raw actions of a learned controller, None of others."""

    n_iterations: Int[ndarray, "rigs"]
    has_arrived: Bool[ndarray, "rigs"]
    mean_action: Float[ndarray, "a"] | None = None


def tolerance_of(name: str) -> float:
    """Standard deviations from the robust optimum that count as arrived on that set."""
    return TOLERANCE_SIGMA.get(name, DEFAULT_TOLERANCE_SIGMA)


def solve_rigs(
    rigs: RigBatch, start: BundleEstimate, controller: Controller, tolerance_sigma: float, *, max_steps: int = MAX_STEPS
) -> SolveOutcome:
    """Runs the loop on every case until it has come within the tolerance."""
    n = rigs.n_rigs
    n_iterations, has_arrived = np.full(n, MAX_STEPS), np.zeros(n, dtype=bool)
    rig, memory = np.arange(n), controller.start((n,))
    state = begin(rigs.problem, start, KERNEL)
    total, count = None, 0
    for step in range(max_steps):
        action, memory = controller.choose(rigs.problem, state, memory)
        state = advance(rigs.problem, state, action, KERNEL)
        is_live = ~has_arrived[rig]
        if "last_action" in memory:
            taken = memory["last_action"][is_live]
            total = taken.sum(axis=0) + (0 if total is None else total)
            count += len(taken)
        there = rig[is_live & (remaining_sigma(rigs, state) < tolerance_sigma)]
        n_iterations[there], has_arrived[there] = step + 1, True
        keep = np.flatnonzero(~has_arrived[rig])
        if not len(keep):
            break
        if len(keep) < COMPACTION_SHARE * len(rig):
            rigs, rig, state = rigs.select(keep), rig[keep], take_rigs(state, keep)
            memory = {name: values[keep] for name, values in memory.items()}
    return SolveOutcome(n_iterations, has_arrived, None if total is None else total / max(count, 1))


def held_out_rigs(name: str, n_rigs: int, seed: int) -> tuple[RigBatch, BundleEstimate]:
    """Rigs and starts of an evaluation set; the set's name is part of the seed."""
    rng = np.random.default_rng([seed, sorted(RIG_SETS).index(name)])
    rigs = sample_rigs(RIG_SETS[name], n_rigs, rng)
    return rigs, sample_starts(rigs, rng)


SCALE_SCHEDULES = ((1.0,), (4.0, 1.0), (8.0, 4.0, 2.0, 1.0), (1.0, 0.7, 1.0))
DAMPINGS = (1e-6, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0)
FALLS = (10.0, 30.0)
TUNING_RIGS = 128


def classical_grid(bend: float = 0.0) -> Iterator[tuple[str, str, Controller]]:
    """Every classical controller that is tried: family, settings, controller.

    ``bend`` above 0 gives them all the corrected steps that the agent can ask for.
    """
    for factors in SCALE_SCHEDULES:
        schedule = Schedule(factors, bend)
        family = "graduated scale" if len(factors) > 1 else "LM-Marquardt"
        scale = f"scale {', '.join(f'{f:g}' for f in factors)}"
        for damping, fall in itertools.product(DAMPINGS, FALLS):
            yield family, f"damping {damping:g} / {fall:g}, {scale}", Marquardt(damping, fall=fall, schedule=schedule)
        yield "guarded Gauss-Newton", scale, Marquardt(0.0, schedule=schedule)
    for damping in DAMPINGS:
        yield "Nielsen", f"damping {damping:g}", Nielsen(damping, Schedule(bend=bend))


def tune_classical(
    rigs: RigBatch, start: BundleEstimate, tolerance_sigma: float, *, bend: float = 0.0
) -> dict[str, tuple[str, Controller]]:
    """The best settings of each family on training rigs: fewest mean iterations."""
    best: dict[str, tuple[float, str, Controller]] = {}
    for family, settings, controller in classical_grid(bend):
        mean = float(solve_rigs(rigs, start, controller, tolerance_sigma).n_iterations.mean())
        if family not in best or mean < best[family][0]:
            best[family] = (mean, settings, controller)
    return {family: (settings, controller) for family, (_, settings, controller) in best.items()}


@dataclass(frozen=True, slots=True)
class Row:
    """One controller on one set: iterations of all rigs (failures count ``MAX_STEPS``), and the share that arrived."""

    HEADER: ClassVar[tuple[str, ...]] = ("set", "controller", "mean iterations", "95 %", "arrived", "settings")

    set_name: str
    controller: str
    settings: str
    n_rigs: int
    mean: float
    standard_error: float
    p95: float
    arrived: float

    @property
    def cells(self) -> tuple[str, ...]:
        """The row as text."""
        return (
            self.set_name,
            self.controller,
            f"{self.mean:.2f} ± {self.standard_error:.2f}",
            f"{self.p95:.0f}",
            f"{100 * self.arrived:.1f} %",
            self.settings,
        )


def row_of(set_name: str, controller: str, settings: str, outcome: SolveOutcome) -> Row:
    """The row of an outcome."""
    n = outcome.n_iterations
    return Row(
        set_name,
        controller,
        settings,
        len(n),
        float(n.mean()),
        float(n.std() / np.sqrt(len(n))),
        float(np.percentile(n, 95)),
        float(outcome.has_arrived.mean()),
    )


CORRECTED = "best of these + corrected steps"
MEAN_ACTION = "the agent's mean action"


@dataclass(frozen=True, slots=True, eq=False)
class EvaluationSet:
    """Rigs and starts to evaluate on, others of their kind to tune on, and how near counts as arrived."""

    name: str
    description: str
    rigs: RigBatch
    start: BundleEstimate
    tuning: RigBatch
    tuning_start: BundleEstimate
    tolerance_sigma: float


def simulated_evaluation_set(name: str, n_rigs: int, seed: int) -> EvaluationSet:
    """The evaluation_set of that name in ``RIG_SETS``."""
    rigs, start = held_out_rigs(name, n_rigs, seed)
    return EvaluationSet(
        name, "simulated rigs", rigs, start, *held_out_rigs(name, TUNING_RIGS, seed + 1_000_003), tolerance_of(name)
    )


def compare_on(
    evaluation_set: EvaluationSet, policies: Mapping[str, Policy], *, tuned: dict[str, Controller] | None = None
) -> list[Row]:
    """Every controller in one evaluation_set: classical families as tuned on its tuning rigs, and the policies.

    The mean action, the same in every iteration, is that of the first policy on the tuning rigs. ``tuned`` receives the
    controllers that were tuned, by row name.
    """
    from binocal.rl.policy import ConstantController, LearnedController

    set_name, tolerance = evaluation_set.name, evaluation_set.tolerance_sigma
    tuning, tuning_start = evaluation_set.tuning, evaluation_set.tuning_start
    candidates: list[tuple[str, str, Controller]] = []
    for family, (settings, controller) in tune_classical(tuning, tuning_start, tolerance).items():
        candidates.append((family, settings, controller))
    bent = tune_classical(tuning, tuning_start, tolerance, bend=1.0)
    means = {
        family: solve_rigs(tuning, tuning_start, controller, tolerance).n_iterations.mean()
        for family, (_, controller) in bent.items()
    }
    best = min(means, key=lambda family: means[family])
    candidates.append((CORRECTED, f"{best}, {bent[best][0]}", bent[best][1]))
    for index, (name, policy) in enumerate(policies.items()):
        if index == 0 and policy.kind == AgentKind.DRL:
            found = solve_rigs(tuning, tuning_start, LearnedController(policy), tolerance).mean_action
            mean = np.zeros(n_actions(policy.kind)) if found is None else found
            shown = ", ".join(f"{a:+.2f}" for a in mean)
            candidates.append((MEAN_ACTION, shown, ConstantController(mean)))
        candidates.append((name, "", LearnedController(policy)))
    if tuned is not None:
        tuned.update({name: controller for name, _, controller in candidates})
    return [
        row_of(set_name, name, settings, solve_rigs(evaluation_set.rigs, evaluation_set.start, controller, tolerance))
        for name, settings, controller in candidates
    ]


def format_rows(rows: Sequence[Row] | Sequence[FoundRow]) -> str:
    """The rows as a Markdown table."""
    header = rows[0].HEADER
    lines = [f"| {' | '.join(header)} |", f"|{'---|' * len(header)}"]
    return "\n".join([*lines, *(f"| {' | '.join(row.cells)} |" for row in rows)])
