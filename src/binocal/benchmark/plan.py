"""Whether planned views help as the plan says: against random ones of the same number, and by how many a requirement takes.

Random rigs calibrated from six ordinary views; what is asked of them is depth. Corners are simulated anew for every view that is added,
and every rig is calibrated from all of its views: figures are those of calibrations, not of predictions.
"""

from __future__ import annotations

import platform
import time
from dataclasses import replace
from typing import Any

import numpy as np

from binocal.benchmark.uncertainty_cases import BOARD, NOISE_PX
from binocal.boards import Board, parse_board
from binocal.calibrators import calibrate
from binocal.cameras import StereoRig
from binocal.errors import BinocalError
from binocal.geometry import SE3
from binocal.planning import plan_views
from binocal.requirements import Outcome, Requirement, decide, figure_of_calibration, parse_requirement
from binocal.result import StereoCalibration
from binocal.simulation import StereoScene, random_rig, sample_board_poses, simulate_detections
from binocal.threads import n_processors

FIRST_VIEWS, ADDED_VIEWS = 6, 4
N_RANDOM = 50
NEED = parse_requirement("depth 1% at 2m")
LIMIT_SHARE = 0.4  # of the figure that six views leave: what the second table asks for
MOST_VIEWS = 80


def run_plan_benchmark(*, cases: int = 100, rigs: int = 50, seed: int = 0) -> dict[str, Any]:
    """How often a plan beats the best of 50 random choices, predicted over reached figures, and views to a met requirement."""
    rows = [_against_random(np.random.default_rng([seed, i])) for i in range(cases)]
    rows = [row for row in rows if row is not None]
    counts = [_views_needed(np.random.default_rng([seed, 1_000 + i])) for i in range(rigs)]
    counts = [row for row in counts if row is not None]
    ratios = [row["planned"] / row["random"] for row in counts]
    table: dict[str, Any] = {
        "benchmark": "plan",
        "board": BOARD,
        "seed": seed,
        "machine": f"{platform.machine()}, {n_processors()} processors, Python {platform.python_version()}, NumPy {np.__version__}",
        "cases": rows,
        "n_failed": cases - len(rows) + rigs - len(counts),
        "share_as_good": float(np.mean([row["planned"] <= row["best_random"] for row in rows])),
        "views_needed": counts,
        "median_ratio": float(np.median(ratios)),
    }
    return table | {"text": _format(table)}


def _against_random(rng: np.random.Generator) -> dict[str, float] | None:
    rig, board = random_rig(rng), parse_board(BOARD)
    first = sample_board_poses(rig, board, FIRST_VIEWS, rng)
    calibration = _calibrated(rig, board, first, rng)
    if calibration is None:
        return None
    start = time.perf_counter()
    plan = plan_views(calibration, board, NEED, n_views=ADDED_VIEWS)
    elapsed_s = time.perf_counter() - start
    planned = _calibrated(rig, board, _joined(first, _poses_of(plan.views)), rng)
    choices = [
        _calibrated(rig, board, _joined(first, sample_board_poses(rig, board, ADDED_VIEWS, rng)), rng)
        for _ in range(N_RANDOM)
    ]
    if planned is None:
        return None
    figures = [_figure(c) for c in choices if c is not None]
    return {
        "before": plan.figure,
        "predicted": plan.views[-1].figure,
        "planned": _figure(planned),
        "best_random": float(np.min(figures)),
        "median_random": float(np.median(figures)),
        "elapsed_s": elapsed_s,
    }


def _views_needed(rng: np.random.Generator) -> dict[str, int] | None:
    """Views beyond the first six until the requirement is proven met, planned one plan at a time, and taken at random."""
    rig, board = random_rig(rng), parse_board(BOARD)
    first = sample_board_poses(rig, board, FIRST_VIEWS, rng)
    calibration = _calibrated(rig, board, first, rng)
    if calibration is None:
        return None
    need = replace(NEED, limit=LIMIT_SHARE * _figure(calibration))
    planned, n_planned = first, 0
    while not _is_met(calibration, need) and n_planned < MOST_VIEWS:
        plan = plan_views(calibration, board, need)
        added = plan.views[: max(len(plan.views), 1)]
        if not added:
            return None
        planned, n_planned = _joined(planned, _poses_of(added)), n_planned + len(added)
        again = _calibrated(rig, board, planned, rng)
        if again is None:
            return None
        calibration = again
    more = sample_board_poses(rig, board, MOST_VIEWS, rng)
    for n in range(1, MOST_VIEWS + 1):
        again = _calibrated(rig, board, _joined(first, SE3(more.R[:n], more.t[:n])), rng)
        if again is not None and _is_met(again, need):
            return {"planned": n_planned, "random": n}
    return {"planned": n_planned, "random": MOST_VIEWS}


def _calibrated(rig: StereoRig, board: Board, poses: SE3, rng: np.random.Generator) -> StereoCalibration | None:
    detections = simulate_detections(StereoScene(rig, board, poses), rng, noise_px=NOISE_PX)
    try:
        return calibrate(detections, calibrator="lm", model="brown4")
    except BinocalError:
        return None


def _figure(calibration: StereoCalibration) -> float:
    return figure_of_calibration(calibration, NEED).value


def _is_met(calibration: StereoCalibration, need: Requirement) -> bool:
    return decide(need, figure_of_calibration(calibration, need)).outcome is Outcome.PASS


def _poses_of(views: Any) -> SE3:
    return SE3(np.stack([v.T_left_board.R for v in views]), np.stack([v.T_left_board.t for v in views]))


def _joined(a: SE3, b: SE3) -> SE3:
    return SE3(np.concatenate([a.R, b.R]), np.concatenate([a.t, b.t]))


def _format(table: dict[str, Any]) -> str:
    rows, counts = table["cases"], table["views_needed"]
    gain = {
        key: np.median([row[key] / row["before"] for row in rows])
        for key in ("planned", "predicted", "best_random", "median_random")
    }
    times = [row["elapsed_s"] for row in rows]
    ratio = np.array([row["planned"] / row["predicted"] for row in rows])
    planned, random = (np.array([row[key] for row in counts]) for key in ("planned", "random"))
    return "\n".join(
        [
            f"{ADDED_VIEWS} views added to {FIRST_VIEWS}, {NEED.text}, {len(rows)} random rigs; 95 % depth error over that before, median",
            f"planned {gain['planned']:.3f} (predicted {gain['predicted']:.3f}), best of {N_RANDOM} random {gain['best_random']:.3f}, "
            f"median random {gain['median_random']:.3f}",
            f"the plan is as good as the best of {N_RANDOM} in {100 * table['share_as_good']:.0f} % of the cases",
            f"reached over predicted: median {np.median(ratio):.3f}, 5 to 95 % {np.quantile(ratio, 0.05):.3f} to "
            f"{np.quantile(ratio, 0.95):.3f}; time of a plan: median {np.median(times):.2f} s, most {max(times):.2f} s",
            f"views to {LIMIT_SHARE:g} of the error before, {len(counts)} rigs, median: planned {np.median(planned):.0f}, random "
            f"{np.median(random):.0f}; ratio {table['median_ratio']:.2f}",
            f"{table['n_failed']} rigs failed",
        ]
    )
