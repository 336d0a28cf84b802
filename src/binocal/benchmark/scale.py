"""Time and peak memory against the number of pairs: images to corners, and corners to a rig with ``--max-views``.

Every row runs in a process of its own, so that its peak memory is its own. Images of a long recording are a few
rendered pairs over and over: finding corners does not know it, and nothing is held between them. OpenCV's pipeline on all
corners is timed in the same rows as far as its cubic growth allows.
"""

from __future__ import annotations

import platform
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from binocal.benchmark.memory import run_alone
from binocal.benchmark.opencv_peer import run_opencv
from binocal.benchmark.scenes import render_scene_pairs
from binocal.benchmark.solver import scene
from binocal.boards import parse_board
from binocal.calibrators import CalibrationRequest, calibrate
from binocal.calibrators.view_selection import select_views
from binocal.datasets.folder import ImagePair
from binocal.detection import detect_pairs
from binocal.geometry import so3

BOARD = "chessboard:11x8:20mm"
SIZE_WH = (1280, 960)
RENDERED_PAIRS = 8
MAX_VIEWS = 50
PEER_LIMIT_PAIRS = 100
N_THREADS = 2


def run_scale_benchmark(
    *,
    image_pairs: tuple[int, ...] = (25, 50, 100, 200),
    corner_pairs: tuple[int, ...] = (100, 300, 1000, 3000, 10_000),
    seed: int = 0,
) -> dict[str, Any]:
    """One row per number of pairs: seconds, megabytes at the peak, and errors against the truth where there is one."""
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(prefix="binocal-bench-") as folder:
        _, pairs = render_scene_pairs(Path(folder), RENDERED_PAIRS, BOARD, SIZE_WH, seed)
        for n in image_pairs:
            repeated = [
                ImagePair(f"{i:05d}", pairs[i % len(pairs)].left_path, pairs[i % len(pairs)].right_path)
                for i in range(n)
            ]
            rows.append({"stage": "images", "pairs": n} | run_alone(_find_corners, repeated))
    for n in corner_pairs:
        rows.append({"stage": "corners", "pairs": n} | run_alone(_choose_and_solve, n, seed))
        if n <= PEER_LIMIT_PAIRS:
            rows[-1]["opencv_s"] = run_alone(_solve_with_opencv, n, seed)["s"]
    return {
        "benchmark": "scale",
        "board": BOARD,
        "max_views": MAX_VIEWS,
        "seed": seed,
        "machine": f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}",
        "rows": rows,
        "text": _format(rows),
    }


def _find_corners(pairs: list[ImagePair]) -> dict[str, Any]:
    start = time.perf_counter()
    found = detect_pairs(pairs, parse_board(BOARD), n_threads=N_THREADS)
    return {"s": time.perf_counter() - start, "n_views": found.detections.n_views}


def _choose_and_solve(n_pairs: int, seed: int) -> dict[str, Any]:
    simulated, detections = scene(n_pairs, seed)
    start = time.perf_counter()
    selection = select_views(detections, CalibrationRequest("brown5", max_views=MAX_VIEWS))
    chosen = time.perf_counter()
    T = calibrate(detections.select(selection.views), calibrator="lm", model="brown5").rig.T_right_left
    truth = simulated.rig.T_right_left
    return {
        "s": time.perf_counter() - start,
        "choose_s": chosen - start,
        "n_views": len(selection.views),
        "depth_sigma_percent": 100 * selection.depth_sigma,
        "all_depth_sigma_percent": 100 * selection.all_depth_sigma,
        "rotation_error_deg": float(np.degrees(so3.angle_rad(T.R @ truth.R.T))),
        "translation_error_mm": 1e3 * float(np.linalg.norm(T.t - truth.t)),
    }


def _solve_with_opencv(n_pairs: int, seed: int) -> dict[str, Any]:
    return {"s": run_opencv(scene(n_pairs, seed)[1])[0]}


def _format(rows: list[dict[str, Any]]) -> str:
    heads = (
        "stage",
        "pairs",
        "s",
        "ms per pair",
        "peak MB",
        "views",
        "depth sigma %",
        "of all views",
        "OpenCV, all: s",
    )
    lines = ["".join(f"{head:>15}" for head in heads)]
    for row in rows:
        cells = [row["stage"], str(row["pairs"]), f"{row['s']:.2f}", f"{1e3 * row['s'] / row['pairs']:.2f}"]
        cells += [f"{row['peak_mb']:.0f}", str(row["n_views"])]
        for key, digits in (("depth_sigma_percent", 4), ("all_depth_sigma_percent", 4), ("opencv_s", 2)):
            cells.append(f"{row[key]:.{digits}f}" if key in row else "")
        lines.append("".join(f"{cell:>15}" for cell in cells).rstrip())
    return "\n".join(lines)
