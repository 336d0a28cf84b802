"""Errors of whole calibrations against the Cramér-Rao bound, and whether the stated standard deviations hold."""

from __future__ import annotations

from typing import Any

import numpy as np

from binocal.benchmark.solver import BOARD
from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.errors import BinocalError
from binocal.geometry import so3
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig
from binocal.solvers.covariance import cramer_rao_bound

NOISE_PX = 0.2
VIEW_COUNTS = (3, 10, 20, 100)
MISSING_SHARES = (0.0, 0.3)


def run_precision_benchmark(*, n_rigs: int = 200, seed: int = 0) -> dict[str, Any]:
    """RMS of error over bound for rotation, translation and focal lengths, coverage of one and two sigma, failures."""
    rows = []
    for n_views in VIEW_COUNTS:
        for missing in MISSING_SHARES:
            rows.append(_run_case(n_views, missing, n_rigs, np.random.default_rng([seed, n_views, int(10 * missing)])))
    return {"benchmark": "precision", "board": BOARD, "noise_px": NOISE_PX, "n_rigs": n_rigs, "seed": seed} | {
        "rows": rows,
        "text": _format(rows, n_rigs),
    }


def _run_case(n_views: int, missing: float, n_rigs: int, rng: np.random.Generator) -> dict[str, Any]:
    rig, board = table2_rig(), parse_board(BOARD)
    per_bound, per_stated, failures = [], [], 0
    for _ in range(n_rigs):
        scene = StereoScene(rig, board, sample_board_poses(rig, board, n_views, rng))
        detections = simulate_detections(scene, rng, noise_px=NOISE_PX, missing_share=missing)
        try:
            calibration = calibrate(detections, calibrator="lm", model="brown4")
        except BinocalError:
            failures += 1
            continue
        bound = cramer_rao_bound(
            rig,
            board.object_points_m,
            scene.T_left_board,
            NOISE_PX,
            left_is_seen=detections.left_is_seen,
            right_is_seen=detections.right_is_seen,
        )
        estimate, truth = calibration.rig, rig
        error = np.concatenate(
            [
                np.delete(estimate.left.parameters - truth.left.parameters, 4),
                np.delete(estimate.right.parameters - truth.right.parameters, 4),
                so3.log(estimate.T_right_left.R @ truth.T_right_left.R.T),
                estimate.T_right_left.t - truth.T_right_left.t,
            ]
        )
        per_bound.append(error / np.sqrt(np.diag(bound.matrix)))
        per_stated.append(np.abs(error) / np.sqrt(np.diag(calibration.covariance.matrix)))
    z, stated = np.array(per_bound), np.array(per_stated)

    def rms(columns: Any) -> float:
        return float(np.sqrt(np.mean(z[:, columns] ** 2)))

    return {
        "n_views": n_views,
        "missing_share": missing,
        "rotation": rms(slice(-6, -3)),
        "translation": rms(slice(-3, None)),
        "focal_length": rms([0, 1, 8, 9]),
        "within_one_sigma": float(np.mean(stated < 1)),
        "within_two_sigma": float(np.mean(stated < 2)),
        "failures": failures,
    }


def _format(rows: list[dict[str, Any]], n_rigs: int) -> str:
    lines = [
        f"error over the Cramér-Rao bound (RMS), and coverage: {n_rigs} rigs per row, {BOARD}, noise {NOISE_PX} px",
        f"{'views':>6} {'missing':>8} {'rotation':>9} {'translation':>12} {'focal':>7} {'1 sigma':>8} {'2 sigma':>8} {'failed':>7}",
    ]
    lines += [
        f"{r['n_views']:>6} {100 * r['missing_share']:>6.0f} % {r['rotation']:>9.3f} {r['translation']:>12.3f} "
        f"{r['focal_length']:>7.3f} {100 * r['within_one_sigma']:>6.1f} % {100 * r['within_two_sigma']:>6.1f} % "
        f"{r['failures']:>7}"
        for r in rows
    ]
    return "\n".join(lines)
