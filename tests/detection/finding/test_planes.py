"""The smooth map of a plane: what keeps its weight, and what does not."""

from __future__ import annotations

import numpy as np

from binocal.detection.finding.planes import expected_points, grid_residuals

XY = np.stack(np.meshgrid(np.arange(9), np.arange(6)), axis=-1).reshape(-1, 2).astype(float)


def test_what_noise_may_shift_keeps_its_weight():
    points = 100 + 50 * XY
    points[:18] += 0.25  # two rows of six
    assert grid_residuals(XY, points).max() < 0.15  # measured 0.107: a compromise
    assert grid_residuals(XY, points, tolerance_px=0.0).max() > 0.2  # they would be outliers


def test_what_is_further_off_loses_it():
    points = 100 + 50 * XY
    wild = [3, 17, 28, 40, 51]
    points[wild, 0] += 1.5
    residual = grid_residuals(XY, points)
    assert np.allclose(residual[wild], 1.5, atol=0.01) and np.delete(residual, wild).max() < 0.01


def test_wild_points_do_not_move_what_is_expected():
    points = 100 + 50 * XY
    seen = points.copy()
    seen[:9] = np.nan
    seen[[20, 33, 47], 0] += 12.0
    assert np.abs(expected_points(XY, seen, 50.0, (640, 480)) - points).max() < 0.1  # 6 px if they kept a weight
