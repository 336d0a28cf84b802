"""Ways of training the agent side by side: hard and soft targets at equal time constants, and imitation.

Every run is short and evaluated on validation rigs of its own seed; the figure of all runs is drawn where matplotlib is.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from binocal.rl.evaluation import solve_rigs
from binocal.rl.history import TrainingHistory
from binocal.rl.policy import LearnedController, Policy
from binocal.rl.rig_batches import sample_starts
from binocal.rl.training.imitation import Imitation
from binocal.rl.training.trainer import Training, TrainingOptions, run_training, simulated_pools

N_STEPS = 150_000
N_SEEDS = 5
NAMES = ("standard, 16 views", "weak", "stress", "standard, 8 views")


def run_training_benchmark(
    *, seed: int = 0, n_seeds: int = N_SEEDS, n_steps: int = N_STEPS, figure: Path | None = None
) -> dict[str, Any]:
    """Held-out iterations of every run; medians and spread over the seeds."""
    runs: list[dict[str, Any]] = []
    histories: list[TrainingHistory] = []
    for index in range(n_seeds):
        options = TrainingOptions(seed=seed + index, n_steps=n_steps, n_checks=6, rigs_per_pool=256)
        pools, validation = simulated_pools(options)
        for targets in ("soft", "hard"):
            training = Training(replace(options, td3=replace(options.td3, targets=targets)), pools, validation)
            run_training(training, on_check=lambda *_: None)
            histories.append(training.history())
            runs.append(
                _evaluated(f"TD3, {targets} targets", options.seed, training.policy({}), validation)
                | {"seconds": training.elapsed_s, "lag": training.td3.target_lag()}
                | {"converged_update": histories[-1].converged_step}
            )
        imitation = Imitation(options, pools)
        begin = time.perf_counter()
        while (
            imitation.n_steps < n_steps * 4
        ):  # a target action costs 16 tried steps; four times the critic's own is what its time allows
            imitation.generation()
        runs.append(
            _evaluated("imitation", options.seed, imitation.policy(), validation)
            | {"seconds": time.perf_counter() - begin, "lag": None, "converged_update": None}
        )
    if figure is not None:
        from binocal.report.training import draw_training

        draw_training(histories, figure)
    rows = [_summary(way, [r for r in runs if r["way"] == way]) for way in dict.fromkeys(r["way"] for r in runs)]
    return {
        "benchmark": "training",
        "n_steps": n_steps,
        "seeds": list(range(seed, seed + n_seeds)),
        "runs": runs,
        "rows": rows,
        "text": _format(rows, n_seeds, n_steps),
    }


def _evaluated(way: str, seed: int, policy: Policy, validation: list[tuple[Any, float]]) -> dict[str, Any]:
    """Of rigs, as :func:`binocal.rl.training.trainer.simulated_pools` draws them for boards."""
    iterations, arrived = [], []
    for index, (pool, tolerance) in enumerate(validation):
        start = sample_starts(pool, np.random.default_rng([11, index]))
        outcome = solve_rigs(pool, start, LearnedController(policy), tolerance)
        iterations.append(float(outcome.n_iterations.mean()))
        arrived.append(float(outcome.has_arrived.mean()))
    return {"way": way, "seed": seed, "iterations": iterations, "arrived": arrived}


def _summary(way: str, runs: list[dict[str, Any]]) -> dict[str, Any]:
    table = np.array([r["iterations"] for r in runs])
    converged = [r["converged_update"] for r in runs if r["converged_update"] is not None]
    return {
        "way": way,
        "median": np.median(table, axis=0).tolist(),
        "least": table.min(axis=0).tolist(),
        "greatest": table.max(axis=0).tolist(),
        "arrived": float(np.mean([r["arrived"] for r in runs])),
        "seconds": float(np.median([r["seconds"] for r in runs])),
        "converged_update": float(np.median(converged)) if converged else None,
    }


def _format(rows: list[dict[str, Any]], n_seeds: int, n_steps: int) -> str:
    lines = [
        f"{n_seeds} seeds, {n_steps} steps each; held-out iterations, median (least..greatest) over the seeds",
        "",
        f"| way | {' | '.join(NAMES)} | arrived | seconds | loss converged at update |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        cells = [
            f"{m:.2f} ({a:.2f}..{b:.2f})" for m, a, b in zip(row["median"], row["least"], row["greatest"], strict=True)
        ]
        converged = "" if row["converged_update"] is None else f"{row['converged_update']:.0f}"
        lines.append(
            f"| {row['way']} | {' | '.join(cells)} | {100 * row['arrived']:.1f} % | {row['seconds']:.0f} | {converged} |"
        )
    return "\n".join(lines)
