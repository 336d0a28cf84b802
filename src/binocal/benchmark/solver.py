"""Corners to rig: binocal's ``lm`` against OpenCV's mono calibrations followed by the joint stereo solve.

The peer is given what it does best: exact board, all corners, five distortion coefficients, no outliers, intrinsics
refined jointly (``CALIB_USE_INTRINSIC_GUESS``). binocal does more in its time: robust loss, view checks, covariance.
"""

from __future__ import annotations

import platform
import time
from typing import Any

import numpy as np

from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.detections import Detections
from binocal.geometry import so3
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig

BOARD = "chessboard:11x8:20mm"
NOISE_PX = 0.2
PEER_LIMIT_PAIRS = 200  # the peer's time grows with the cube of the views


def scene(n_views: int, seed: int) -> tuple[StereoScene, Detections]:
    """A simulated recording of the table-2 rig and its corners."""
    rng = np.random.default_rng(seed)
    rig, board = table2_rig(), parse_board(BOARD)
    views = StereoScene(rig, board, sample_board_poses(rig, board, n_views, rng))
    return views, simulate_detections(views, rng, noise_px=NOISE_PX)


def run_opencv(detections: Detections) -> tuple[float, np.ndarray, np.ndarray]:
    """Seconds, R and t of OpenCV calibrations of each camera and the joint solve."""
    import cv2

    points = [np.ascontiguousarray(detections.object_points_m, dtype=np.float32)] * detections.n_views
    left = [np.ascontiguousarray(p, dtype=np.float32)[:, None] for p in detections.left_px]
    right = [np.ascontiguousarray(p, dtype=np.float32)[:, None] for p in detections.right_px]
    size = detections.left_size_wh
    start = time.perf_counter()
    _, K_l, d_l, _, _ = cv2.calibrateCamera(points, left, size, None, None)
    _, K_r, d_r, _, _ = cv2.calibrateCamera(points, right, size, None, None)
    result = cv2.stereoCalibrate(points, left, right, K_l, d_l, K_r, d_r, size, flags=cv2.CALIB_USE_INTRINSIC_GUESS)
    return time.perf_counter() - start, result[5], result[6].ravel()


def _run_binocal(detections: Detections) -> tuple[float, np.ndarray, np.ndarray]:
    start = time.perf_counter()
    calibration = calibrate(detections, calibrator="lm", model="brown5")
    elapsed_s = time.perf_counter() - start
    return elapsed_s, calibration.rig.T_right_left.R, calibration.rig.T_right_left.t


def run_solver_benchmark(
    *, pairs: tuple[int, ...] = (20, 50, 100, 200), rounds: int = 5, seed: int = 0
) -> dict[str, Any]:
    """Time both in turn, ``rounds`` times per number of pairs after one warm-up round.

    Medians, spread, errors against the truth.
    """
    import cv2

    rows = []
    for n_views in pairs:
        times: dict[str, list[float]] = {"opencv": [], "binocal": []}
        errors: dict[str, list[tuple[float, float]]] = {"opencv": [], "binocal": []}
        for round_index in range(rounds + 1):
            truth_scene, detections = scene(n_views, seed + 1000 * round_index + n_views)
            truth = truth_scene.rig.T_right_left
            for name, method in (("binocal", _run_binocal), ("opencv", run_opencv)):
                if name == "opencv" and n_views > PEER_LIMIT_PAIRS:
                    continue
                elapsed_s, R, t = method(detections)
                if round_index:
                    times[name].append(elapsed_s)
                    rotation_deg = float(np.degrees(so3.angle_rad(R @ truth.R.T)))
                    errors[name].append((rotation_deg, 1e3 * float(np.linalg.norm(t - truth.t))))
        row: dict[str, Any] = {"pairs": n_views}
        for name, seconds in times.items():
            if seconds:
                row[f"{name}_s"] = {"median": float(np.median(seconds)), "min": min(seconds), "max": max(seconds)}
                rotation_deg, translation_mm = np.median(np.array(errors[name]), axis=0)
                row[f"{name}_rotation_error_deg"] = float(rotation_deg)
                row[f"{name}_translation_error_mm"] = float(translation_mm)
        if times["opencv"]:
            ratios = np.array(times["opencv"]) / np.array(times["binocal"])
            row["opencv_over_binocal"] = {
                "median": float(np.median(ratios)),
                "min": float(ratios.min()),
                "max": float(ratios.max()),
            }
        rows.append(row)
    machine = (
        f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}, OpenCV {cv2.__version__}"
    )
    return {
        "benchmark": "solver",
        "board": BOARD,
        "noise_px": NOISE_PX,
        "rounds": rounds,
        "seed": seed,
        "machine": machine,
        "rows": rows,
        "text": _format(rows, machine),
    }


def _format(rows: list[dict[str, Any]], machine: str) -> str:
    lines = [
        f"corners to rig, {BOARD}, noise {NOISE_PX} px ({machine})",
        f"{'pairs':>6} {'binocal ms (min..max)':>26} {'OpenCV ms (min..max)':>28} {'ratio (min..max)':>22} "
        f"{'rotation error deg':>24} {'translation error mm':>24}",
    ]
    for row in rows:
        ours, theirs, ratio = row["binocal_s"], row.get("opencv_s"), row.get("opencv_over_binocal")

        def span(entry: dict[str, float] | None, scale: float, digits: int) -> str:
            if entry is None:
                return "-"
            return (
                f"{entry['median'] * scale:.{digits}f} "
                f"({entry['min'] * scale:.{digits}f}..{entry['max'] * scale:.{digits}f})"
            )

        def pair(key: str, row: dict[str, Any] = row) -> str:
            theirs = row.get(f"opencv_{key}")
            return f"{row[f'binocal_{key}']:.5f}" + (f" / {theirs:.5f}" if theirs is not None else "")

        lines.append(
            f"{row['pairs']:>6} {span(ours, 1e3, 1):>26} {span(theirs, 1e3, 0):>28} {span(ratio, 1, 1):>22} "
            f"{pair('rotation_error_deg'):>24} {pair('translation_error_mm'):>24}"
        )
    return "\n".join(lines)
