"""New images against a rig's own standard deviations: chance is called chance, and what has changed is named."""

from dataclasses import replace

import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.calibrators.agreement import _compared, measure_agreement
from binocal.cameras import Camera, StereoRig
from binocal.errors import DataError
from binocal.geometry import SE3, so3
from binocal.metrics.order import order_corners
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig
from binocal.uncertainty import Covariance

pytestmark = pytest.mark.usefixtures("many_calls")

RIG, BOARD = table2_rig(), parse_board("chessboard:6x5:30mm")


def seen_by(rig, n_views, seed, **options):
    rng = np.random.default_rng(seed)
    scene = StereoScene(rig, BOARD, sample_board_poses(rig, BOARD, n_views, rng))
    return simulate_detections(scene, rng, noise_px=0.2, **options)


def compared(calibration, detections):
    ordered = order_corners(calibration.rig, detections)
    return measure_agreement(calibration, ordered.detections, ordered.T_left_board)


@pytest.fixture(scope="module")
def calibration():
    return calibrate(seen_by(RIG, 15, 0), model="brown4", calibrator="lm")


def turned(deg):
    """The right camera turned about its own centre."""
    W, T = so3.exp(np.radians(deg)), RIG.T_right_left
    return StereoRig(RIG.left, RIG.right, SE3(W @ T.R, W @ T.t))


@pytest.mark.parametrize("n_views", [1, 3, 10])
def test_a_rig_that_has_not_changed_agrees_as_often_as_chance_has_it(n_views):
    p_values = []
    for seed in range(25):
        calibration = calibrate(seen_by(RIG, 12, seed), model="brown4", calibrator="lm")
        p_values.append(compared(calibration, seen_by(RIG, n_views, 1000 + seed)).p_value)
    assert min(p_values) > 1e-4 and 0.25 < np.mean(p_values) < 0.85  # uniform: 0.5 ± 0.06; times the tests: above


@pytest.mark.parametrize("n_views", [1, 3, 12])
def test_a_turn_of_a_twentieth_of_a_degree_is_named_with_its_size(calibration, n_views):
    found = compared(calibration, seen_by(turned([0.05, 0, 0]), n_views, 5))
    assert not found.agrees and found.finding.code in ("rig-disagrees", "rig-does-not-fit")
    assert found.cause.code in ("right turned", "left turned") and "pitch" in found.finding.text
    assert found.cause.size == pytest.approx(0.05, abs=0.03 if n_views < 12 else 0.005)


@pytest.mark.parametrize("deg", [0.5, 2.0])
@pytest.mark.parametrize("n_views", [1, 3, 10])
def test_a_precise_rig_that_turned_far_is_never_passed(n_views, deg):
    """A hundred standard deviations and more: the solve may fail or settle elsewhere, the corners still tell."""

    def sharp(rig, n, seed):
        rng = np.random.default_rng(seed)
        return simulate_detections(StereoScene(rig, BOARD, sample_board_poses(rig, BOARD, n, rng)), rng, noise_px=0.02)

    calibration = calibrate(sharp(RIG, 15, 0), model="brown4", calibrator="lm")
    found = compared(calibration, sharp(turned([deg, 0, 0]), n_views, 5))
    assert not found.agrees and found.is_gross and found.p_value == 0
    assert found.finding.code == "rig-does-not-fit" and found.pair_px > 50 * found.alone_px


def test_one_cause_is_not_lost_among_the_chance_of_all_directions():
    """5.3 standard deviations in a single direction of 22 happen by chance to one rig in ten million, as a sum to one in 200."""
    names = tuple(f"{side}.{p}" for side in ("left", "right") for p in ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"])
    names += tuple(f"{part}.{axis}" for part in ("rotation", "translation") for axis in "xyz")
    away = np.zeros(22)
    away[names.index("rotation.x")] = 7.5
    found = _compared(RIG, Covariance(names, np.eye(22)), away, np.eye(22), 1.0, 0.1, 1e6, 1e6)
    assert found.statistic == pytest.approx(7.5**2 / 2) and found.freedom == 22
    assert 1e-6 < found.p_value < 1e-4 and found.cause.code in ("left turned", "right turned")


def test_causes_are_told_apart(calibration):
    wider = Camera("brown4", RIG.right.size_wh, RIG.right.parameters * np.r_[1.004, 1.004, np.ones(7)])
    focus = compared(
        calibration, seen_by(replace(RIG, right=wider), 12, 6)
    ).cause  # 0.4 % more, or the left one 0.4 % less
    assert focus.code in ("left refocused", "right refocused") and focus.size == pytest.approx(0.4, rel=0.1)
    moved = replace(RIG, T_right_left=SE3(RIG.T_right_left.R, RIG.T_right_left.t + [0.001, 0, 0]))
    found = compared(calibration, seen_by(moved, 12, 6))
    assert found.cause.code == "shifted" and found.cause.size == pytest.approx(1e-3, rel=0.1)
    place = found.names.index("translation.x")
    assert found.shift[place] == pytest.approx(1e-3, rel=0.1)


@pytest.mark.parametrize(
    ("factor", "words"), [(1.03, "3 % longer, or the board smaller"), (0.97, "3 % shorter, or the board larger")]
)
def test_a_board_of_another_size_is_named_beside_the_baseline(calibration, factor, words):
    seen = seen_by(RIG, 6, 7)
    found = compared(calibration, replace(seen, object_points_m=factor * seen.object_points_m))
    assert found.cause.code == "shifted" and f"{words} than its SPEC says" in found.finding.text


def test_outliers_do_not_make_a_change(calibration):
    assert compared(calibration, seen_by(RIG, 10, 7, outlier_share=0.05)).agrees


def test_views_without_corners_are_left_out(calibration):
    detections = seen_by(RIG, 5, 8)
    left, right = detections.left_px.copy(), detections.right_px.copy()
    left[2], right[2] = np.nan, np.nan
    assert compared(calibration, replace(detections, left_px=left, right_px=right)).agrees


def test_without_a_covariance_nothing_is_compared(calibration):
    names = calibration.covariance.names
    unknown = replace(calibration, covariance=Covariance(names, np.full((len(names),) * 2, np.nan)))
    with pytest.raises(DataError, match="no covariance"):
        compared(unknown, seen_by(RIG, 3, 9))
