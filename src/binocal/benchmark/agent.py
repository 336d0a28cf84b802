"""The shipped agents against classical controllers: iterations on unseen rigs, and time per solve.

Iterations are counted to the robust optimum in one loop (:mod:`binocal.rl.evaluation`); times are those of whole solves
of single rigs to the product's own stop rule, controllers in turn.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from typing import Any

import numpy as np

from binocal.benchmark.streets import streets_document
from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.cameras import StereoRig
from binocal.errors import BinocalError
from binocal.evidence import Detections
from binocal.geometry import so3
from binocal.result import StereoCalibration
from binocal.rl.agent_kind import AgentKind
from binocal.rl.evaluation import CORRECTED, Row, compare_on, format_rows, held_out_rigs, simulated_evaluation_set
from binocal.rl.policy import shipped_policy
from binocal.rl.rig_batches import RIG_SETS, SIZE_WH, RigBatch, corrupt_corners
from binocal.simulation import StereoScene, random_rig, sample_board_poses, simulate_detections
from binocal.solvers.arrays import take_rigs
from binocal.solvers.board_views import BundleEstimate, BundleMinimum, BundleProblem
from binocal.solvers.controlled import minimize_controlled
from binocal.solvers.loop_state import Controller
from binocal.solvers.minimization import minimize

N_TIMED = 200
N_JOINT = 60
N_STRESS = 300
WORSE = 1.05  # times the least residual scale that any of the ways ended at: another minimum
WRONG_SIGMA = 7.0  # a right rig lies beyond it once in ten million
JOINT_OUTLIER_SHARES = (0.0, 0.05)
BOARD = "chessboard:11x8:20mm"
CLASSICAL = ("LM-Marquardt", "guarded Gauss-Newton", "graduated scale", "Nielsen")
AGENT, LM = "drl", "lm"


def run_agent_benchmark(*, n_rigs: int = 1000, seed: int = 0) -> dict[str, Any]:
    """Every controller on every set, and median milliseconds per solve of the agent and the best classical one."""
    policies = {AGENT: shipped_policy(AgentKind.DRL), "drl-increments": shipped_policy(AgentKind.DRL_INCREMENTS)}
    rows: list[Row] = []
    times: list[dict[str, Any]] = []
    for name in RIG_SETS:
        tuned: dict[str, Controller] = {}
        of_set = compare_on(simulated_evaluation_set(name, n_rigs, seed), policies, tuned=tuned)
        rows += of_set
        best = min((row for row in of_set if row.controller in CLASSICAL), key=lambda row: row.mean).controller
        chosen = {best: tuned[best], CORRECTED: tuned[CORRECTED], AGENT: tuned[AGENT]}
        times.append({"set": name, "best_classical": best} | _time_solves(name, chosen, seed))
    stress = count_wrong_minima(N_STRESS, seed)
    streets = streets_document(n_rigs, seed)
    joint = [_compare_joint(share, seed) for share in JOINT_OUTLIER_SHARES]
    return {
        "benchmark": "agent",
        "n_rigs": n_rigs,
        "seed": seed,
        "rows": [asdict(row) for row in rows],
        "times": times,
        "joint": joint,
        "stress": stress,
        "streets": {key: value for key, value in streets.items() if key != "text"},
        "text": "\n\n".join(
            (
                format_rows(rows),
                _format_times(times),
                _format_joint(joint),
                _format_stress(stress),
                "Streets: share of problems found\n",
                streets["text"],
            )
        ),
    }


def _compare_joint(outlier_share: float, seed: int) -> dict[str, Any]:
    """Whole calibrations of random rigs, everything free, by ``lm`` and by ``drl`` in turn."""
    rng = np.random.default_rng([seed, 5])
    n = {"lm": [], "drl": []}
    ms: dict[str, list[float]] = {"lm": [], "drl": []}
    apart, failures = [], 0
    for _ in range(N_JOINT):
        rig = random_rig(rng, baseline_m=0.06, field_deg=44.0, size_wh=(1280, 960))
        scene = StereoScene(rig, parse_board(BOARD), sample_board_poses(rig, parse_board(BOARD), 20, rng))
        detections = simulate_detections(scene, rng, noise_px=0.2, outlier_share=outlier_share, outlier_px=20.0)
        results = {}
        for name in n:
            begin = time.perf_counter()
            try:
                results[name] = calibrate(detections, calibrator=name, model="brown4")
            except BinocalError:
                break
            ms[name].append(1e3 * (time.perf_counter() - begin))
        if len(results) < len(n):
            failures += 1
            continue
        for name, result in results.items():
            n[name].append(result.n_iterations)
        apart.append(largest_difference_sigma(results["lm"], results["drl"]))
    return {
        "outlier_share": outlier_share,
        "n_rigs": N_JOINT,
        "failures": failures,
        "iterations": {name: float(np.mean(values)) for name, values in n.items()},
        "median_ms": {name: float(np.median(values)) for name, values in ms.items()},
        "largest_difference_sigma": float(np.max(apart)),
    }


def count_wrong_minima(n_rigs: int, seed: int, *, calibrator: str = "drl") -> dict[str, Any]:
    """Whole calibrations of stress rigs: how many are right, refused, wrong and flagged, wrong and not flagged.

    Twelve views, noise 0.1 to 0.5 px, 10 to 30 % outlying corners, 20 % of the right views in reverse order; no start is given. Right:
    R and T within ``WRONG_SIGMA`` stated standard deviations of the truth (Mahalanobis, six degrees of freedom). Flagged: a
    warning, or a refusal.
    """
    rng = np.random.default_rng([seed, 6])
    options = RIG_SETS["stress"]
    board = parse_board(options.board)
    counts = {"right": 0, "refused": 0, "wrong, flagged": 0, "wrong, not flagged": 0}
    worst = 0.0
    for _ in range(n_rigs):
        rig = random_rig(
            rng, baseline_m=rng.uniform(*options.baseline_m), field_deg=rng.uniform(*options.field_deg), size_wh=SIZE_WH
        )
        scene = StereoScene(rig, board, sample_board_poses(rig, board, options.n_views, rng, options.poses))
        left_px, right_px = (
            corrupt_corners(side[None], rng.uniform(*options.noise_px, 1), options, rng)[0] for side in scene.project()
        )
        wrong_views = rng.permutation(options.n_views)[: round(options.reversed_share * options.n_views)]
        right_px[wrong_views] = right_px[wrong_views][:, ::-1]
        detections = Detections.from_arrays(board.object_points_m, left_px, right_px, SIZE_WH)
        try:
            found = calibrate(detections, calibrator=calibrator, model="brown4")
        except BinocalError:
            counts["refused"] += 1
            continue
        distance = _distance_sigma(found, rig)
        if distance < WRONG_SIGMA:
            counts["right"] += 1
        else:
            worst = max(worst, distance)
            counts["wrong, flagged" if found.warnings else "wrong, not flagged"] += 1
    return {"calibrator": calibrator, "n_rigs": n_rigs, "counts": counts, "worst_sigma": worst}


def _distance_sigma(found: StereoCalibration, truth: StereoRig) -> float:
    """Mahalanobis distance of R and T to the truth, by the stated covariance."""
    names = [f"{part}.{axis}" for part in ("rotation", "translation") for axis in "xyz"]
    index = [found.covariance.names.index(name) for name in names]
    turn = so3.log(found.rig.T_right_left.R @ truth.T_right_left.R.T)
    error = np.concatenate([turn, found.rig.T_right_left.t - truth.T_right_left.t])
    return float(np.sqrt(error @ np.linalg.solve(found.covariance.matrix[np.ix_(index, index)], error)))


def largest_difference_sigma(a: StereoCalibration, b: StereoCalibration) -> float:
    """Largest difference of R and T between two calibrations of the same corners, in standard deviations of ``a``."""
    turn = so3.log(a.rig.T_right_left.R @ b.rig.T_right_left.R.T)
    sigma = a.covariance.sigma
    differences = {
        **{f"rotation.{axis}": turn[i] for i, axis in enumerate("xyz")},
        **{f"translation.{axis}": (a.rig.T_right_left.t - b.rig.T_right_left.t)[i] for i, axis in enumerate("xyz")},
    }
    return float(max(abs(value) / sigma[name] for name, value in differences.items()))


def _time_solves(name: str, controllers: dict[str, Controller], seed: int) -> dict[str, Any]:
    """Whole solves in turn: plain ``lm``, and with each controller leading its far phase."""
    rigs, start = held_out_rigs(name, N_TIMED, seed + 2)
    ways: dict[str, Callable[[BundleProblem, BundleEstimate], BundleMinimum]] = {LM: minimize}
    for label, controller in controllers.items():
        ways[label] = partial(_solve_led, controller)
    elapsed: dict[str, list[float]] = {label: [] for label in ways}
    ended_px: dict[str, list[float]] = {label: [] for label in ways}
    for index in range(rigs.n_rigs):
        problem, estimate = _one(rigs, start, index)
        for label, way in ways.items():
            begin = time.perf_counter()
            minimum = way(problem, estimate)
            elapsed[label].append(1e3 * (time.perf_counter() - begin))
            ended_px[label].append(float(minimum.scale_px) if minimum.is_converged else np.inf)
    least_px = np.min(list(ended_px.values()), axis=0)
    return {
        "median_ms": {label: float(np.median(values)) for label, values in elapsed.items()},
        "mean_ms": {label: float(np.mean(values)) for label, values in elapsed.items()},
        "ended_worse": {
            label: float(np.mean(~(np.array(values) < WORSE * least_px))) for label, values in ended_px.items()
        },
    }


def _solve_led(controller: Controller, problem: BundleProblem, start: BundleEstimate) -> BundleMinimum:
    return minimize_controlled(problem, start, controller).minimum


def _one(rigs: RigBatch, start: BundleEstimate, index: int) -> tuple[BundleProblem, BundleEstimate]:
    """One rig of a batch, without the batch's dimension."""
    return take_rigs(rigs.problem, index), take_rigs(start, index)


def _format_times(times: list[dict[str, Any]]) -> str:
    lines = [
        "| set | lm | best classical controller | the same with corrected steps | drl |",
        "|---|---|---|---|---|",
    ]
    for entry in times:
        shown = [
            f"{entry['median_ms'][label]:.2f} ({entry['mean_ms'][label]:.2f}), {100 * entry['ended_worse'][label]:.1f} %"
            for label in (LM, entry["best_classical"], CORRECTED, AGENT)
        ]
        lines.append(
            f"| {entry['set']} | {shown[0]} | {entry['best_classical']}: {shown[1]} | {shown[2]} | {shown[3]} |"
        )
    lines.append("")
    lines.append("ms per solve, median (mean), and the share that ended in a worse minimum, or nowhere")
    return "\n".join(lines)


def _format_joint(rows: list[dict[str, Any]]) -> str:
    lines = [
        "| everything free, 20 views | iterations lm / drl | ms lm / drl | largest difference of R, T | failures |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| {100 * r['outlier_share']:.0f} % outliers | {r['iterations']['lm']:.2f} / {r['iterations']['drl']:.2f} | "
        f"{r['median_ms']['lm']:.2f} / {r['median_ms']['drl']:.2f} | {r['largest_difference_sigma']:.4f} sigma | {r['failures']} |"
        for r in rows
    ]
    return "\n".join(lines)


def _format_stress(stress: dict[str, Any]) -> str:
    counted = ", ".join(f"{count} {what}" for what, count in stress["counts"].items())
    return f"{stress['n_rigs']} stress rigs without a start, {stress['calibrator']}: {counted}"
