from __future__ import annotations

import numpy as np
import pytest

from binocal.benchmark.wide_lenses import LENSES
from binocal.boards import parse_board
from binocal.detection.finding.grid import grid_spacing
from binocal.detection.finding.planes import fit_homography, grid_residuals
from binocal.detection.finding.regularity import find_irregular, keep_regular
from wide_lenses import see_board

SIZE_WH = (800, 600)
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
    assert not find_irregular(grid(), bent, np.full(54, 50.0), SIZE_WH).any()


def test_wild_points_are_named_and_no_others():
    points = project(grid())
    points[[7, 30]] += [9, -12]
    assert np.nonzero(find_irregular(grid(), points, np.full(54, 50.0), SIZE_WH))[0].tolist() == [7, 30]


def test_mirrored_and_shuffled_grids_are_irregular():
    mirrored = project(grid()).reshape(6, 9, 2)[:, ::-1].reshape(-1, 2)
    assert find_irregular(grid(), mirrored, np.full(54, 50.0), SIZE_WH).all()
    shuffled = np.random.default_rng(0).permutation(project(grid()))
    assert find_irregular(grid(), shuffled, np.full(54, 50.0), SIZE_WH).mean() > 0.5


@pytest.mark.parametrize(("off", "is_irregular"), [(0.08, False), (0.12, True)])
def test_a_tenth_of_the_spacing_is_the_limit(off, is_irregular):
    points = project(grid())
    points[22, 0] += off * 50
    assert find_irregular(grid(), points, np.full(54, 50.0), SIZE_WH).any() == is_irregular


@pytest.mark.parametrize(("off_px", "is_irregular"), [(0.8, False), (1.2, True)])
def test_where_squares_are_small_a_pixel_is_the_limit(off_px, is_irregular):
    points = project(grid()) / 12  # spacings of 5 px
    points[22, 0] += off_px
    assert find_irregular(grid(), points, np.full(54, 5.0), SIZE_WH).any() == is_irregular


def test_few_points_are_never_cleared_by_a_plain_fit():
    xy = grid(4, 4)
    points = project(xy)
    points[0] += [-5.78, -5.46]  # a plain fit bends to it and leaves less than half of the limit
    assert grid_residuals(xy, points, n_rounds=1).max() < 3.5
    assert find_irregular(xy, points, np.full(16, 70.0), SIZE_WH)[0]


def test_irregular_points_become_nan_and_missing_ones_have_no_say():
    points = project(grid())
    points[7] += [9, -12]
    points[30] = np.nan
    kept = keep_regular(grid(), points, np.full(54, 50.0), SIZE_WH)
    assert np.nonzero(np.isnan(kept[:, 0]))[0].tolist() == [7, 30] and np.isfinite(points[7]).all()


def test_a_part_shifted_a_little_by_a_shadow_keeps_its_say():
    points = project(grid())
    points[:18] += 0.4  # two rows
    assert not find_irregular(grid(), points, np.full(54, 50.0), SIZE_WH).any()
    assert grid_residuals(grid(), points, tolerance_px=2.5).max() < 0.4


@pytest.mark.parametrize("size_wh", [(640, 480), (1920, 1200)], ids=str)
@pytest.mark.parametrize("degrees", LENSES)
def test_no_board_is_irregular_through_any_lens(degrees, size_wh):
    rng = np.random.default_rng(0)
    for seed, spec in enumerate(("4x3:70mm", "5x4:60mm", "7x5:40mm", "9x6:30mm", "11x8:25mm") * 3):
        board = parse_board(f"chessboard:{spec}")
        xy, points = see_board(degrees, f"chessboard:{spec}", seed, size_wh)
        spacing = grid_spacing(points.reshape(board.rows, board.columns, 2)).ravel()
        points += 0.3 * rng.standard_normal(points.shape)
        assert not find_irregular(xy, points, spacing, size_wh).any()


@pytest.mark.parametrize("degrees", LENSES)
def test_faults_are_found_through_any_lens(degrees):
    for seed, spec in enumerate(("7x5:40mm", "9x6:30mm", "11x8:25mm")):
        board = parse_board(f"chessboard:{spec}")
        xy, points = see_board(degrees, f"chessboard:{spec}", seed)
        spacing = grid_spacing(points.reshape(board.rows, board.columns, 2)).ravel()
        stray = points.copy()
        stray[8] += 0.35 * spacing[8] * np.array([0.8, 0.6])
        assert np.nonzero(find_irregular(xy, stray, spacing, (640, 480)))[0].tolist() == [8]
        grid = points.reshape(board.rows, board.columns, 2).copy()
        grid[0] = grid[1] + 0.7 * (grid[0] - grid[1])  # an edge of the paper taken for a row
        assert find_irregular(xy, grid.reshape(-1, 2), spacing, (640, 480)).any()
        grid = points.reshape(board.rows, board.columns, 2)[:, ::-1].reshape(-1, 2)
        assert find_irregular(xy, grid, spacing, (640, 480)).all()


def test_few_points_or_points_on_a_line_contradict_no_plane():
    xy, points = see_board(60, "chessboard:5x4:60mm", 0)
    spacing = np.full(20, 40.0)
    for kept in ([0, 1, 2, 8], [1, 6, 11, 7], [0, 1, 2, 3, 4, 7], [0, 1, 2, 3, 4], [0, 1, 2]):
        assert not find_irregular(xy[kept], points[kept], spacing[kept], (640, 480)).any()
