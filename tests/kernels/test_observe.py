"""What a controller sees, against plain NumPy."""

from dataclasses import replace

import numpy as np
import pytest
from test_step import make_problem

from binocal.kernels import LastIteration, observe
from binocal.solvers.observation import OBSERVED

BIN = 1 / 16  # of an octave of length: what a quantile may be off


def last_iteration(mad, step):
    """An iteration that was kept: noise three times as large before it, twice the step, half of it the other way round."""
    before = replace(step, shared=np.array([1, 1, 1, -1, -1, -1]) * step.shared, predicted_px2=36 * step.predicted_px2)
    return LastIteration(2 * mad, np.asarray(0.7), np.asarray(True), 3 * mad, before)


@pytest.fixture
def seen():
    problem, estimate = make_problem("brown4", intrinsics=False)
    equations = problem.linearize(estimate, np.asarray(0.5), "cauchy")
    step = problem.solve_step(estimate, equations, np.zeros(()))
    r2 = tuple(e.r2_px2 for e in equations.cameras)
    is_seen = tuple(c.is_seen for c in problem.cameras)
    mad = problem.noise_estimate_px(r2)
    row = observe(r2, is_seen, mad, step, estimate.T_right_left.t, estimate.T_left_board.t, last_iteration(mad, step))
    return dict(zip(OBSERVED, row, strict=True)), r2, is_seen, float(mad), step, estimate


def test_quantiles_and_shares_are_those_of_the_residual_lengths(seen):
    row, r2, is_seen, mad, _, _ = seen
    lengths = np.sqrt(np.concatenate([a[s] for a, s in zip(r2, is_seen, strict=True)])) / mad
    names = (
        "lower quartile of the residual lengths over the MAD noise",
        "median of the same",
        "upper quartile of the same",
        "ninth decile of the same",
    )
    for name, q in zip(names, (0.25, 0.5, 0.75, 0.9), strict=True):
        assert row[f"log2 {name}"] == pytest.approx(np.log2(np.quantile(lengths, q)), abs=BIN + 0.02)
    assert row["share of corners beyond 3.5 MAD noise"] == pytest.approx(np.mean(lengths > 3.5), abs=0.01)
    assert row["share of corners beyond 7"] == pytest.approx(np.mean(lengths > 7), abs=0.01)
    assert row["log10 number of corners, over 1000"] == pytest.approx(np.log10(len(lengths)) - 3)


def test_sides_and_views_are_compared_by_their_mean_log_residual(seen):
    row, r2, is_seen, _, _, _ = seen
    means = [
        np.array([np.mean(0.5 * np.log2(a[i][s[i]])) for i in range(len(a)) if s[i].any()])
        for a, s in zip(r2, is_seen, strict=True)
    ]
    assert row["log2 residual, right over left"] == pytest.approx(means[1].mean() - means[0].mean(), abs=0.05)
    assert row["spread of the views' log2 residuals, left"] == pytest.approx(means[0].std(), abs=0.05)
    assert row["spread of the views' log2 residuals, right"] == pytest.approx(means[1].std(), abs=0.05)


def test_the_step_is_told_by_its_length_and_parts(seen):
    row, _, _, mad, step, estimate = seen
    x, g = step.shared[-6:], step.gradient_px2[-6:]
    assert row["log10 length of the Gauss-Newton step, sigmas"] == pytest.approx(
        np.log10(np.sqrt(2 * step.predicted_px2) / mad)
    )
    turn, shift = max(x[:3] @ g[:3], 0), max(x[3:] @ g[3:], 0)  # each may be negative, their sum is not
    assert row["rotation's share of the rig's decrement"] == pytest.approx(turn / (turn + shift))
    assert row["the rig's share of the whole decrement"] == pytest.approx((turn + shift) / (2 * step.predicted_px2))
    assert row["log10 rotation step of the rig, rad"] == pytest.approx(np.log10(np.linalg.norm(x[:3])))
    baseline = np.linalg.norm(estimate.T_right_left.t)
    assert row["log10 translation step of the rig over the baseline"] == pytest.approx(
        np.log10(np.linalg.norm(x[3:]) / baseline)
    )
    turn = np.sqrt(np.mean(np.sum(step.views[:, :3] ** 2, axis=1)))
    assert row["log10 RMS rotation step of the boards, rad"] == pytest.approx(np.log10(turn))


def test_pixels_of_another_size_look_the_same(seen):
    # twice the pixels: residuals, noise and gradients double, the numbers do not move
    row, r2, is_seen, mad, step, estimate = seen
    finer = replace(step, predicted_px2=4 * step.predicted_px2, gradient_px2=4 * step.gradient_px2)
    other = observe(
        tuple(4 * a for a in r2),
        is_seen,
        np.asarray(2 * mad),
        finer,
        estimate.T_right_left.t,
        estimate.T_left_board.t,
        last_iteration(np.asarray(2 * mad), finer),
    )
    assert np.allclose(list(row.values()), other, atol=1e-9)


def test_the_last_iteration_is_told(seen):
    row, _, _, _, step, _ = seen
    x, g = step.shared[-6:], step.gradient_px2[-6:]
    assert row["log10 kernel scale over the MAD noise"] == pytest.approx(np.log10(2))
    assert row["log10 MAD noise over that before the last iteration"] == pytest.approx(np.log10(1 / 3))
    assert row["log10 Gauss-Newton step over that before the last iteration"] == pytest.approx(np.log10(0.5))
    assert row["gain ratio of the last iteration"] == 0.7 and row["last candidate kept"] == 1
    assert row["cosine of this and the last rig step"] == pytest.approx((g[:3] @ x[:3] - g[3:] @ x[3:]) / (g @ x))


def test_what_is_not_a_number_is_seen_as_nothing(seen):
    _, r2, is_seen, mad, step, estimate = seen
    lost = replace(step, shared=step.shared * np.nan, predicted_px2=np.asarray(np.nan), least_pivot=np.asarray(np.nan))
    mad = np.asarray(mad)
    row = observe(r2, is_seen, mad, lost, estimate.T_right_left.t, estimate.T_left_board.t, last_iteration(mad, lost))
    assert np.isfinite(row).all()
