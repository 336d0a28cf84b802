"""What pairs have in common counts in the covariance of their common pose."""

from __future__ import annotations

import numpy as np

from binocal.solvers.epipolar import EpipolarEquations
from binocal.solvers.epipolar_covariance import covariance_between_pairs


def equations(J, residuals):
    return EpipolarEquations(residuals, J, np.ones(len(J)), np.asarray(float(residuals @ residuals)))


def test_pairs_that_pull_apart_widen_the_covariance():
    """Against the scatter of 300 least-squares fits in which each pair has an offset of its own."""
    rng = np.random.default_rng(0)
    n_pairs, n = 6, 400
    pair = np.repeat(np.arange(n_pairs), n // n_pairs + 1)[:n]
    J = rng.normal(size=(n, 5))
    fits, stated = [], []
    for _ in range(300):
        own = rng.normal(0, 0.3, (n_pairs, 5))
        y = np.einsum("nq,nq->n", J, own[pair]) + rng.normal(0, 0.1, n)
        x = np.linalg.lstsq(J, y, rcond=None)[0]
        fits.append(x)
        stated.append(np.diagonal(covariance_between_pairs(equations(J, J @ x - y), pair)))
    ratio = np.mean(stated, axis=0) / np.var(fits, axis=0)
    assert np.all((ratio > 0.7) & (ratio < 1.5)), ratio


def test_one_pair_says_nothing_of_others():
    J = np.random.default_rng(1).normal(size=(50, 5))
    assert covariance_between_pairs(equations(J, np.zeros(50)), np.zeros(50, dtype=int)) is None
