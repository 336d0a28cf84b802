"""Whether stated uncertainty of projection, depth and rows holds: simulated rigs by the hundred, and mrcal on the same corners."""

from __future__ import annotations

import platform
import time
from typing import Any

import numpy as np

from binocal.benchmark.mrcal_peer import find_mrcal, uncertainty_by_mrcal
from binocal.benchmark.uncertainty_cases import BOARD, CASES, Case, simulate_case, standardised_errors
from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.errors import BinocalError
from binocal.threads import n_processors
from binocal.uncertainty.field import image_grid
from binocal.uncertainty.projection import projection_sigma_px

N_PEER_RIGS = 12
CALIBRATED_SHARE = 0.8  # of the image's width and height, about its middle: what 20 careful views cover


def run_uncertainty_benchmark(*, rigs: int = 500, seed: int = 0) -> dict[str, Any]:
    """Shares of errors within one and two stated standard deviations, by case and figure, and projection beside mrcal's."""
    start = time.perf_counter()
    rows = [row for name, case in CASES.items() for row in _run_case(name, case, rigs, seed)]
    peer = _beside_mrcal(seed) if find_mrcal() else None
    table: dict[str, Any] = {
        "benchmark": "uncertainty",
        "board": BOARD,
        "rigs": rigs,
        "seed": seed,
        "machine": f"{platform.machine()}, {n_processors()} processors, Python {platform.python_version()}, NumPy {np.__version__}",
        "elapsed_s": time.perf_counter() - start,
        "rows": rows,
        "mrcal": peer,
    }
    return table | {"text": _format(table)}


def _run_case(name: str, case: Case, n_rigs: int, seed: int) -> list[dict[str, Any]]:
    """A row for each figure. Errors of one rig hang together: the shares' standard errors are those of the rigs' own shares."""
    pooled: dict[str, list[np.ndarray]] = {}
    n_failed = 0
    for index in range(n_rigs):
        drawn = simulate_case(case, np.random.default_rng([seed, index]))
        try:
            calibration = calibrate(drawn.detections, calibrator="lm", model="brown4")
        except BinocalError:
            n_failed += 1
            continue
        for figure, z in standardised_errors(drawn, calibration).items():
            if len(z):
                pooled.setdefault(figure, []).append(np.abs(z))
    rows = []
    for figure, parts in pooled.items():
        z = np.concatenate(parts)
        within = [np.array([np.mean(part < k) for part in parts]) for k in (1, 2)]
        rows.append(
            {
                "case": name,
                "figure": figure,
                "rms": float(np.sqrt(np.mean(z**2))),
                "within_1_sigma": float(np.mean(z < 1)),
                "within_2_sigma": float(np.mean(z < 2)),
                "standard_error": [float(w.std(ddof=1) / np.sqrt(len(parts))) for w in within],
                "n_rigs": len(parts),
                "n_failed": n_failed,
            }
        )
    return rows


def _beside_mrcal(seed: int) -> dict[str, Any]:
    """Ratios of our projection uncertainty to mrcal's over the calibrated part of both images, and both times.

    Twenty views, flat board, the same lens model; at infinity and at 1 m. Time is from the solved calibration to the grid's figures.
    """
    ratios, times = {"at infinity": [], "at 1 m": []}, {"binocal": [], "mrcal": []}
    for index in range(N_PEER_RIGS):
        drawn = simulate_case(CASES["20 views"], np.random.default_rng([seed, 10_000 + index]))
        ours = calibrate(drawn.detections, calibrator="lm", model="brown4", board_shape="flat", exposure="together")
        assert ours.mean_board_pose is not None
        for where, range_m in (("at infinity", np.inf), ("at 1 m", 1.0)):
            grids = [_calibrated_part(getattr(ours.rig, side)) for side in ("left", "right")]
            start = time.perf_counter()
            own = [
                projection_sigma_px(ours.rig, ours.covariance, ours.mean_board_pose, side, px, range_m)
                for side, px in zip(("left", "right"), grids, strict=True)
            ]
            times["binocal"].append(time.perf_counter() - start)
            elapsed_s, theirs = uncertainty_by_mrcal(drawn.detections, parse_board(BOARD), grids, range_m)
            times["mrcal"].append(elapsed_s)
            ratios[where].append(np.concatenate(own) / np.concatenate(theirs))
    return {
        "n_rigs": N_PEER_RIGS,
        "ratio": {
            where: {
                "median": float(np.median(r)),
                "low": float(np.quantile(r, 0.05)),
                "high": float(np.quantile(r, 0.95)),
            }
            for where, parts in ratios.items()
            for r in [np.concatenate(parts)]
        },
        "elapsed_s": {name: float(np.median(values)) for name, values in times.items()},
    }


def _calibrated_part(camera: Any) -> np.ndarray:
    middle = (np.array(camera.size_wh) - 1) / 2
    return (middle + CALIBRATED_SHARE * (image_grid(camera, (9, 7)) - middle)).reshape(-1, 2)


def _format(table: dict[str, Any]) -> str:
    lines = [
        f"errors over stated standard deviations: {table['rigs']} random rigs a case, {BOARD} (68.3 and 95.4 % are right)",
        f"{'case':<20}{'figure':<30}{'RMS':>7}{'1 sigma, %':>14}{'2 sigma, %':>14}{'rigs':>7}{'failed':>8}",
    ]
    for r in table["rows"]:
        one, two = (f"{100 * r[f'within_{k}_sigma']:.1f} ± {100 * r['standard_error'][k - 1]:.1f}" for k in (1, 2))
        lines.append(
            f"{r['case']:<20}{r['figure']:<30}{r['rms']:>7.3f}{one:>14}{two:>14}{r['n_rigs']:>7}{r['n_failed']:>8}"
        )
    peer = table["mrcal"]
    if peer is None:
        return "\n".join([*lines, "mrcal is not installed: its projection uncertainty was not compared"])
    for where, ratio in peer["ratio"].items():
        lines.append(
            f"projection {where} over mrcal's, the middle {100 * CALIBRATED_SHARE:.0f} % of the image, {peer['n_rigs']} rigs: "
            f"median {ratio['median']:.3f}, 5 to 95 % {ratio['low']:.3f} to {ratio['high']:.3f}"
        )
    t = peer["elapsed_s"]
    lines.append(f"time for both images: binocal {1e3 * t['binocal']:.2f} ms, mrcal {1e3 * t['mrcal']:.2f} ms")
    return "\n".join(lines)
