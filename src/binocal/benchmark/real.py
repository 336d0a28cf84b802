"""Real recordings, halved at random: how far two rigs from one recording differ, against peers and against stated sigmas.

Corners are detected once. One calibration of all views by binocal repairs their orders and rejects views, for every
method alike. Then each method calibrates both halves of every split. The halves share the board, the lenses and the
operator: a small difference shows that a figure repeats, not that it is true.
"""

from __future__ import annotations

import platform
import time
import zlib
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy import ndarray

from binocal import __version__
from binocal.benchmark.halves import (
    Estimate,
    HeldOutRows,
    depth_scores,
    differences_by_split,
    held_out_rows,
    rms,
    split_halves,
    stated_sigmas,
    summarise_depth,
    summarise_z,
    z_scores,
)
from binocal.benchmark.mrcal_peer import LENS_MODELS, calibrate_rig_with_mrcal, find_mrcal
from binocal.benchmark.opencv_peer import calibrate_rig
from binocal.benchmark.real_sets import RealSet, SetSource, find_sets, load_set, same_points
from binocal.benchmark.real_table import FIGURES, format_table
from binocal.calibrators import calibrate
from binocal.cameras import StereoRig
from binocal.errors import BinocalError, DataError
from binocal.evidence import Detections
from binocal.threads import n_processors

N_SPLITS = 6
QUICK_SPLITS, QUICK_SETS = 3, 3
MIN_VIEWS = 8  # halves of fewer than four views say little of any method
OURS = ("binocal", "binocal auto")
PEERS = ("OpenCV", "OpenCV, own corners", "mrcal")
Halves = Sequence[tuple[ndarray, ndarray]]


@dataclass(frozen=True, slots=True, eq=False)
class _Views:
    """Used views of a recording: by binocal's corners, and by OpenCV's where there are such."""

    detections: Detections
    opencv_detections: Detections | None
    model: str

    def select(self, views: ndarray) -> _Views:
        own = self.opencv_detections
        return _Views(self.detections.select(views), None if own is None else own.select(views), self.model)


def run_real_benchmark(
    *, sets: Sequence[str] = (), splits: int | None = None, quick: bool = False, seed: int = 0
) -> dict[str, Any]:
    """Differences between random halves, rows on the other half, and differences over stated sigmas, by recording and method.

    ``sets`` are folders, files of corners or names, see :func:`binocal.benchmark.real_sets.find_sets`; by default all that are there.
    ``quick``: the first three of them, three splits. A recording or half that fails is named.

    Raises:
        DataError: No recording was found, or none can be used.
    """
    import cv2

    sources = find_sets(sets)
    if quick and not sets:
        sources = sources[:QUICK_SETS]
    n_splits = splits or (QUICK_SPLITS if quick else N_SPLITS)
    own_threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    start = time.perf_counter()
    try:
        rows, z, depth_z, failures = _run_sets(sources, n_splits, seed)
    finally:
        cv2.setNumThreads(own_threads)
    if not rows:
        raise DataError("; ".join(f"{name}: {text}" for name, text in failures.items()))
    table: dict[str, Any] = {
        "benchmark": "real",
        "version": __version__,
        "splits": n_splits,
        "seed": seed,
        "machine": (
            f"{platform.machine()}, {n_processors()} processors, Python {platform.python_version()}, NumPy {np.__version__}, "
            f"OpenCV {cv2.__version__}, {'with' if find_mrcal() else 'no'} mrcal"
        ),
        "elapsed_s": time.perf_counter() - start,
        "rows": rows,
        "pooled_z": {
            name: summarise_z(np.concatenate(scores)) | {"depth": summarise_depth(depth_z[name])}
            for name, scores in z.items()
        },
        "ratios": ratios_to_peers(rows),
        "failed_sets": failures,
    }
    return table | {"text": format_table(table)}


def _run_sets(
    sources: Sequence[SetSource], n_splits: int, seed: int
) -> tuple[list[dict[str, Any]], dict[str, list[ndarray]], dict[str, list[ndarray]], dict[str, str]]:
    """Rows, z scores by method, those of depth, and why a recording gave none."""
    rows, failures = [], {}
    z: dict[str, list[ndarray]] = {name: [] for name in OURS}
    depth_z: dict[str, list[ndarray]] = {name: [] for name in OURS}
    for source in sources:
        try:
            row, scores, depths = run_set(load_set(source), n_splits, seed)
        except (BinocalError, OSError) as error:
            failures[source.name] = _one_line(error)
            continue
        rows.append(row)
        for name in z:
            z[name].append(scores[name])
            depth_z[name] += depths[name]
    return rows, z, depth_z, failures


def run_set(
    recording: RealSet, n_splits: int, seed: int
) -> tuple[dict[str, Any], dict[str, ndarray], dict[str, list[ndarray]]]:
    """A recording's figures by method, and binocal's z scores: of the rig's figures, and of depth split by split.

    Raises:
        BinocalError: No rig follows from all of its views, or fewer than eight of them can be used.
    """
    source = recording.source
    views, used = _used_views(recording)
    n_given = recording.detections.n_views
    if len(used) < MIN_VIEWS:
        raise DataError(f"{len(used)} of {n_given} views can be used; two halves need {MIN_VIEWS}.")
    halves = split_halves(n_given, used, n_splits, (seed, zlib.crc32(source.name.encode())))
    row: dict[str, Any] = {
        "set": source.name,
        "views": len(used),
        "views_given": n_given,
        "board": source.board or recording.detections.board_spec or f"{len(views.detections.object_points_m)} points",
        "model": source.model,
        "opencv_views": None if views.opencv_detections is None else _n_seen_by_both(views.opencv_detections),
        "methods": {},
        "not_run": {},
    }
    scores, depth_z = {}, {}
    for name, method in _methods().items():
        reason = _cannot_run(name, views)
        if reason:
            row["not_run"][name] = reason
            continue
        pairs = [(method(views.select(a)), method(views.select(b))) for a, b in halves]
        row["methods"][name] = summarise_method(pairs, halves, views.detections)
        if name in OURS:
            scores[name] = z_scores(pairs)
            depths = depth_scores(pairs)
            row["methods"][name]["z"] = summarise_z(scores[name]) | {"depth": summarise_depth(depths)}
            depth_z[name] = depths
    return row, scores, depth_z


def _used_views(recording: RealSet) -> tuple[_Views, ndarray]:
    """Views that a calibration of all of them used, with the corners as detected in repaired orders; and which they are."""
    given, model = recording.detections, recording.source.model
    full = calibrate(given, model=model)
    place = {name: i for i, name in enumerate(given.names)}
    used = np.array([place[view.name] for view in full.views], dtype=int)
    repaired = given.select(used)
    for side in ("left", "right"):
        orders = {i: np.array(order) for i, view in enumerate(full.views) if (order := getattr(view, f"{side}_order"))}
        repaired = repaired.reorder(side, orders)
    own = recording.opencv_detections
    return _Views(repaired, None if own is None else same_points(own, repaired), model), used


def _n_seen_by_both(detections: Detections) -> int:
    return int((detections.left_is_seen.any(axis=1) & detections.right_is_seen.any(axis=1)).sum())


def _methods() -> dict[str, Callable[[_Views], Estimate]]:
    return {
        "binocal": lambda views: _by_binocal(views.detections, views.model),
        "binocal auto": lambda views: _by_binocal(views.detections, "auto"),
        "OpenCV": lambda views: _by_peer(calibrate_rig, views.detections, views.model),
        "OpenCV, own corners": lambda views: _by_peer(calibrate_rig, views.opencv_detections, views.model),
        "mrcal": lambda views: _by_peer(calibrate_rig_with_mrcal, views.detections, mrcal_model(views.model)),
    }


def mrcal_model(model: str) -> str:
    """The model for mrcal: it has no equidistant one with coefficients; its eight-coefficient rational one comes nearest."""
    return model if model in LENS_MODELS else "brown8"


def _cannot_run(name: str, views: _Views) -> str:
    """Why a method cannot run on a recording at all, if so."""
    if name == "OpenCV, own corners" and views.opencv_detections is None:
        return "no images of a chessboard"
    if name == "mrcal" and find_mrcal() is None:
        return "no Python here has it"
    return ""


def _by_binocal(detections: Detections, model: str) -> Estimate:
    try:
        calibration = calibrate(detections, model=model)
    except BinocalError as error:
        return Estimate(failure=_one_line(error))
    codes = tuple(found.code for found in calibration.findings)
    return Estimate(calibration.rig, stated_sigmas(calibration), codes, calibration=calibration)


def _by_peer(solve: Callable[[Detections, str], StereoRig], detections: Detections | None, model: str) -> Estimate:
    import cv2

    assert detections is not None, "a method that needs OpenCV's corners is not asked where there are none"
    try:
        rig = solve(detections, model)
    except (cv2.error, RuntimeError, ValueError) as error:  # ValueError: cameras that are none, such as those of NaN
        return Estimate(failure=_one_line(error))
    return Estimate(rig) if np.isfinite(rig.T_right_left.t).all() else Estimate(failure="the rig is not finite")


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def summarise_method(
    pairs: Sequence[tuple[Estimate, Estimate]], halves: Halves, detections: Detections
) -> dict[str, Any]:
    """A method's figures over the splits and by split, its failures with their texts, its findings with how often they came.

    A figure is the RMS over the splits (of rows, over all halves) that gave it.
    """
    every = [estimate for pair in pairs for estimate in pair]
    others = [views for a, b in halves for views in (b, a)]
    none = HeldOutRows(np.nan, np.nan, 0)
    rows = [
        none if estimate.rig is None else held_out_rows(estimate.rig, detections.select(views))
        for estimate, views in zip(every, others, strict=True)
    ]
    by_split = differences_by_split(pairs) | {
        "rows_rms_px": np.array([found.rms_px for found in rows]),
        "rows_median_view_px": np.array([found.median_view_px for found in rows]),
    }
    failed = [estimate.failure for estimate in every if estimate.failure]
    rigs = [estimate.rig for estimate in every if estimate.rig is not None]
    return {figure: rms(values) for figure, values in by_split.items()} | {
        "by_split": by_split,
        "n_halves": len(every),
        "n_failed": len(failed),
        "failures": dict(Counter(failed)),
        "n_not_rectified": len(rigs) - sum(np.isfinite(found.rms_px) for found in rows),
        "n_corners_without_ray": sum(found.n_without_ray for found in rows),
        "models": dict(Counter(rig.left.model for rig in rigs)),
        "findings": dict(Counter(code for estimate in every for code in estimate.findings)),
    }


def ratios_to_peers(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Our figures over the peers', by method: over the best peer of each recording, and medians over the recordings.

    A ratio is over the splits that both gave; the best peer of a figure is the one with the greatest ratio.
    """
    result: dict[str, dict[str, Any]] = {}
    for ours in OURS:
        by_peer = {peer: {row["set"]: _ratios(row["methods"], ours, peer) for row in rows} for peer in PEERS}
        best = {
            row["set"]: {f: _greatest([by_peer[peer][row["set"]].get(f, np.nan) for peer in PEERS]) for f in FIGURES}
            for row in rows
        }
        result[ours] = {"best peer": {"by_set": best, "median": _medians(best)}} | {
            peer: {"by_set": by_set, "median": _medians(by_set)} for peer, by_set in by_peer.items()
        }
    return result


def _ratios(methods: dict[str, Any], ours: str, peer: str) -> dict[str, float]:
    if ours not in methods or peer not in methods:
        return {}
    ratios = {}
    for figure in FIGURES:
        a, b = methods[ours]["by_split"][figure], methods[peer]["by_split"][figure]
        both = np.isfinite(a) & np.isfinite(b)
        ratios[figure] = rms(a[both]) / rms(b[both]) if both.any() else np.nan
    return ratios


def _greatest(values: Sequence[float]) -> float:
    known = [value for value in values if np.isfinite(value)]
    return max(known) if known else np.nan


def _medians(by_set: dict[str, dict[str, float]]) -> dict[str, float]:
    medians = {}
    for figure in FIGURES:
        known = [found[figure] for found in by_set.values() if np.isfinite(found.get(figure, np.nan))]
        medians[figure] = float(np.median(known)) if known else np.nan
    return medians
