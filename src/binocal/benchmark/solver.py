"""Corners to rig: binocal's ``lm`` against OpenCV's mono calibrations with the joint stereo solve, and against mrcal.

The peers are given what they do best: exact board, all corners, five distortion coefficients, no outliers, intrinsics
refined jointly (``CALIB_USE_INTRINSIC_GUESS``). binocal does more in its time: robust loss, view checks, covariance.
OpenCV gets one thread, as binocal takes for up to 200 pairs: its own threads wait by spinning, which no clock measures well.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from binocal.benchmark.memory import added_mb
from binocal.benchmark.mrcal_peer import find_mrcal, run_mrcal
from binocal.benchmark.opencv_peer import run_opencv
from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.cameras import camera_model
from binocal.evidence import Detections
from binocal.geometry import SE3, so3
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig
from binocal.solvers.arrays import stack_rigs
from binocal.solvers.board_views import (
    BundleEstimate,
    BundleProblem,
    CameraObservations,
)
from binocal.threads import n_processors

BOARD = "chessboard:11x8:20mm"
NOISE_PX = 0.2
BATCH_RIGS, BATCH_VIEWS = 256, 20  # what the agent trains on
PEER_LIMIT_PAIRS = 200  # the peer's time grows with the cube of the views


def scene(n_views: int, seed: int) -> tuple[StereoScene, Detections]:
    """A simulated recording of the table-2 rig and its corners."""
    rng = np.random.default_rng(seed)
    rig, board = table2_rig(), parse_board(BOARD)
    views = StereoScene(rig, board, sample_board_poses(rig, board, n_views, rng))
    return views, simulate_detections(views, rng, noise_px=NOISE_PX)


def _run_binocal(detections: Detections) -> tuple[float, np.ndarray, np.ndarray]:
    start = time.perf_counter()
    calibration = calibrate(detections, calibrator="lm", model="brown5")
    elapsed_s = time.perf_counter() - start
    return elapsed_s, calibration.rig.T_right_left.R, calibration.rig.T_right_left.t


def _run_mrcal(detections: Detections) -> tuple[float, np.ndarray, np.ndarray]:
    board = parse_board(BOARD)
    return run_mrcal(detections, board, board.pitch_m)


def run_solver_benchmark(
    *, pairs: tuple[int, ...] = (20, 50, 100, 200, 1000), rounds: int = 5, seed: int = 0
) -> dict[str, Any]:
    """Time all in turn, ``rounds`` times per number of pairs after one warm-up round, and the batch of rigs.

    Medians, spread, processor time, errors against the truth, memory. mrcal takes part where some Python on the machine has it.
    """
    import cv2

    methods = {"binocal": _run_binocal, "opencv": run_opencv}
    if find_mrcal() is not None:
        methods["mrcal"] = _run_mrcal
    rows = []
    own_threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    for n_views in pairs:
        times: dict[str, list[float]] = {name: [] for name in methods}
        cpu_times: dict[str, list[float]] = {name: [] for name in methods if name != "mrcal"}
        errors: dict[str, list[tuple[float, float]]] = {name: [] for name in methods}
        for round_index in range(rounds + 1):
            truth_scene, detections = scene(n_views, seed + 1000 * round_index + n_views)
            truth = truth_scene.rig.T_right_left
            for name, method in methods.items():
                if name != "binocal" and n_views > PEER_LIMIT_PAIRS:
                    continue
                cpu_start_s = time.process_time()
                elapsed_s, R, t = method(detections)
                cpu_s = time.process_time() - cpu_start_s
                if round_index:
                    times[name].append(elapsed_s)
                    if name in cpu_times:
                        cpu_times[name].append(cpu_s)
                    rotation_deg = float(np.degrees(so3.angle_rad(R @ truth.R.T)))
                    errors[name].append((rotation_deg, 1e3 * float(np.linalg.norm(t - truth.t))))
        rows.append(_row(n_views, times, errors) | _cpu(cpu_times) | _added_memory(n_views, seed))
    cv2.setNumThreads(own_threads)
    batches = [_time_batch(seed, rounds, intrinsics=free) for free in (False, True)]
    machine = (
        f"{platform.machine()}, {n_processors()} processors, Python {platform.python_version()}, NumPy {np.__version__}, "
        f"OpenCV {cv2.__version__}{', mrcal' if 'mrcal' in methods else ''}"
    )
    return {
        "benchmark": "solver",
        "board": BOARD,
        "noise_px": NOISE_PX,
        "rounds": rounds,
        "seed": seed,
        "machine": machine,
        "rows": rows,
        "batches": batches,
        "text": _format(rows, batches, machine),
    }


def _added_memory(n_views: int, seed: int) -> dict[str, float]:
    """Megabytes that each method adds to what its process holds, imports and corners included, each in a process of its own."""
    names = ("binocal", "opencv") if n_views <= PEER_LIMIT_PAIRS else ("binocal",)
    return {f"{name}_added_mb": added_mb(_prepare, name, n_views, seed) for name in names}


def _prepare(name: str, n_views: int, seed: int) -> Callable[[], Any]:
    import cv2  # noqa: F401 - both methods start with it loaded

    _run_binocal(scene(8, seed)[1])
    return partial({"binocal": _run_binocal, "opencv": run_opencv}[name], scene(n_views, seed)[1])


def _row(n_views: int, times: dict[str, list[float]], errors: dict[str, list[tuple[float, float]]]) -> dict[str, Any]:
    row: dict[str, Any] = {"pairs": n_views}
    for name, seconds in times.items():
        if not seconds:
            continue
        row[f"{name}_s"] = _span(np.array(seconds))
        rotation_deg, translation_mm = np.median(np.array(errors[name]), axis=0)
        row[f"{name}_rotation_error_deg"] = float(rotation_deg)
        row[f"{name}_translation_error_mm"] = float(translation_mm)
        if name != "binocal":
            row[f"{name}_over_binocal"] = _span(np.array(seconds) / np.array(times["binocal"]))
    return row


def _cpu(cpu_times: dict[str, list[float]]) -> dict[str, Any]:
    """Processor time of all threads of this process: what else the machine does disturbs it less. mrcal runs in another."""
    own = np.array(cpu_times["binocal"])
    row: dict[str, Any] = {"binocal_cpu_s": _span(own)}
    if cpu_times["opencv"]:
        row["opencv_cpu_over_binocal"] = _span(np.array(cpu_times["opencv"]) / own)
    return row


def _span(values: np.ndarray) -> dict[str, float]:
    return {"median": float(np.median(values)), "min": float(values.min()), "max": float(values.max())}


def _time_batch(seed: int, rounds: int, *, intrinsics: bool) -> dict[str, Any]:
    """Rig-iterations per second of a batch of simulated rigs: step, retraction and linearisation of every rig."""
    n_steps = 5
    problem, start = _batch(seed, intrinsics=intrinsics)
    scale_px, damping = np.full(BATCH_RIGS, NOISE_PX), np.full(BATCH_RIGS, 1e-3)
    rates = []
    for round_index in range(rounds + 1):
        estimate, equations = start, problem.linearize(start, scale_px, "cauchy")
        begin = time.perf_counter()
        for _ in range(n_steps):
            estimate = problem.retract(estimate, problem.solve_step(estimate, equations, damping))
            equations = problem.linearize(estimate, scale_px, "cauchy")
        if round_index:
            rates.append(n_steps * BATCH_RIGS / (time.perf_counter() - begin))
    return {
        "rigs": BATCH_RIGS,
        "views": BATCH_VIEWS,
        "intrinsics": "free" if intrinsics else "held",
        "rig_iterations_per_s": _span(np.array(rates)),
    }


def _batch(seed: int, *, intrinsics: bool) -> tuple[BundleProblem, BundleEstimate]:
    """Rigs with poses of their own, and a start 3 deg and 5 % of the baseline off the truth."""
    rng = np.random.default_rng(seed)
    rig, board = table2_rig(), parse_board(BOARD)
    poses, detections = [], []
    for _ in range(BATCH_RIGS):
        scene = StereoScene(rig, board, sample_board_poses(rig, board, BATCH_VIEWS, rng))
        poses.append(scene.T_left_board)
        detections.append(simulate_detections(scene, rng, noise_px=NOISE_PX))
    cameras = tuple(
        CameraObservations.from_corners(
            camera_model(camera.model), np.stack([getattr(d, f"{side}_px") for d in detections]), intrinsics=intrinsics
        )
        for side, camera in (("left", rig.left), ("right", rig.right))
    )
    problem = BundleProblem(np.ascontiguousarray(board.object_points_m.T), cameras)
    truth = rig.T_right_left
    turn = so3.exp(np.radians(3) * rng.standard_normal((BATCH_RIGS, 3)) / np.sqrt(3))
    shift = 0.05 * rig.baseline_m * rng.standard_normal((BATCH_RIGS, 3)) / np.sqrt(3)
    start = BundleEstimate.of_rig(rig, stack_rigs(poses))
    return problem, replace(start, T_right_left=SE3(turn @ truth.R, truth.t + shift))


def _format(rows: list[dict[str, Any]], batches: list[dict[str, Any]], machine: str) -> str:
    def span(entry: dict[str, float] | None, scale: float, digits: int) -> str:
        if entry is None:
            return "-"
        low, middle, high = (f"{entry[key] * scale:.{digits}f}" for key in ("min", "median", "max"))
        return f"{middle} ({low}..{high})"

    peers = [name for name in ("opencv", "mrcal") if any(f"{name}_s" in row for row in rows)]
    head = [f"{'pairs':>6}", f"{'binocal ms (min..max)':>24}"]
    for name in peers:
        head += [f"{name + ' ms':>22}", f"{name + ' / binocal':>22}"]
    head += [f"{'binocal CPU ms':>20}", f"{'opencv / binocal, CPU':>22}"]
    head += [f"{'rotation error deg':>30}", f"{'translation error mm':>30}", f"{'added MB':>14}"]
    lines = [f"corners to rig, {BOARD}, noise {NOISE_PX} px ({machine})", " ".join(head)]
    for row in rows:
        cells = [f"{row['pairs']:>6}", f"{span(row['binocal_s'], 1e3, 1):>24}"]
        for name in peers:
            cells.append(f"{span(row.get(f'{name}_s'), 1e3, 0):>22}")
            cells.append(f"{span(row.get(f'{name}_over_binocal'), 1, 1):>22}")
        cells.append(f"{span(row['binocal_cpu_s'], 1e3, 1):>20}")
        cells.append(f"{span(row.get('opencv_cpu_over_binocal'), 1, 1):>22}")
        for key in ("rotation_error_deg", "translation_error_mm"):
            values = (row.get(f"{name}_{key}") for name in ("binocal", *peers))
            cells.append(f"{' / '.join(f'{value:.5f}' for value in values if value is not None):>30}")
        memory = (row.get(f"{name}_added_mb") for name in ("binocal", "opencv"))
        cells.append(f"{' / '.join(f'{mb:.1f}' for mb in memory if mb is not None):>14}")
        lines.append(" ".join(cells))
    for batch in batches:
        lines.append(
            f"{batch['rigs']} rigs of {batch['views']} views, intrinsics {batch['intrinsics']}: "
            f"{span(batch['rig_iterations_per_s'], 1, 0)} rig-iterations per second"
        )
    return "\n".join(lines)
