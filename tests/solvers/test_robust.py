"""The robust kernels and their scale."""

import numpy as np
import pytest

from binocal.solvers import robust


@pytest.mark.parametrize("kernel", ["cauchy", "hampel"])
def test_weights_are_the_slope_of_the_cost(kernel):
    r = np.linspace(0.01, 12, 400)
    scale = np.asarray(1.3)
    slope = (robust.costs((r + 1e-6) ** 2, scale, kernel) - robust.costs((r - 1e-6) ** 2, scale, kernel)) / 2e-6
    assert np.abs(slope - robust.weights(r * r, scale, kernel) * r).max() < 1e-5


def test_the_median_scale_is_unbiased_and_floored():
    r2 = (np.random.default_rng(0).normal(0, 0.3, (2, 20000)) ** 2).sum(axis=0)
    assert robust.scale_of_median(np.median(r2)) == pytest.approx(0.3, rel=0.02)
    assert robust.scale_of_median(np.zeros(2)) == pytest.approx(robust.SCALE_FLOOR_PX)


def test_hampels_weight_ends_at_seven_scales():
    r2 = (0.2 * np.array([6.99, 7.01])) ** 2
    assert robust.carries_weight(r2, np.asarray(0.2), "hampel").tolist() == [True, False]
    assert (robust.weights(r2, np.asarray(0.2), "hampel") > 0).tolist() == [True, False]
    assert robust.carries_weight(r2, np.asarray(0.2), "cauchy").all()
