"""Verdicts: what is proven, what is not, and where it is worst."""

from dataclasses import replace

import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.errors import DataError
from binocal.evidence import Detections
from binocal.metrics.image import PixelError
from binocal.requirements import Figure, Outcome, decide, figure_of_calibration, freedom_of, parse_requirement
from binocal.requirements.figures import sigma_freedom
from binocal.requirements.measured import reprojection_figure, row_figure, shifted_figure, true_figure
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig
from rigs import make_calibration

RIG, BOARD = table2_rig(), parse_board("chessboard:6x5:30mm")


def made_of(n_views, seed=0, noise_px=0.1):
    rng = np.random.default_rng(seed)
    scene = StereoScene(RIG, BOARD, sample_board_poses(RIG, BOARD, n_views, rng))
    return calibrate(simulate_detections(scene, rng, noise_px=noise_px), model="brown4", calibrator="lm")


@pytest.fixture(scope="module")
def calibration():
    return made_of(12)


def test_a_limit_within_the_guard_band_is_undecided():
    need = parse_requirement("row 0.1px")
    outcomes = [decide(need, Figure(value, 0.02, "it")).outcome for value in (0.0799, 0.0801, 0.1199, 0.1201)]
    assert outcomes == [Outcome.PASS, Outcome.UNDECIDED, Outcome.UNDECIDED, Outcome.FAIL]
    assert decide(need, Figure(np.nan, np.nan, "it", why="nobody knows")).outcome is Outcome.UNDECIDED
    assert decide(need, Figure(np.nan, np.nan, "it", is_impossible=True)).outcome is Outcome.FAIL
    assert "nobody knows" in decide(need, Figure(np.nan, np.nan, "it", why="nobody knows")).sentence


@pytest.mark.parametrize(
    "text", ["depth 1% at 2m", "depth 20mm at 2m", "row 0.1px", "row 0.1px at 1m", "baseline 0.02%", "focal 1px"]
)
def test_a_figure_is_two_of_the_worst_standard_deviations(calibration, text):
    need = parse_requirement(text)
    figure = figure_of_calibration(calibration, need)
    sigma = calibration.covariance.sigma
    if need.quantity == "depth":
        from binocal.uncertainty import common_field

        field = common_field(calibration.rig, 2.0)
        told = calibration.depth_sigma(field.points[field.is_common])
        worst = np.nanmax(told.calibration_m / (told.depth_m if need.is_relative else 1.0))
    elif need.quantity == "baseline":
        worst = calibration.baseline_sigma_m / calibration.rig.baseline_m
    elif need.quantity == "focal":
        worst = max(sigma[f"{side}.{axis}"] for side in ("left", "right") for axis in ("fx", "fy"))
    else:
        worst = figure.value / 2  # over ranges and places: held by the next test
    assert figure.value == pytest.approx(2 * worst, rel=1e-6)
    assert 0 < figure.guard < 0.2 * figure.value
    assert decide(replace(need, limit=2 * figure.value), figure).outcome is Outcome.PASS
    assert decide(replace(need, limit=0.5 * figure.value), figure).outcome is Outcome.FAIL
    assert decide(replace(need, limit=figure.value), figure).outcome is Outcome.UNDECIDED


def test_the_worst_row_is_where_it_is_named(calibration):
    figure = figure_of_calibration(calibration, parse_requirement("row 0.1px at 1m"))
    x, y = (float(v) for v in figure.where.partition("(")[2].partition(")")[0].split(","))
    from binocal.uncertainty.depth import points_at

    px = np.array([x, y])
    range_m = np.linalg.norm(points_at(calibration.rig, px, 1.0))
    assert figure.value == pytest.approx(2 * calibration.row_sigma_px(px, range_m=range_m), rel=0.01)  # px is rounded


def test_what_matching_leaves_no_calibration_mends(calibration):
    alone = figure_of_calibration(calibration, parse_requirement("depth 0.1% at 5m"))
    matched = figure_of_calibration(calibration, parse_requirement("depth 0.1% at 5m with 0.25px"))
    assert matched.value > alone.value and "no more views help" in matched.why and not alone.why


def test_freedom_is_the_views_where_they_have_errors_in_common():
    assert sigma_freedom(20, 3520, 22, 1.0) == pytest.approx(2 * 3520 - 120 - 22)
    assert sigma_freedom(20, 3520, 22, 3.0) == pytest.approx(19 * (9 / 8) ** 2, rel=0.01)
    assert sigma_freedom(20, 3520, 22, 1.01) > 1000  # hardly widened: nothing jumps
    assert freedom_of(make_calibration()) >= 1


def test_units_must_agree(calibration):
    with pytest.raises(DataError, match="in board pitches, the rig in metres"):
        figure_of_calibration(calibration, parse_requirement("depth 1% at 50"))


def test_what_cannot_be_told_is_undecided_and_what_cannot_be_is_failed(calibration):
    verdict = decide(need := parse_requirement("baseline 1%"), figure_of_calibration(make_calibration(), need))
    assert verdict.outcome is Outcome.UNDECIDED and "no covariance" in verdict.sentence
    verdict = decide(need := parse_requirement("depth 1% at 1mm"), figure_of_calibration(calibration, need))
    assert verdict.outcome is Outcome.FAIL and "nothing together" in verdict.sentence


def test_a_passed_need_is_kept_by_the_truth():
    """Where 95 % of the rigs keep below the figure, 20 rigs at their figure's own limit are all but one or two true."""
    need, kept = parse_requirement("depth 1% at 1m"), 0
    for seed in range(20):
        calibration = made_of(8, seed)
        stated = figure_of_calibration(calibration, need).value
        kept += true_figure(calibration, RIG, need).value < stated
    assert kept >= 14  # the largest error over the image against the largest standard deviation: looser than one place


@pytest.mark.parametrize(
    "text", ["depth 1% at 1m", "depth 5mm at 1m", "row 0.1px", "baseline 1%", "focal 1%", "reprojection 1px"]
)
def test_the_truth_itself_has_no_error(calibration, text):
    exact = replace(calibration, rig=RIG)
    figure = true_figure(exact, RIG, parse_requirement(text))
    expected = calibration.rms.all_px if text.startswith("reprojection") else 0.0
    assert figure.value == pytest.approx(expected, abs=1e-7) and figure.guard == 0


def test_rows_are_measured_without_their_noise():
    rng = np.random.default_rng(1)
    scene = StereoScene(RIG, BOARD, sample_board_poses(RIG, BOARD, 40, rng))
    noisy = simulate_detections(scene, rng, noise_px=0.2)
    sound = row_figure(RIG, noisy)
    assert sound.value < 0.15 and sound.value < 2 * sound.guard  # the largest of 12 means of noise
    shifted = replace(noisy, right_px=noisy.right_px + [0.0, 0.5])
    off = row_figure(RIG, shifted)
    assert off.value == pytest.approx(0.5, abs=0.1) and "left image" in off.where
    few = Detections.from_arrays(np.eye(3), np.full((1, 3, 2), 9.0), np.full((1, 3, 2), 9.0), RIG.left.size_wh)
    assert np.isnan(row_figure(RIG, few).value)


def test_reprojection_names_the_worst_view():
    figure = reprojection_figure(PixelError(0.2, 0.2, 0.2, np.array([0.1, 0.3, np.nan]), 400), ("a", "b", "c"))
    assert figure.value == 0.2 and "view b" in figure.where and figure.guard == pytest.approx(0.01)


def test_a_shift_of_the_rig_is_its_error(calibration):
    names = calibration.covariance.names
    shift = np.zeros(len(names))
    shift[names.index("left.fx")] = 3.0
    none = np.zeros((len(names),) * 2)
    figure = shifted_figure(calibration, parse_requirement("focal 1px"), names, shift, none)
    assert figure.value == 3.0 and figure.guard == 0 and "fx of the left" in figure.where
