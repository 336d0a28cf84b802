"""Rectification: maps and pairs of full-HD cameras beside OpenCV's, in one process and in turn; and what unlike cameras' images show.

Processor time of one thread: what other processes take of the machine does not count. The last column is a pair from scratch, as it
is where a rig is calibrated anew; the one before it is what every further pair of the same rig costs.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from binocal.benchmark.unlike_cameras import UNLIKE_RIGS
from binocal.cameras import Camera, StereoRig
from binocal.geometry import SE3, so3
from binocal.rectification import RectificationMaps, rectification_map, rectify
from binocal.threads import n_threads, set_threads

SIZE_WH = (1920, 1080)
LENSES = {
    "brown4": (1500.0, (-0.12, 0.05, 4e-4, -3e-4)),
    "brown5": (1500.0, (-0.12, 0.05, 4e-4, -3e-4, 0.01)),
    "brown8": (1500.0, (-0.1, 0.04, 4e-4, -3e-4, 0.01, 0.02, 0.01, 0.003)),
    "fisheye4": (900.0, (0.02, -0.01, 0.003, -0.001)),
}


def run_rectification_benchmark(*, repetitions: int = 21, seed: int = 0) -> dict[str, Any]:
    """Milliseconds, ratios of medians, spread and the largest difference per lens model; and a canvas per rig of unlike cameras."""
    import cv2

    threads, opencv_threads = n_threads(), cv2.getNumThreads()
    set_threads(1)
    cv2.setNumThreads(1)
    try:
        rows = [_row(model, repetitions, np.random.default_rng(seed)) for model in LENSES]
    finally:
        set_threads(threads)
        cv2.setNumThreads(opencv_threads)
    canvases = [_canvas(name, rig) for name, rig in UNLIKE_RIGS.items()]
    return {
        "benchmark": "rectification",
        "size_wh": list(SIZE_WH),
        "repetitions": repetitions,
        "seed": seed,
        "opencv": cv2.__version__,
        "machine": platform.machine(),
        "rows": rows,
        "canvases": canvases,
        "text": _format(rows, cv2.__version__, repetitions) + "\n\n" + _format_canvases(canvases),
    }


def _canvas(name: str, rig: StereoRig) -> dict[str, Any]:
    """What is shown of a rig, shares of all pixels counted on the maps."""
    r = rectify(rig)
    covered = [
        float(rectification_map(camera, R, P, r.size_wh)[1].mean())
        for camera, R, P in ((rig.left, r.R_rect_left, r.P_left), (rig.right, r.R_rect_right, r.P_right))
    ]
    return {
        "rig": name,
        "projection": r.projection,
        "size_wh": list(r.size_wh),
        "covered_left": covered[0],
        "covered_right": covered[1],
        "kept": r.kept,
    }


def _format_canvases(canvases: list[dict[str, Any]]) -> str:
    lines = [f"{'rig':<40} {'projection':<16} {'size':>11} {'left':>6} {'right':>6} {'kept':>6}"]
    lines += [
        f"{c['rig']:<40} {c['projection']:<16} {c['size_wh'][0]:>5} x{c['size_wh'][1]:>4} {100 * c['covered_left']:>4.0f} % "
        f"{100 * c['covered_right']:>4.0f} % {100 * c['kept']:>4.0f} %"
        for c in canvases
    ]
    return "\n".join(lines)


def _rig(model: str) -> StereoRig:
    focal, distortion = LENSES[model]
    left, right = (
        Camera(model, SIZE_WH, np.r_[focal + 3 * i, focal + 5 * i, 962.5 - 9 * i, 536.5 + 7 * i, 0.0, distortion])
        for i in range(2)
    )
    return StereoRig(left, right, SE3(so3.exp(np.array([0.01, -0.03, 0.008])), np.array([-0.12, 0.001, 0.002])))


def _row(model: str, repetitions: int, rng: np.random.Generator) -> dict[str, Any]:
    import cv2

    rig = _rig(model)
    r = rectify(rig, projection="pinhole", size_wh=SIZE_WH)
    package = cv2.fisheye if model == "fisheye4" else cv2
    sides = ((rig.left, r.R_rect_left, r.P_left), (rig.right, r.R_rect_right, r.P_right))
    images = [rng.integers(0, 255, SIZE_WH[::-1], dtype=np.uint8) for _ in sides]

    def their_map(camera: Camera, R: Any, P: Any) -> Any:
        return package.initUndistortRectifyMap(camera.K, camera.distortion, R, P[:, :3], SIZE_WH, cv2.CV_32FC1)

    def their_pair() -> None:
        for image, side in zip(images, sides, strict=True):
            x, y = their_map(*side)
            cv2.remap(image, x, y, cv2.INTER_LINEAR)

    def their_remap() -> None:
        for image, (x, y) in zip(images, kept_theirs, strict=True):
            cv2.remap(image, x, y, cv2.INTER_LINEAR)

    kept_ours, kept_theirs = RectificationMaps.of(rig, r), [their_map(*side) for side in sides]
    source, is_inside = rectification_map(*sides[0], SIZE_WH)
    difference = np.abs(source - np.stack(kept_theirs[0], axis=-1))[is_inside]
    timed = {
        "map": (lambda: rectification_map(*sides[0], SIZE_WH), lambda: their_map(*sides[0])),
        "kept": (lambda: kept_ours.rectify(images[0], images[1]), their_remap),
        "pair": (lambda: RectificationMaps.of(rig, r).rectify(images[0], images[1]), their_pair),
    }
    row: dict[str, Any] = {"model": model, "largest_difference_px": float(difference.max())}
    for name, (ours, theirs) in timed.items():
        row |= {f"{name}_{key}": value for key, value in _compare(ours, theirs, repetitions).items()}
    return row


def _compare(ours: Callable[[], Any], theirs: Callable[[], Any], repetitions: int) -> dict[str, float]:
    times = np.empty((repetitions, 2))
    for i in range(-1, repetitions):  # the first is not counted
        for k, run in enumerate((ours, theirs)):
            start = time.process_time()
            run()
            times[max(i, 0), k] = time.process_time() - start
    low, high = np.quantile(times[:, 0] / times[:, 1], (0.1, 0.9))
    mine, peer = np.median(times, axis=0)
    return {"ms": 1e3 * mine, "opencv_ms": 1e3 * peer, "ratio": mine / peer, "ratio_p10": low, "ratio_p90": high}


def _format(rows: list[dict[str, Any]], version: str, repetitions: int) -> str:
    lines = [
        f"rectification at {SIZE_WH[0]} x {SIZE_WH[1]}, one thread, processor time, medians of {repetitions}; OpenCV {version}",
        f"{'':<10} {'one map: ms':>12} {'OpenCV':>8} {'ratio (10-90 %)':>18} {'kept maps':>10} {'from scratch':>13} {'difference':>12}",
    ]
    lines += [
        f"{r['model']:<10} {r['map_ms']:>12.2f} {r['map_opencv_ms']:>8.2f} "
        f"{r['map_ratio']:>6.2f} ({r['map_ratio_p10']:.2f}-{r['map_ratio_p90']:.2f}) {r['kept_ratio']:>10.2f} {r['pair_ratio']:>13.2f} "
        f"{r['largest_difference_px']:>9.1e} px"
        for r in rows
    ]
    return "\n".join(lines)
