"""Benchmarks against peers: each runs them in turn in one process and reports medians, spread and failures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


def _solver(**options: Any) -> dict[str, Any]:
    from binocal.benchmark.solver import run_solver_benchmark

    return run_solver_benchmark(**options)


def _plan(**options: Any) -> dict[str, Any]:
    from binocal.benchmark.plan import run_plan_benchmark

    return run_plan_benchmark(**options)


def _precision(**options: Any) -> dict[str, Any]:
    from binocal.benchmark.precision import run_precision_benchmark

    return run_precision_benchmark(**options)


def _corners(**options: Any) -> dict[str, Any]:
    from binocal.benchmark.corners import run_corners_benchmark

    return run_corners_benchmark(**options)


def _coverage(**options: Any) -> dict[str, Any]:
    from binocal.benchmark.coverage import run_coverage_benchmark

    return run_coverage_benchmark(**options)


def _detection(**options: Any) -> dict[str, Any]:
    from binocal.benchmark.detection import run_detection_benchmark

    return run_detection_benchmark(**options)


def _boards(**options: Any) -> dict[str, Any]:
    from binocal.benchmark.circle_boards import run_board_benchmark

    return run_board_benchmark(**options)


def _circles(**options: Any) -> dict[str, Any]:
    from binocal.benchmark.circle_centres import run_circle_centres_benchmark

    return run_circle_centres_benchmark(**options)


def _markers(**options: Any) -> dict[str, Any]:
    from binocal.benchmark.marker_corners import run_marker_corners_benchmark

    return run_marker_corners_benchmark(**options)


def _drift(**options: Any) -> dict[str, Any]:
    from binocal.benchmark.drift import run_drift_benchmark

    return run_drift_benchmark(**options)


def _sound(**options: Any) -> dict[str, Any]:
    from binocal.benchmark.sound import run_sound_benchmark

    return run_sound_benchmark(**options)


def _faults(**options: Any) -> dict[str, Any]:
    from binocal.benchmark.faults import run_faults_benchmark

    return run_faults_benchmark(**options)


def _fisheye(**options: Any) -> dict[str, Any]:
    from binocal.benchmark.fisheye import run_fisheye_benchmark

    return run_fisheye_benchmark(**options)


def _natural(**options: Any) -> dict[str, Any]:
    from binocal.benchmark.natural import run_natural_benchmark

    return run_natural_benchmark(**options)


def _pipeline(**options: Any) -> dict[str, Any]:
    from binocal.benchmark.pipeline import run_pipeline_benchmark

    return run_pipeline_benchmark(**options)


def _rig(**options: Any) -> dict[str, Any]:
    from binocal.benchmark.rig import run_rig_benchmark

    return run_rig_benchmark(**options)


def _real(**options: Any) -> dict[str, Any]:
    from binocal.benchmark.real import run_real_benchmark

    return run_real_benchmark(**options)


def _rectification(**options: Any) -> dict[str, Any]:
    from binocal.benchmark.rectification import run_rectification_benchmark

    return run_rectification_benchmark(**options)


def _related(**options: Any) -> dict[str, Any]:
    from binocal.benchmark.related import run_related_benchmark

    return run_related_benchmark(**options)


def _scale(**options: Any) -> dict[str, Any]:
    from binocal.benchmark.scale import run_scale_benchmark

    return run_scale_benchmark(**options)


def _agent(**options: Any) -> dict[str, Any]:
    from binocal.benchmark.agent import run_agent_benchmark

    return run_agent_benchmark(**options)


def _training(**options: Any) -> dict[str, Any]:
    from binocal.benchmark.training import run_training_benchmark

    return run_training_benchmark(**options)


def _uncertainty(**options: Any) -> dict[str, Any]:
    from binocal.benchmark.uncertainty import run_uncertainty_benchmark

    return run_uncertainty_benchmark(**options)


BENCHMARKS: dict[str, Callable[..., dict[str, Any]]] = {
    "agent": _agent,
    "boards": _boards,
    "circles": _circles,
    "corners": _corners,
    "coverage": _coverage,
    "detection": _detection,
    "drift": _drift,
    "faults": _faults,
    "fisheye": _fisheye,
    "markers": _markers,
    "natural": _natural,
    "pipeline": _pipeline,
    "plan": _plan,
    "precision": _precision,
    "real": _real,
    "rectification": _rectification,
    "related": _related,
    "rig": _rig,
    "scale": _scale,
    "solver": _solver,
    "sound": _sound,
    "training": _training,
    "uncertainty": _uncertainty,
}


def run(name: str, **options: Any) -> dict[str, Any]:
    """Run the benchmark of that name and return its table as plain data; ``text`` holds it readable.

    Raises:
        ValueError: No such benchmark.
    """
    try:
        benchmark = BENCHMARKS[name]
    except KeyError:
        raise ValueError(f"unknown benchmark {name!r}; known: {', '.join(BENCHMARKS)}") from None
    return benchmark(**options)
