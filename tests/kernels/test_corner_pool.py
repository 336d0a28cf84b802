"""The compiled pooling of corner fits against its plain statement."""

import numpy as np
import plain_corner_pool as plain
import pytest

from binocal.kernels.corner_fits import CORNER_FIT, CornerFits, pool_corners


def make_fits(columns, rows, seed=0, spacing=((41.0, 3.0), (-6.0, 33.0))):
    """Fits as a bent board under a slope of light would give, with one covered, one dull and one failed corner."""
    rng = np.random.default_rng(seed)
    n = columns * rows
    xy = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2) * 0.02
    flat = xy / 0.02 - [columns / 2, rows / 2]
    points = 300 + flat @ spacing * (1 + 4e-4 * (flat**2).sum(axis=1, keepdims=True))
    fits = np.zeros(n, CORNER_FIT)
    fits["point_px"] = points + 0.01 * rng.standard_normal((n, 2))
    fits["light_slope"] = 1e-6 * (points - 300) + 3e-4 + 2e-4 * rng.standard_normal((n, 2))
    factor = rng.standard_normal((n, 4, 6)) * np.array([3e-3, 3e-3, 1e-4, 1e-4])[:, None]
    row, column = np.triu_indices(4)
    fits["covariance"] = (factor @ factor.transpose(0, 2, 1))[:, row, column]
    fits["odd_variance"] = rng.uniform(5, 14, n)
    fits["half_contrast_dn"] = rng.choice([-1, 1], n) * rng.uniform(40, 80, n)
    fits["blur_px"] = rng.uniform(0.26, 1.5, (n, 2))
    fits["edges_rad"] = np.array([0.07, 1.75]) + 0.05 * rng.standard_normal((n, 2))
    fits["radius_px"] = rng.uniform(4, 14, n)
    fits["long_variance"] = np.where(rng.random(n) < 0.4, np.nan, 1.6 * rng.uniform(5, 14, n))
    fits["odd_variance"][2] = 900.0
    fits["odd_variance"][4] = 18.0
    fits.view(float).reshape(n, -1)[3] = np.nan
    return CornerFits(fits)


@pytest.mark.parametrize("size", [(11, 8), (7, 5), (5, 4), (5, 2), (9, 7)], ids=str)
@pytest.mark.parametrize("spacing", [((41.0, 3.0), (-6.0, 33.0)), ((16.0, 1.2), (-2.4, 13.0))], ids=["wide", "narrow"])
def test_pooling_is_the_plain_statement(size, spacing):
    fits = make_fits(*size, spacing=spacing)
    pooled = pool_corners(fits)
    points, covariance, cross, misfit, noise = plain.pool(fits)
    assert np.isnan(pooled.points_px[[2, 3]]).all() and np.isnan(pooled.covariance_px2[[2, 3]]).all()
    assert np.isfinite(np.delete(pooled.points_px, [2, 3], axis=0)).all()
    assert np.allclose(pooled.points_px, points, rtol=0, atol=1e-9, equal_nan=True)
    assert np.allclose(pooled.covariance_px2, covariance, rtol=1e-9, atol=1e-15, equal_nan=True)
    assert np.allclose(pooled.cross_covariance_px2, cross, rtol=1e-9, atol=1e-15, equal_nan=True)
    assert np.any(np.nan_to_num(cross)) == (spacing[0][0] < 28)
    assert np.allclose(pooled.misfit, misfit, equal_nan=True) and pooled.noise_dn == pytest.approx(noise)


def test_no_fit_gives_no_noise():
    pooled = pool_corners(CornerFits(np.full((5, CORNER_FIT.itemsize // 8), np.nan).view(CORNER_FIT)[:, 0]))
    assert np.isnan(pooled.noise_dn) and np.isnan(pooled.points_px).all()
    assert len(pool_corners(CornerFits(np.empty(0, CORNER_FIT))).points_px) == 0
