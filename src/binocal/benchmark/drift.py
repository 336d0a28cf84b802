"""Filters of a rig's turn over a stream: errors of the running estimate, and how soon a jump is told at equal false alarms.

Series of 1800 measurements with known truth; the first 100 do not count. The threshold of each alarm is set on series in which
nothing moves, so that 5 % of them exceed it in the 1700 measurements that count.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from binocal.benchmark.drift_peers import ALARMS, ESTIMATORS, Filtered, multi_hypothesis
from binocal.simulation.drift_series import STILL, DriftFamily, DriftSeries, simulate_drift
from binocal.solvers.drift_filter import ALARM_LOG_ODDS

N_STEPS, N_FIRST = 1800, 100
JUMP_AT, N_AFTER = 900, 300
SIZES_DEG = (0.02, 0.04, 0.1)
FALSE_SHARE = 0.05
FAMILIES = {
    "as tuned for": DriftFamily(),
    "walk x3, jumps 3x rarer": DriftFamily(walk_deg=(6e-5, 6e-4), jump_every=1800),
    "noise x2, t of 8": DriftFamily(noise_deg=(0.006, 0.05), degrees_of_freedom=8),
    "jumps of 5 to 15 mdeg": DriftFamily(jump_deg=(0.005, 0.015)),
}
STILLS = {
    "nothing moves": STILL,
    "t of 8": replace(STILL, degrees_of_freedom=8),
    "stated noise right": replace(STILL, stated_log_sigma=0.0),
    "walk of 0.02 to 0.2 mdeg": DriftFamily(jump_every=np.inf),
    "errors correlated by 0.5": replace(STILL, correlation=0.5),
    "errors correlated by 0.9": replace(STILL, correlation=0.9),
}


def run_drift_benchmark(*, seed: int = 0, series: int = 200) -> dict[str, Any]:
    """RMS errors by family, delays of alarms, and the share of false alarms at the threshold that binocal uses.

    ``series`` of each family; three times as many for thresholds and delays, where three side by side are one rig.
    """
    errors = [_errors(name, family, series, seed) for name, family in FAMILIES.items()]
    still = simulate_drift(STILL, N_STEPS, 3 * series, np.random.default_rng([seed, 10]))
    jumps = [_jumping(size, 3 * series, seed) for size in SIZES_DEG]
    alarms = [_delays(name, peer, still, jumps) for name, peer in ALARMS.items()]
    false = [_false_alarms(name, family, series, seed) for name, family in STILLS.items()]
    table = {
        "benchmark": "drift",
        "series": series,
        "seed": seed,
        "errors": errors,
        "alarms": alarms,
        "false_alarms": false,
    }
    return {**table, "text": _text(table)}


def _errors(name: str, family: DriftFamily, n_series: int, seed: int) -> dict[str, Any]:
    data = simulate_drift(family, N_STEPS, n_series, np.random.default_rng([seed, 0]))
    rows = {}
    for peer, run in ESTIMATORS.items():
        error = 1e3 * (run(data)[0] - data.true_deg)[N_FIRST:]
        by_series = np.sqrt(np.mean(error**2, axis=0))
        low, middle, high = np.quantile(by_series, [0.1, 0.5, 0.9])
        rms = float(np.sqrt(np.mean(error**2)))
        rows[peer] = {"rms_mdeg": rms, "median_mdeg": float(middle), "p10_mdeg": float(low), "p90_mdeg": float(high)}
    return {"family": name, "filters": rows}


def _jumping(size_deg: float, n_series: int, seed: int) -> DriftSeries:
    still = simulate_drift(STILL, JUMP_AT + N_AFTER, n_series, np.random.default_rng([seed, 11, int(1e3 * size_deg)]))
    step = np.where(np.arange(JUMP_AT + N_AFTER) >= JUMP_AT, size_deg, 0.0)[:, None]
    return replace(still, measured_deg=still.measured_deg + step, true_deg=still.true_deg + step)


def _delays(
    name: str, run: Callable[[DriftSeries], Filtered], still: DriftSeries, jumps: list[DriftSeries]
) -> dict[str, Any]:
    """Measurements from the jump to the alarm, itself counted; those after the last one count as never."""
    threshold = float(np.quantile(run(still)[1][N_FIRST:].max(axis=0), 1 - FALSE_SHARE))
    delays = []
    for size, data in zip(SIZES_DEG, jumps, strict=True):
        is_over = run(data)[1][JUMP_AT:] > threshold
        delay = np.where(is_over.any(axis=0), is_over.argmax(axis=0) + 1.0, np.inf)
        middle, most = np.quantile(delay, [0.5, 0.9], method="higher")
        delays.append({"jump_deg": size, "median": middle, "p90": most, "never": int(np.isinf(delay).sum())})
    return {"filter": name, "threshold": threshold, "delays": delays}


def _false_alarms(name: str, family: DriftFamily, n_rigs: int, seed: int) -> dict[str, Any]:
    """Of rigs of three angles, by binocal's own threshold."""
    data = simulate_drift(family, N_STEPS, 3 * n_rigs, np.random.default_rng([seed, 12]))
    highest = multi_hypothesis(data)[1][N_FIRST:].max(axis=0).reshape(n_rigs, 3).max(axis=1)
    return {"series": name, "share": float(np.mean(highest > ALARM_LOG_ODDS)), "n_rigs": n_rigs}


def _text(table: dict[str, Any]) -> str:
    lines = [f"{table['series']} series of {N_STEPS}; RMS error, mdeg (10, 50, 90 % of the series' own)", ""]
    lines += [f"| filter | {' | '.join(FAMILIES)} |", "|---" * (1 + len(FAMILIES)) + "|"]
    for peer in ESTIMATORS:
        cells = [
            f"{r['rms_mdeg']:.2f} ({r['p10_mdeg']:.1f}, {r['median_mdeg']:.1f}, {r['p90_mdeg']:.1f})"
            for r in (row["filters"][peer] for row in table["errors"])
        ]
        lines.append(f"| {peer} | {' | '.join(cells)} |")
    sizes = " | ".join(f"{1e3 * size:.0f} mdeg" for size in SIZES_DEG)
    lines += [
        "",
        f"Measurements from a jump to the alarm, median (90 %), at {100 * FALSE_SHARE:.0f} % false alarms in ",
    ]
    lines[-1] += f"{N_STEPS - N_FIRST}; - beyond {N_AFTER}"
    lines += ["", f"| alarm | threshold | {sizes} |", "|---" * (2 + len(SIZES_DEG)) + "|"]
    for row in table["alarms"]:
        cells = [f"{_count(d['median'])} ({_count(d['p90'])})" for d in row["delays"]]
        lines.append(f"| {row['filter']} | {row['threshold']:.3g} | {' | '.join(cells)} |")
    lines += ["", f"Rigs of three angles with a false alarm in {N_STEPS - N_FIRST}, threshold {ALARM_LOG_ODDS}:", ""]
    lines += [f"- {row['series']}: {100 * row['share']:.1f} % of {row['n_rigs']}" for row in table["false_alarms"]]
    return "\n".join(lines)


def _count(value: float) -> str:
    return f"{value:.0f}" if np.isfinite(value) else "-"
