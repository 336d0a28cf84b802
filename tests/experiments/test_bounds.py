"""The Cramér-Rao bound of boards whose print is known to a standard deviation only."""

from __future__ import annotations

import numpy as np
import pytest

import binocal
from binocal.boards import parse_board
from binocal.evidence import Detections
from binocal.experiments.boards import FILL
from binocal.metrics.pose import compare_with_truth
from binocal.simulation import PoseOptions, sample_board_poses, table2_rig
from binocal.simulation.printed_shape import draw_printed_shape, printed_points_information
from binocal.solvers.covariance import cramer_rao_bound

NOISE_PX, BOW_M, ERROR_M = 0.02, 3e-4, 5e-5
BOARD = parse_board("chessboard:11x8:20mm")


def test_the_prior_is_that_of_drawn_shapes():
    board = parse_board("chessboard:6x5:20mm")
    C = np.linalg.inv(printed_points_information(board, bow_m=BOW_M, error_m=ERROR_M))
    n, x, y = len(board.object_points_m), *board.object_points_m[:, :2].T
    rng, drawn = np.random.default_rng(0), board.object_points_m
    offsets = np.stack(
        [(draw_printed_shape(board, rng, bow_m=BOW_M, error_m=ERROR_M).points_m(board) - drawn).T for _ in range(60)]
    )
    assert np.sqrt(np.mean(offsets[:, :2] ** 2)) == pytest.approx(ERROR_M, rel=0.05)
    assert np.sqrt(C[0, 0]) == pytest.approx(ERROR_M, rel=1e-6)
    plane = np.linalg.qr(np.stack([np.ones(n), x, y], axis=-1))[0]  # what the board's pose takes up
    rest = np.eye(n) - plane @ plane.T
    heights = np.sqrt(np.mean((offsets[:, 2] @ rest) ** 2))
    expected = np.sqrt(np.trace(rest @ C[2 * n :, 2 * n :] @ rest) / n)
    assert heights == pytest.approx(expected, rel=0.1)


@pytest.fixture(scope="module")
def solved():
    rig, found = table2_rig(), []
    for seed in range(3):
        rng = np.random.default_rng([seed, 3])
        T = sample_board_poses(rig, BOARD, 15, rng, PoseOptions(fill=FILL))
        points = draw_printed_shape(BOARD, rng, bow_m=BOW_M, error_m=ERROR_M).points_m(BOARD)
        sides = [rig.left.project(T.apply(points)), rig.right.project((rig.T_right_left @ T).apply(points))]
        px = [side + NOISE_PX * rng.standard_normal(side.shape) for side in sides]
        corners = Detections.from_arrays(BOARD.object_points_m, *px, rig.left.size_wh)
        found.append((binocal.calibrate(corners, calibrator="lm", model="brown4").rig, points, T))
    return rig, found


def test_errors_are_as_large_as_the_bound_that_knows_the_print(solved):
    rig, found = solved
    information = printed_points_information(BOARD, bow_m=BOW_M, error_m=ERROR_M)
    errors, baselines, shares = [], [], []
    for made, points, T in found:
        bound = cramer_rao_bound(rig, points, T, NOISE_PX, points_information=information)
        known = cramer_rao_bound(rig, points, T, NOISE_PX)
        compared = compare_with_truth(made, rig, bound=bound, has_skew=False)
        errors += [p.error_per_bound for p in compared.parameters]
        shares.append(compared.parameter_accuracy_percent)
        baselines.append(bound.sigma["translation.x"] / known.sigma["translation.x"])
        assert all(bound.sigma[name] > 0.999 * known.sigma[name] for name in known.sigma)
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(1.0, abs=0.25)  # 66 figures; 1.0 of 6 seeds of 25 pairs
    assert min(shares) > 95 and np.median(shares) == 100
    assert min(baselines) > 2  # the print's scale is off by chance: 2.9 measured


def test_a_print_without_error_is_a_board_that_is_known(solved):
    rig, found = solved
    _, points, T = found[0]
    information = printed_points_information(BOARD, bow_m=1e-9, error_m=1e-9)
    bound = cramer_rao_bound(rig, points, T, NOISE_PX, points_information=information)
    known = cramer_rao_bound(rig, points, T, NOISE_PX)
    assert bound.sigma == pytest.approx(known.sigma, rel=1e-3)
