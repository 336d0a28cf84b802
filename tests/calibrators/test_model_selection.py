"""The camera model is chosen by rows and lengths of views left out; the plain one stands unless another is decisively better."""

from dataclasses import replace

import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.calibrators import CalibrationRequest, calibrate, model_selection
from binocal.calibrators.left_out_views import LeftOutErrors
from binocal.calibrators.lm import calibrate_lm
from binocal.calibrators.model_selection import (
    Advantage,
    ModelTrial,
    calibrate_with_best_model,
    choose_by_information,
    choose_model,
    gains,
)
from binocal.cameras import CAMERA_MODELS
from binocal.errors import DegenerateGeometryError
from binocal.findings import finding, refusal
from binocal.simulation import StereoScene, random_rig, sample_board_poses, simulate_detections, table2_rig

BOARD = parse_board("chessboard:11x8:20mm")
VIEWS, CORNERS = 20, 60


def detections_of(rig, n_views, seed=0, noise_px=0.1):
    rng = np.random.default_rng(seed)
    scene = StereoScene(rig, BOARD, sample_board_poses(rig, BOARD, n_views, rng))
    return simulate_detections(scene, rng, noise_px=noise_px)


@pytest.fixture(scope="module")
def ordinary():
    return detections_of(table2_rig(), 16)


@pytest.fixture(scope="module")
def wide():
    return detections_of(random_rig(np.random.default_rng(3), "fisheye4"), 16)


def test_an_ordinary_lens_keeps_the_plain_model(ordinary):
    calibration = calibrate(ordinary, calibrator="lm")
    choice = calibration.provenance["model_choice"]
    assert calibration.rig.left.model == choice["model"] == "brown4"
    assert "no other is decisively better" in choice["reason"] and choice["n_views"] == 16
    # left-out rows: two corners' noise of 0.1 px
    assert choice["held_out_row_rms_px"]["brown4"] == pytest.approx(0.14, abs=0.01)
    assert set(choice["held_out_length_rms_percent"]) <= set(CAMERA_MODELS) and choice["failures"] == {}


def test_where_one_more_coefficient_is_of_no_use_the_others_are_not_tried():
    tried = [
        tuple(
            calibrate(detections_of(table2_rig(), 16, seed), calibrator="lm").provenance["model_choice"][
                "held_out_row_rms_px"
            ]
        )
        for seed in range(6)
    ]
    assert tried.count(("brown4", "brown5")) >= 3
    assert set(tried) <= {("brown4", "brown5"), ("brown4", "brown5", "brown8")}


def test_a_wide_lens_takes_the_fisheye_model(wide):
    calibration = calibrate(wide, calibrator="lm")
    assert calibration.rig.left.model == "fisheye4"
    rows = calibration.provenance["model_choice"]["held_out_row_rms_px"]
    assert all(rows["fisheye4"] < rows[name] for name in rows if name in ("brown4", "brown5"))


def test_a_bent_board_does_not_choose_the_lens():
    """On the drawn board its bow shows as distortion, which each model takes up in its own way."""
    rng = np.random.default_rng(7)
    scene = StereoScene(table2_rig(), BOARD, sample_board_poses(table2_rig(), BOARD, 16, rng))
    x, y = BOARD.object_points_m[:, 0] - 0.1, BOARD.object_points_m[:, 1] - 0.07
    bowed = BOARD.object_points_m + np.stack([0 * x, 0 * x, 1.5e-3 * (1 - (x**2 + y**2) / 0.015)], axis=-1)
    sides = [
        camera.project(T.apply(bowed)) + rng.normal(0, 0.05, (16, 88, 2))
        for camera, T in (
            (scene.rig.left, scene.T_left_board),
            (scene.rig.right, scene.rig.T_right_left @ scene.T_left_board),
        )
    ]
    size = np.array(scene.rig.left.size_wh)
    inside = [np.all((px > 0) & (px < size - 1), axis=-1, keepdims=True) for px in sides]
    views = detections_of(table2_rig(), 16)
    views = replace(
        views, left_px=np.where(inside[0], sides[0], np.nan), right_px=np.where(inside[1], sides[1], np.nan)
    )
    choice = calibrate(views, calibrator="lm").provenance["model_choice"]
    assert choice["model"] == "brown4"
    assert choice["held_out_row_rms_px"]["brown4"] < 0.1  # 0.07 is the corners' noise; 0.15 and more on the drawn board
    drawn = calibrate(views, calibrator="lm", board_shape="flat").provenance["model_choice"]
    assert drawn["held_out_row_rms_px"]["brown4"] > 1.5 * choice["held_out_row_rms_px"]["brown4"]


class Method:
    """A calibrator that refuses some models, and remembers which it was asked for."""

    def __init__(self, *refused, code="focal-length-undetermined"):
        self.refused, self.asked = refused, []
        figures = {"camera": "left", "sigma_percent": 6.0, "spread_deg": 3.0}
        self.error = refusal(finding(code, **figures), {})

    def __call__(self, evidence, request):
        self.asked.append(request.model)
        if request.model in self.refused:
            raise self.error
        return calibrate_lm(evidence, request)


def test_the_method_runs_once_with_the_chosen_model(ordinary):
    method = Method()
    calibrate_with_best_model(ordinary, method, CalibrationRequest())
    assert method.asked == ["brown4"]


def test_no_model_wins_because_the_plain_one_was_refused(ordinary):
    """What refuses the plain model says something of the views, and so of every model."""
    method = Method("brown4")
    with pytest.raises(DegenerateGeometryError) as caught:
        calibrate_with_best_model(ordinary, method, CalibrationRequest())
    assert caught.value is method.error and method.asked == ["brown4"]


def test_another_stands_in_for_a_refused_one_only_if_it_is_not_decisively_worse(wide):
    method = Method("fisheye4")
    calibration = calibrate_with_best_model(wide, method, CalibrationRequest())
    assert method.asked == ["fisheye4", "brown8"] and calibration.rig.left.model == "brown8"  # 12 % worse rows
    assert "fisheye4" in calibration.provenance["model_choice"]["failures"]

    method = Method("fisheye4", "brown8", "brown5")
    with pytest.raises(DegenerateGeometryError) as caught:
        calibrate_with_best_model(wide, method, CalibrationRequest())
    assert caught.value is method.error and "brown4" not in method.asked


def test_what_no_model_can_start_from_is_refused_for_the_set(ordinary):
    flat = ordinary.select(np.zeros(8, dtype=int))
    with pytest.raises(DegenerateGeometryError):
        calibrate(replace(flat, names=tuple(f"copy {i}" for i in range(8))), calibrator="lm")


def test_few_views_are_chosen_by_information_and_said():
    calibration = calibrate(detections_of(table2_rig(), 5), calibrator="lm")
    assert calibration.rig.left.model == calibration.provenance["model_choice"]["model"] == "brown4"
    assert any("too few to hold some out" in warning for warning in calibration.warnings)


def test_five_views_of_a_wide_lens_are_no_ordinary_lens():
    calibration = calibrate(detections_of(random_rig(np.random.default_rng(3), "fisheye4"), 5), calibrator="lm")
    assert calibration.rig.left.model in ("brown8", "fisheye4")


def trial(model, bias_px=0.0, *, length_bias=0.0, share=0.0, views=slice(None), seed=0):
    """Rows with noise 0.14 px, the same for every model, and in some views a bias that has nothing to do with the noise."""
    rng = np.random.default_rng(seed)
    rows, lengths = 0.14 * rng.standard_normal((VIEWS, CORNERS)), 2e-4 * rng.standard_normal(VIEWS)
    pattern = np.random.default_rng(99).standard_normal((VIEWS, CORNERS))
    pattern -= rows * np.sum(pattern * rows) / np.sum(rows * rows)
    rows[views] += (bias_px / pattern.std()) * pattern[views]
    lengths[views] += length_bias
    return ModelTrial(model, LeftOutErrors(rows, lengths), share)


def failed(model):
    return ModelTrial(model, LeftOutErrors.unmeasured(VIEWS, CORNERS), failure="no")


def chosen_of(*trials):
    return choose_model(list(trials))[0].model


def test_the_gain_counts_only_what_is_chance_as_error():
    rows, _ = gains(trial("brown4", 0.05), trial("brown5"))
    assert rows.share == pytest.approx(0.05**2 / (0.14**2 + 0.05**2), rel=0.05)
    # d² = 0.0025 in each of 1200 corners; chance 2 · 0.14 · 0.05 · sqrt(1200), known to a sixth from 20 views
    assert rows.standard_errors == pytest.approx(0.0025 * 1200 / (2 * 0.14 * 0.05 * np.sqrt(1200)), rel=0.5)
    back, _ = gains(trial("brown5"), trial("brown4", 0.05))
    assert back.standard_errors == pytest.approx(-rows.standard_errors)


def test_a_bias_of_few_views_counts_as_much_as_it_is():
    """A difference that a few views hold is no chance, although it varies between the views."""
    rows, _ = gains(trial("brown4", 0.3, views=slice(0, 3)), trial("brown5"))
    assert rows.standard_errors > 6


@pytest.mark.parametrize(
    ("plain", "other", "expected"),
    [
        (trial("brown4", 0.005), trial("brown5"), "brown4"),
        (trial("brown4", 0.04), trial("brown5"), "brown5"),
        (trial("brown4", 0.04), trial("fisheye4"), "brown4"),  # 8 % of the squared error: brown5 would do
        (trial("brown4", 0.14), trial("fisheye4"), "fisheye4"),
        (trial("brown4"), trial("fisheye4", 0.04), "brown4"),
        (trial("brown4", 0.04), trial("brown5", length_bias=1e-3), "brown4"),  # better rows at the cost of lengths
        (trial("brown4", length_bias=5e-4), trial("brown5"), "brown5"),
    ],
)
def test_the_plain_model_stands_unless_another_is_decisively_better(plain, other, expected):
    assert chosen_of(plain, other) == expected


@pytest.mark.parametrize(
    ("rows", "lengths", "model", "is_taken"),
    [
        ((1.9, 0.22), (1.4, 0.32), "brown8", True),
        ((1.9, 0.22), (0.5, 0.32), "brown8", False),
        ((1.9, 0.05), (1.4, 0.32), "brown8", False),
        ((1.9, 0.22), (1.4, 0.32), "fisheye4", False),
    ],
)
def test_gains_of_rows_and_of_lengths_count_together(monkeypatch, rows, lengths, model, is_taken):
    monkeypatch.setattr(model_selection, "gains", lambda kept, other: (Advantage(*rows), Advantage(*lengths)))
    chosen, why = choose_model([trial("brown4"), trial(model)])
    assert (chosen.model == model) == is_taken == ("2.3 standard errors together" in why)


def test_a_model_without_rays_needs_more_to_win_and_loses_where_it_is_equal():
    assert chosen_of(trial("brown4", 0.04), trial("brown5", share=0.1)) == "brown4"
    assert chosen_of(trial("brown4", 0.14), trial("brown5", share=0.1)) == "brown5"
    assert chosen_of(trial("brown4", share=0.1), trial("brown5")) == "brown5"
    assert chosen_of(trial("brown4", share=0.1), trial("brown5", share=0.08)) == "brown4"
    assert chosen_of(trial("brown4", share=0.03), trial("brown5", 0.03)) == "brown4"


def test_a_model_that_lacks_rays_for_much_of_the_image_loses_where_it_is_hardly_better():
    assert chosen_of(trial("brown4", share=0.1), trial("brown5", 0.03)) == "brown5"
    assert chosen_of(trial("brown4", share=0.1), trial("brown5", 0.3)) == "brown4"


def test_a_strong_lens_takes_the_model_with_fewer_coefficients():
    strong, none = trial("brown4", 0.3), trial("brown8")
    assert chosen_of(strong, none, trial("fisheye4")) == "fisheye4"
    assert chosen_of(strong, none, trial("fisheye4", 0.1)) == "brown8"
    assert chosen_of(trial("brown4", 0.04), none, trial("fisheye4")) == "brown8"  # no strong lens
    assert chosen_of(failed("brown4"), none, trial("fisheye4")) == "fisheye4"


def test_a_model_that_failed_is_named_and_cannot_win():
    chosen, reason = choose_model([failed("brown4"), trial("brown5")])
    assert chosen.model == "brown5" and "brown4 could not be fitted" in reason
    assert choose_model([failed("brown4"), failed("brown5")])[0].model == "brown4"


def test_information_must_be_decisive():
    def with_criterion(model, value):
        return replace(failed(model), failure="", information_criterion=value)

    plain = with_criterion("brown4", 100.0)
    assert choose_by_information([plain, with_criterion("fisheye4", 91.0)], 4)[0].model == "brown4"
    assert choose_by_information([plain, with_criterion("fisheye4", 89.0)], 4)[0].model == "fisheye4"
