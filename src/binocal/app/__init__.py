"""The product's verbs: calibrate, simulate, evaluate, demo, experiment, train. The one list that every shell shares.

Each verb takes plain values, returns one, and neither prints nor reads the environment. Progress goes out through
``progress(stage, done, total)``; a run is cancelled by ``should_stop()`` returning True.
"""

from __future__ import annotations

from binocal.app.calibrate import CalibrationRun, calibrate_corners, calibrate_images, with_checks
from binocal.app.channels import ChannelRow, ChannelStudy, study_channels
from binocal.app.demo import DemoCase, demo
from binocal.app.evaluate import ImageEvaluation, TruthEvaluation, evaluate_images, evaluate_truth
from binocal.app.experiment import ExperimentRun, check_experiment_folder, experiment
from binocal.app.simulate import SimulateOptions, simulate, simulate_scene
from binocal.app.simulate_turning import simulate_turning_cameras
from binocal.app.train import TrainedAgent, TrainRequest, board_of_folder, train
from binocal.app.zoom import calibrate_zoom_images, simulate_zoom
from binocal.calibrators.base import CalibrationRequest

__all__ = [
    "CalibrationRequest",
    "CalibrationRun",
    "ChannelRow",
    "ChannelStudy",
    "DemoCase",
    "ExperimentRun",
    "ImageEvaluation",
    "SimulateOptions",
    "TrainRequest",
    "TrainedAgent",
    "TruthEvaluation",
    "board_of_folder",
    "calibrate_corners",
    "calibrate_images",
    "calibrate_zoom_images",
    "check_experiment_folder",
    "demo",
    "evaluate_images",
    "evaluate_truth",
    "experiment",
    "simulate",
    "simulate_scene",
    "simulate_turning_cameras",
    "simulate_zoom",
    "study_channels",
    "train",
    "with_checks",
]
