"""Stated noise and covariance: true on average, and refused where nothing determines them."""

from dataclasses import replace

import numpy as np
import pytest
from test_board_views import make_problem

from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.errors import DegenerateGeometryError
from binocal.evidence import Detections
from binocal.geometry import so3
from binocal.simulation.noise import simulate_detections
from binocal.simulation.rigs import table2_rig
from binocal.simulation.scenes import StereoScene, sample_board_poses
from binocal.solvers.board_views import BundleEstimate
from binocal.solvers.covariance import cramer_rao_bound, inliers, residual_noise_px
from binocal.solvers.minimization import minimize

pytestmark = pytest.mark.usefixtures("many_calls")

BOARD = parse_board("chessboard:5x4:40mm")
RIG = table2_rig()
NOISE_PX = 0.2


def scene(n_views, seed=0):
    return StereoScene(RIG, BOARD, sample_board_poses(RIG, BOARD, n_views, np.random.default_rng(seed)))


@pytest.fixture(scope="module")
def repeated():
    """Calibrations of one scene with noise drawn anew."""
    rng, fixed = np.random.default_rng(1), scene(6)
    made = [simulate_detections(fixed, rng, noise_px=NOISE_PX) for _ in range(300)]
    return [calibrate(detections, model="brown4", calibrator="lm") for detections in made]


def test_the_translations_covariance_is_that_of_the_translation_itself(repeated):
    t = np.array([c.rig.T_right_left.t for c in repeated])
    w = np.array([so3.log(c.rig.T_right_left.R @ RIG.T_right_left.R.T) for c in repeated])
    found = np.cov(np.hstack([w, t]).T)
    stated = np.mean([c.covariance.matrix[-6:, -6:] for c in repeated], axis=0)
    sigma = np.sqrt(np.diag(stated))
    assert np.sqrt(np.diag(found)) / sigma == pytest.approx(np.ones(6), abs=0.15)  # 300 draws: 0.04 sigma
    assert np.abs(found - stated).max(initial=0, where=np.ones((6, 6), bool)) < 1.0
    assert np.abs(found / np.outer(sigma, sigma) - stated / np.outer(sigma, sigma)).max() < 0.25


def test_the_noise_is_unbiased_although_few_corners_pay_for_many_unknowns(repeated):
    # 6 views of 20 corners in 2 cameras: 480 coordinates pay for 58 unknowns, 6 % of the standard deviation
    noise = np.mean([c.noise_px for c in repeated])
    assert noise == pytest.approx(NOISE_PX, rel=0.015)


def solved(detections, fixed):
    problem = make_problem(RIG, detections)
    return problem, minimize(problem, BundleEstimate.of_rig(RIG, fixed.T_left_board))


def test_fewer_measurements_than_unknowns_are_refused():
    fixed = scene(3)
    detections = simulate_detections(fixed, np.random.default_rng(0), noise_px=NOISE_PX)
    few = Detections.from_arrays(
        detections.object_points_m[:4], detections.left_px[:, :4], detections.right_px[:, :4], detections.left_size_wh
    )
    problem, minimum = solved(few, fixed)
    used = tuple(np.ones((3, 4), dtype=bool) for _ in range(2))
    assert residual_noise_px(problem, minimum, used) > 0  # 48 coordinates pay for 18 + 22 unknowns
    with pytest.raises(DegenerateGeometryError):
        residual_noise_px(problem, minimum, tuple(u & (np.arange(4) < 3) for u in used))  # 36 do not


def test_corners_without_weight_are_not_counted():
    fixed = scene(6)
    detections = simulate_detections(fixed, np.random.default_rng(0), noise_px=NOISE_PX)
    px = detections.left_px.copy()
    px[2, 5] += 40.0
    problem, minimum = solved(replace(detections, left_px=px), fixed)
    used = inliers(problem, minimum)
    assert not used[0][2, 5] and used[0].sum() == used[0].size - 1 and used[1].all()
    assert residual_noise_px(problem, minimum) == pytest.approx(NOISE_PX, rel=0.15)


def test_what_the_views_leave_open_is_refused_by_name():
    fixed = scene(4)
    unseen = np.zeros((4, len(BOARD.object_points_m)), dtype=bool)
    with pytest.raises(DegenerateGeometryError, match=r"right\."):
        cramer_rao_bound(RIG, BOARD.object_points_m, fixed.T_left_board, NOISE_PX, right_is_seen=unseen)
