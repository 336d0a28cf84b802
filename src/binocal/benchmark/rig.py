"""Images to the rig: errors against the truth, binocal beside OpenCV's joint solve and the tutorials' pipeline.

Rendered pairs of the paper's rig (table 2), blur 0.8 px, noise 3 grey levels; every method finds its own corners in the
same files. OpenCV fits its five distortion coefficients, binocal the same ones, and what it does unasked: the model that
held-out views choose. The tutorial holds the intrinsics of the single cameras.
"""

from __future__ import annotations

import platform
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.benchmark.opencv_peer import calibrate_views
from binocal.benchmark.scenes import render_scene_pairs
from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.datasets.folder import ImagePair
from binocal.detection import detect_pairs
from binocal.detection.opencv_finder import find_corners_with_opencv, pair_corners, read_grey
from binocal.evidence import Detections
from binocal.geometry import so3
from binocal.simulation import table2_rig

BOARD = "chessboard:11x8:20mm"
Pose = tuple[ndarray, ndarray]


def run_rig_benchmark(*, pairs: int = 20, sets: int = 24, seed: int = 0) -> dict[str, Any]:
    """``sets`` recordings of ``pairs`` pairs; RMS and median errors of each method, and binocal's over the others'."""
    rig = table2_rig()
    truth, size_wh = rig.T_right_left, rig.left.size_wh
    errors: dict[str, list[tuple[float, float]]] = {}
    for index in range(sets):
        with tempfile.TemporaryDirectory(prefix="binocal-bench-") as folder:
            _, listed = render_scene_pairs(Path(folder), pairs, BOARD, size_wh, seed + index, rig=rig)
            for name, (R, t) in _estimates(listed, size_wh).items():
                rotation_deg = float(np.degrees(so3.angle_rad(R @ truth.R.T)))
                errors.setdefault(name, []).append((rotation_deg, 1e3 * float(np.linalg.norm(t - truth.t))))
    own = np.array(errors["binocal"])
    rows = [_row(name, np.array(of_sets), own) for name, of_sets in errors.items()]
    machine = f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}"
    return {
        "benchmark": "rig",
        "board": BOARD,
        "pairs": pairs,
        "sets": sets,
        "seed": seed,
        "machine": machine,
        "rows": rows,
        "text": _format(rows, pairs, sets, machine),
    }


def _estimates(listed: list[ImagePair], size_wh: tuple[int, int]) -> dict[str, Pose]:
    """R and t of each method."""
    board = parse_board(BOARD)
    paths = [path for pair in listed for path in (pair.left_path, pair.right_path)]
    corners = [find_corners_with_opencv(read_grey(path), board) for path in paths]
    left, right = pair_corners(corners)
    detections = detect_pairs(listed, board).detections
    ways: dict[str, Callable[[], Pose]] = {
        "binocal": lambda: _calibrate(detections, "auto"),
        "binocal, brown5": lambda: _calibrate(detections, "brown5"),
        "OpenCV, joint": lambda: calibrate_views(board.object_points_m, left, right, size_wh),
        "OpenCV, tutorial": lambda: calibrate_views(board.object_points_m, left, right, size_wh, is_joint=False),
    }
    return {name: way() for name, way in ways.items()}


def _calibrate(detections: Detections, model: str) -> Pose:
    T = calibrate(detections, model=model).rig.T_right_left
    return T.R, T.t


def _row(name: str, errors: ndarray, own: ndarray) -> dict[str, Any]:
    row: dict[str, Any] = {"way": name}
    for column, key in enumerate(("rotation_error_deg", "translation_error_mm")):
        values = errors[:, column]
        rms = float(np.sqrt(np.mean(values**2)))
        row[key] = {
            "rms": rms,
            "median": float(np.median(values)),
            "min": float(values.min()),
            "max": float(values.max()),
        }
        row[f"binocal_over_{key}"] = float(np.sqrt(np.mean(own[:, column] ** 2))) / rms
    return row


def _format(rows: list[dict[str, Any]], pairs: int, sets: int, machine: str) -> str:
    lines = [
        f"{sets} sets of {pairs} rendered pairs to the rig, {BOARD} ({machine})",
        f"{'way':>18} {'rotation deg: rms, median':>28} {'translation mm: rms, median':>30} {'binocal over it':>18}",
    ]
    for row in rows:
        rotation, translation = row["rotation_error_deg"], row["translation_error_mm"]
        ratios = f"{row['binocal_over_rotation_error_deg']:.2f}, {row['binocal_over_translation_error_mm']:.3f}"
        lines.append(
            f"{row['way']:>18} {rotation['rms']:>18.5f}, {rotation['median']:.5f}  "
            f"{translation['rms']:>19.5f}, {translation['median']:.5f} {ratios:>18}"
        )
    return "\n".join(lines)
