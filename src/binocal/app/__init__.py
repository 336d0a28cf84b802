"""The product's verbs: calibrate, simulate, evaluate, demo, train. The one list that every shell shares.

Each verb takes plain values, returns one, and neither prints nor reads the environment. Progress goes out through
``progress(stage, done, total)``; a run is cancelled by ``should_stop()`` returning True.
"""

from __future__ import annotations

from binocal.app.road import (
    CalibrationRun,
    DemoCase,
    ImageEvaluation,
    Progress,
    ShouldStop,
    SimulateOptions,
    TruthEvaluation,
    calibrate_images,
    check_output_folder,
    demo,
    evaluate_images,
    evaluate_truth,
    simulate,
    staged_folder,
)
from binocal.app.training import TrainedAgent, TrainOptions, board_of_folder, train
from binocal.calibrators.base import CalibrationRequest

__all__ = [
    "CalibrationRequest",
    "CalibrationRun",
    "DemoCase",
    "ImageEvaluation",
    "Progress",
    "ShouldStop",
    "SimulateOptions",
    "TrainOptions",
    "TrainedAgent",
    "TruthEvaluation",
    "board_of_folder",
    "calibrate_images",
    "check_output_folder",
    "demo",
    "evaluate_images",
    "evaluate_truth",
    "simulate",
    "staged_folder",
    "train",
]
