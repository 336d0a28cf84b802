"""Simulated rigs: their optimum, what a sigma is, their starts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from binocal.geometry import SE3, so3
from binocal.rl import rig_batches as module
from binocal.rl.rig_batches import RIG_SETS, distance_sigma, sample_rigs, sample_starts
from binocal.solvers.arrays import take_rigs
from binocal.solvers.loop import begin

FEW_VIEWS = replace(RIG_SETS["standard"], n_views=8)


def test_the_optimum_is_at_distance_zero_and_stationary(rigs):
    assert distance_sigma(rigs, rigs.optimum).max() < 1e-6
    # the kernel's scale is the MAD noise here and there, so the Newton step over all unknowns must vanish: measured 2e-3
    assert begin(rigs.problem, rigs.optimum, "hampel").decrement_sigma.max() < 1e-2


def test_a_step_of_one_sigma_is_at_distance_one(rigs):
    for axis in range(6):
        covariance = np.linalg.inv(rigs.whitening.swapaxes(-1, -2) @ rigs.whitening)
        xi = (
            covariance[:, :, axis] / np.sqrt(covariance[:, axis, axis])[:, None]
        )  # to the ellipsoid's edge on that axis
        turn = so3.exp(xi[:, :3])
        moved = replace(
            rigs.optimum,
            T_right_left=SE3(
                turn @ rigs.optimum.T_right_left.R,
                (turn @ rigs.optimum.T_right_left.t[..., None])[..., 0] + xi[:, 3:],
            ),
        )
        np.testing.assert_allclose(distance_sigma(rigs, moved), 1.0, rtol=2e-3)


@pytest.mark.slow
def test_optima_scatter_about_the_truth_by_root_six_sigma(monkeypatch):
    truths = []
    solve = module.solved_rigs

    def spy(options, problem, truth, noise_px):
        truths.append(truth)
        return solve(options, problem, truth, noise_px)

    monkeypatch.setattr(module, "solved_rigs", spy)
    n = 300
    rigs = sample_rigs(replace(FEW_VIEWS, outlier_share=(0.0, 0.0)), n, np.random.default_rng(0))
    squares = distance_sigma(rigs, truths[0]) ** 2
    # chi-square of 6 has mean 6 and variance 12; the mean of 300 is 6 ± 0.2; measured 6.2, median 5.6
    assert np.mean(squares) == pytest.approx(6, abs=0.8)
    assert np.median(squares) == pytest.approx(5.35, abs=0.8)


def test_same_seed_same_cases():
    one, same, other = (sample_rigs(FEW_VIEWS, 2, np.random.default_rng(seed)) for seed in (3, 3, 4))
    for a, b in zip(one.problem.cameras, same.problem.cameras, strict=True):
        np.testing.assert_array_equal(a.pixels, b.pixels)
    np.testing.assert_array_equal(one.optimum.T_right_left.R, same.optimum.T_right_left.R)
    assert not np.array_equal(one.noise_px, other.noise_px)


@pytest.mark.parametrize("name", RIG_SETS)
def test_starts_are_as_far_off_as_stated_and_possible(name):
    rigs = sample_rigs(RIG_SETS[name], 3, np.random.default_rng(5))
    for seed in range(10):
        start = sample_starts(rigs, np.random.default_rng(seed))
        relative = start.T_right_left.R @ rigs.optimum.T_right_left.R.swapaxes(-1, -2)
        angle_deg = np.degrees(np.linalg.norm(so3.log(relative), axis=1))
        baseline_m = np.linalg.norm(rigs.optimum.T_right_left.t, axis=1)
        share = np.linalg.norm(start.T_right_left.t - rigs.optimum.T_right_left.t, axis=1) / baseline_m
        for got, (low, high) in (
            (angle_deg, rigs.options.rotation_deg),
            (share, rigs.options.translation_share),
        ):
            assert (got >= low - 1e-6).all() and (got <= high + 1e-6).all()
        assert all(np.isfinite(r2).all() for r2 in rigs.problem.residual_lengths2(start))


def test_reversed_views_are_as_many_as_stated():
    stress = sample_rigs(RIG_SETS["stress"], 4, np.random.default_rng(2))
    r2 = stress.problem.residual_lengths2(stress.optimum)[1]
    assert (np.sum(np.median(r2, axis=2) > 100, axis=1) == 2).all()  # a fifth of 12 views, rounded; 10 px


def test_selected_rigs_are_the_same_rigs(rigs):
    pick = np.array([4, 1])
    start = sample_starts(rigs, np.random.default_rng(0))
    np.testing.assert_array_equal(
        distance_sigma(rigs.select(pick), take_rigs(start, pick)), distance_sigma(rigs, start)[pick]
    )
    assert rigs.select(pick).n_rigs == 2


def test_selected_rigs_keep_the_weights_of_their_own_corners():
    # (rigs, views, 3, n): without the selection a rig would be solved with the weights of another
    rigs = sample_rigs(RIG_SETS["weak"], 3, np.random.default_rng(0))
    weights = np.random.default_rng(1).uniform(0.5, 2.0, (*rigs.problem.cameras[0].is_seen.shape[:2], 3, 88))
    cameras = tuple(replace(c, whitening=weights) for c in rigs.problem.cameras)
    weighted = replace(rigs, problem=replace(rigs.problem, cameras=cameras))
    part = weighted.select(np.array([2, 0]))
    for camera in part.problem.cameras:
        assert np.array_equal(camera.whitening, weights[[2, 0]])
    whole = weighted.problem.residual_lengths2(weighted.optimum)
    for some, all_of_them in zip(part.problem.residual_lengths2(part.optimum), whole, strict=True):
        assert np.array_equal(some, all_of_them[[2, 0]])
