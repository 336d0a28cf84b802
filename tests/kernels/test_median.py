"""The kernel's median against NumPy's."""

import numpy as np
import pytest

from binocal.kernels import median_lengths2


@pytest.mark.parametrize("n", [1, 2, 3, 10, 88, 1001])
@pytest.mark.parametrize("kind", ["noise", "zeros", "ties", "wide", "infinite"])
def test_the_median_is_numpys(n, kind):
    rng = np.random.default_rng(n)
    r2 = {
        "noise": rng.chisquare(2, (3, 2, n)),
        "zeros": np.zeros((3, 2, n)),
        "ties": rng.integers(0, 3, (3, 2, n)).astype(float),
        "wide": 10.0 ** rng.uniform(-30, 30, (3, 2, n)),
        "infinite": np.where(rng.random((3, 2, n)) < 0.2, np.inf, rng.random((3, 2, n))),
    }[kind]
    seen = rng.random(r2.shape) > 0.3
    seen[:, 0, 0] = True
    expected = [np.median(r2[rig][seen[rig]]) for rig in range(3)]
    assert np.array_equal(median_lengths2((r2,), (seen,)), expected)
    both = median_lengths2((r2, 2 * r2), (seen, ~seen))
    assert np.array_equal(both, [np.median(np.r_[r2[i][seen[i]], 2 * r2[i][~seen[i]]]) for i in range(3)])


def test_nothing_seen_gives_zero():
    assert np.array_equal(median_lengths2((np.ones((2, 1, 4)),), (np.zeros((2, 1, 4), dtype=bool),)), [0.0, 0.0])
