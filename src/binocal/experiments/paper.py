"""The paper's experiment: its cases, the methods that it compares, and the figures that it prints."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from binocal.experiments.boards import MODEL, RenderedBoards, board_errors, nominal_rig
from binocal.experiments.case import (
    AtBound,
    ByCalibrator,
    Case,
    Method,
    OpenCVThroughout,
    PriorUnchanged,
    by_calibrator,
)
from binocal.experiments.colours import colour_cases
from binocal.experiments.convergence import convergence_cases
from binocal.experiments.guesses import AsPrinted, guess_cases
from binocal.experiments.options import ExperimentOptions
from binocal.experiments.preparations import preparation_cases
from binocal.experiments.related import own_input_cases
from binocal.experiments.target_distance import distance_cases
from binocal.experiments.trained import can_train, trained_cases

LENGTH = "relative length error"
CORRECT = "parameters correct (eq. 20)"
PROPOSED = "drl"
TABLE_3 = {
    PROPOSED: (0.36, 0.35),
    "alternating": (0.90, 1.32),
    "absolute-orientation": (1.66, 3.27),
    "heterogeneous": (1.94, 2.58),
    "wide-field": (5.65, 5.20),
}
"""What the paper's table 3 prints, percent, for boards of 10 and of 20 mm squares."""
SHAPES = {"": (0.0, 0.0), ", as printed": (3e-4, 5e-5)}
"""Bow and print error of the boards by the end of a case's name, metres."""
BOARDS = ("chessboard:11x8:10mm", "chessboard:11x8:20mm")


def methods() -> tuple[Method, ...]:
    """Every calibrator that works from a board's corners, what the data sheet says, and the bound.

    ``wide-field`` knows lenses of one kind only, and fits that one.
    """
    baseline_m = nominal_rig().baseline_m
    return (
        *(by_calibrator(name) for name in ("drl", "drl-increments", "lm", "opencv")),
        OpenCVThroughout(),
        *(by_calibrator(name) for name in ("alternating", "absolute-orientation", "heterogeneous")),
        ByCalibrator("from-guess", "from-guess", {"baseline_m": baseline_m}),
        AsPrinted(),
        ByCalibrator("lm from the guess", "from-guess", {"baseline_m": baseline_m, "agent": "lm"}),
        ByCalibrator("wide-field", "wide-field", choices={"model": "fisheye4"}),
        PriorUnchanged(),
        AtBound(),
    )


def board_cases(options: ExperimentOptions) -> list[Case]:
    """Table 3, and what figures 5, 6 and 7 take from the same calibrations."""
    cases = []
    for shape, (bow_m, error_m) in SHAPES.items():
        for number, spec in enumerate(BOARDS):
            printed: dict[Any, float | str] = {(label, LENGTH): values[number] for label, values in TABLE_3.items()}
            printed |= {(PROPOSED, CORRECT): 95.0}
            name = f"{spec.rpartition(':')[2].replace('mm', ' mm')}{shape}"
            make = RenderedBoards(spec, options.n_pairs, bow_m, error_m)
            cases.append(Case(name, make, board_errors, methods(), {} if shape else printed, "3"))
    return cases


def trains(options: ExperimentOptions) -> bool:
    """Whether agents are trained: not in a quick run, nor without PyTorch."""
    return can_train() and not options.is_quick


def experiment_document(options: ExperimentOptions) -> dict[str, Any]:
    """What an experiment of these options is, for its journal."""
    return {"model": MODEL, "boards": list(BOARDS), "version": 3, "trains": trains(options)} | options.document()


def cases_of(options: ExperimentOptions, folder: Path) -> Sequence[Case]:
    """All cases, in the order of the page; histories of training runs are left in ``folder``."""
    return [
        *board_cases(options),
        *guess_cases(nominal_rig()),
        *(trained_cases(nominal_rig(), folder) if trains(options) else ()),
        *convergence_cases(nominal_rig()),
        *distance_cases(),
        *([] if options.is_quick else [*preparation_cases(), *colour_cases(), *own_input_cases()]),
    ]
