"""The camera model is chosen by held-out error, the simpler one when they tie."""

import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.calibrators.model_selection import ModelTrial, choose_model
from binocal.simulation import StereoScene, random_rig, sample_board_poses, simulate_detections, table2_rig

BOARD = parse_board("chessboard:11x8:20mm")


def detections_of(rig, n_views, seed=0, noise_px=0.1):
    rng = np.random.default_rng(seed)
    scene = StereoScene(rig, BOARD, sample_board_poses(rig, BOARD, n_views, rng))
    return simulate_detections(scene, rng, noise_px=noise_px)


@pytest.mark.slow
def test_auto_finds_the_true_kind_of_lens():
    ordinary = calibrate(detections_of(table2_rig(), 16), model="auto")
    assert ordinary.rig.left.model == "brown4"
    fisheye = calibrate(detections_of(random_rig(np.random.default_rng(3), "fisheye4"), 16), model="auto")
    assert fisheye.rig.left.model == "fisheye4"
    choice = fisheye.provenance["model_choice"]
    assert choice["model"] == "fisheye4" and "held-out error" in choice["reason"]
    assert choice["held_out_rms_px"]["fisheye4"] == min(choice["held_out_rms_px"].values())


@pytest.mark.slow
def test_few_views_are_chosen_by_information_and_said():
    calibration = calibrate(detections_of(table2_rig(), 5), model="auto")
    assert any("too few to hold some out" in warning for warning in calibration.warnings)
    assert calibration.rig.left.model == calibration.provenance["model_choice"]["model"]


def trial(model, held_out_px2, calibration="fitted"):
    return ModelTrial(model, calibration, "" if calibration else "failed", np.asarray(held_out_px2, dtype=float))


@pytest.mark.usefixtures("unchecked_types")
def test_the_simplest_within_one_standard_error_wins():
    rng = np.random.default_rng(0)
    base = 0.01 + 0.002 * rng.random(12)
    better = base * (1 - 0.02 * rng.random(12))
    unclear = base + 1e-3 * (rng.random(12) - 0.52)
    chosen, reason = choose_model([trial("brown4", base), trial("brown5", better)])
    assert chosen.model == "brown5" and "least held-out error" in reason
    chosen, reason = choose_model([trial("brown4", base), trial("brown8", unclear)])
    assert chosen.model == "brown4"


@pytest.mark.usefixtures("unchecked_types")
def test_a_model_that_failed_is_named_and_cannot_win():
    chosen, reason = choose_model([trial("brown4", [np.nan] * 4, None), trial("fisheye4", [0.1, 0.2, 0.1, 0.3])])
    assert chosen.model == "fisheye4" and "brown4 could not be fitted" in reason
