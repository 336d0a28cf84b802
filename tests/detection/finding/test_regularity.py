from __future__ import annotations

import numpy as np
import pytest

from binocal.detection.finding.planes import fit_homography, grid_residuals
from binocal.detection.finding.regularity import find_irregular, keep_regular

H = np.array([[60.0, 8, 120], [-5, 58, 90], [0.01, 0.02, 1]])


def grid(columns=9, rows=6):
    return np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2).astype(float)


def project(xy):
    mapped = np.column_stack([xy, np.ones(len(xy))]) @ H.T
    return mapped[:, :2] / mapped[:, 2:]


def test_a_homography_is_recovered():
    xy = grid()
    assert np.allclose(fit_homography(xy, project(xy)) / fit_homography(xy, project(xy))[2, 2], H, atol=1e-9)
    assert np.isnan(fit_homography(xy[:3], project(xy[:3]))).all()


def test_a_plane_through_a_bent_lens_is_regular():
    points = project(grid())
    centred = (points - points.mean(axis=0)) / 300
    bent = points + centred * (centred**2).sum(axis=1, keepdims=True) * -40
    assert grid_residuals(grid(), bent).max() < 2.5  # measured 2.1, the lens bends by 60 px
    assert not find_irregular(grid(), bent, np.full(54, 50.0)).any()


def test_wild_points_are_named_and_no_others():
    points = project(grid())
    points[[7, 30]] += [9, -12]
    assert np.nonzero(find_irregular(grid(), points, np.full(54, 50.0)))[0].tolist() == [7, 30]


def test_mirrored_and_shuffled_grids_are_irregular():
    mirrored = project(grid()).reshape(6, 9, 2)[:, ::-1].reshape(-1, 2)
    assert find_irregular(grid(), mirrored, np.full(54, 50.0)).all()
    shuffled = np.random.default_rng(0).permutation(project(grid()))
    assert find_irregular(grid(), shuffled, np.full(54, 50.0)).mean() > 0.5


@pytest.mark.parametrize(("off", "is_irregular"), [(0.08, False), (0.12, True)])
def test_a_tenth_of_the_spacing_is_the_limit(off, is_irregular):
    points = project(grid())
    points[22, 0] += off * 50
    assert find_irregular(grid(), points, np.full(54, 50.0)).any() == is_irregular


@pytest.mark.parametrize(("off_px", "is_irregular"), [(0.8, False), (1.2, True)])
def test_where_squares_are_small_a_pixel_is_the_limit(off_px, is_irregular):
    points = project(grid()) / 12  # spacings of 5 px
    points[22, 0] += off_px
    assert find_irregular(grid(), points, np.full(54, 5.0)).any() == is_irregular


def test_few_points_are_never_cleared_by_a_plain_fit():
    xy = grid(4, 4)
    points = project(xy)
    points[0] += [-5.5, -5.2]  # a plain fit bends to it and leaves less than half of the limit
    assert grid_residuals(xy, points, n_rounds=1).max() < 3.5
    assert find_irregular(xy, points, np.full(16, 70.0))[0]


def test_irregular_points_become_nan_and_missing_ones_have_no_say():
    points = project(grid())
    points[7] += [9, -12]
    points[30] = np.nan
    kept = keep_regular(grid(), points, np.full(54, 50.0))
    assert np.nonzero(np.isnan(kept[:, 0]))[0].tolist() == [7, 30] and np.isfinite(points[7]).all()


def test_a_part_shifted_a_little_by_a_shadow_keeps_its_say():
    points = project(grid())
    points[:18] += 0.4  # two rows
    assert not find_irregular(grid(), points, np.full(54, 50.0)).any()
    assert grid_residuals(grid(), points, tolerance_px=2.5).max() < 0.4
