"""PNG pairs to the rig with two threads: binocal, OpenCV's pipeline, and the decoding of the files alone.

OpenCV is given what it does best among its fast ways: the classic chessboard finder, ``cornerSubPix``, one calibration
per camera and the joint stereo solve with five coefficients, its images read and searched by as many threads as
binocal's. Everything is timed in turn in each round, so that what else the machine does strikes all alike.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from binocal.benchmark.opencv_peer import calibrate_views
from binocal.benchmark.scenes import render_scene_pairs
from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.cameras import StereoRig
from binocal.datasets.folder import ImagePair
from binocal.detection import detect_pairs
from binocal.detection.opencv_finder import find_corners_with_opencv, pair_corners, read_grey
from binocal.geometry import so3

BOARD = "chessboard:11x8:20mm"
SIZE_WH = (1280, 960)
MODEL = "brown5"
N_THREADS = 2


def run_pipeline_benchmark(*, pairs: int = 100, rounds: int = 3, seed: int = 0) -> dict[str, Any]:
    """Render ``pairs`` pairs, then time every way ``rounds`` times after one round that warms the file cache.

    Medians, spread, ratios to decoding alone, errors of the rig against the truth.
    """
    import cv2

    own_threads = cv2.getNumThreads()
    with tempfile.TemporaryDirectory(prefix="binocal-bench-") as folder:
        rig, listed = render_scene_pairs(Path(folder), pairs, BOARD, SIZE_WH, seed)
        ways: dict[str, Callable[[], StereoRigLike]] = {
            "decode": lambda: _decode(listed),
            "binocal": lambda: _run_binocal(listed),
            "opencv": lambda: _run_opencv(listed),
            "binocal process": lambda: _run_process(Path(folder)),
        }
        times: dict[str, list[float]] = {name: [] for name in ways}
        errors: dict[str, tuple[float, float]] = {}
        try:
            cv2.setNumThreads(1)
            for round_index in range(rounds + 1):
                for name, way in ways.items():
                    start = time.perf_counter()
                    found = way()
                    if round_index:
                        times[name].append(time.perf_counter() - start)
                    if found is not None:
                        errors[name] = _errors(*found, rig)
        finally:
            cv2.setNumThreads(own_threads)
    rows = []
    decode = np.array(times["decode"])
    for name, seconds in times.items():
        ratio = np.array(seconds) / decode
        row: dict[str, Any] = {
            "way": name,
            "s": {"median": float(np.median(seconds)), "min": min(seconds), "max": max(seconds)},
            "over_decode": {"median": float(np.median(ratio)), "min": float(ratio.min()), "max": float(ratio.max())},
        }
        if name in errors:
            row["rotation_error_deg"], row["translation_error_mm"] = errors[name]
        rows.append(row)
    machine = (
        f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, OpenCV {cv2.__version__}"
    )
    return {
        "benchmark": "pipeline",
        "board": BOARD,
        "pairs": pairs,
        "rounds": rounds,
        "seed": seed,
        "machine": machine,
        "rows": rows,
        "text": _format(rows, pairs, machine),
    }


StereoRigLike = tuple[np.ndarray, np.ndarray] | None


def _decode(listed: Sequence[ImagePair]) -> None:
    import cv2

    paths = [str(path) for pair in listed for path in (pair.left_path, pair.right_path)]
    with ThreadPoolExecutor(N_THREADS) as pool:
        if any(image is None for image in pool.map(lambda path: cv2.imread(path, cv2.IMREAD_UNCHANGED), paths)):
            raise RuntimeError("a rendered image could not be decoded")


def _run_binocal(listed: Sequence[ImagePair]) -> StereoRigLike:
    found = detect_pairs(listed, parse_board(BOARD), n_threads=N_THREADS)
    T = calibrate(found.detections, calibrator="lm", model=MODEL).rig.T_right_left
    return T.R, T.t


def _run_process(folder: Path) -> StereoRigLike:
    """The command line from its start to ``rig.json``, in a process of its own."""
    from binocal.formats.rig_json import read_rig

    output = folder / "rig.json"
    command = [sys.executable, "-m", "binocal", "calibrate", "--left", str(folder / "left_*.png")]
    command += ["--right", str(folder / "right_*.png"), "--board", BOARD, "--model", MODEL]
    command += ["--output", str(output), "--force"]
    env = os.environ | {"PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry)}
    env.pop("PYTHONDONTWRITEBYTECODE", None)  # an installed package is compiled
    subprocess.run(command, check=True, capture_output=True, env=env)
    T = read_rig(output).T_right_left
    return T.R, T.t


def _run_opencv(listed: Sequence[ImagePair]) -> StereoRigLike:
    import cv2

    board = parse_board(BOARD)
    paths = [path for pair in listed for path in (pair.left_path, pair.right_path)]
    with ThreadPoolExecutor(N_THREADS) as pool:
        found = pool.map(lambda path: find_corners_with_opencv(read_grey(path), board), paths)
        left, right = pair_corners(list(found))
    if len(left) < 3:
        return None
    cv2.setNumThreads(N_THREADS)
    try:
        return calibrate_views(board.object_points_m, left, right, SIZE_WH)
    finally:
        cv2.setNumThreads(1)


def _errors(R: np.ndarray, t: np.ndarray, rig: StereoRig) -> tuple[float, float]:
    truth = rig.T_right_left
    return float(np.degrees(so3.angle_rad(R @ truth.R.T))), 1e3 * float(np.linalg.norm(t - truth.t))


def _format(rows: list[dict[str, Any]], pairs: int, machine: str) -> str:
    width, height = SIZE_WH
    lines = [
        f"{pairs} PNG pairs {width}x{height} to the rig, {N_THREADS} threads, {BOARD}, {MODEL} ({machine})",
        f"{'way':>16} {'s (min..max)':>22} {'over decoding alone':>24} {'rotation deg':>13} {'translation mm':>15}",
    ]
    for row in rows:
        s, r = row["s"], row["over_decode"]
        error = "".join(
            f" {row[key]:>{width}.{digits}f}" if key in row else ""
            for key, width, digits in (("rotation_error_deg", 13, 5), ("translation_error_mm", 15, 5))
        )
        lines.append(
            f"{row['way']:>16} {s['median']:>8.2f} ({s['min']:.2f}..{s['max']:.2f}) "
            f"{r['median']:>10.2f} ({r['min']:.2f}..{r['max']:.2f}){error}"
        )
    return "\n".join(lines)
