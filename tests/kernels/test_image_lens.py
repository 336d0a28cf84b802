"""The lens of one image from its own board."""

import numpy as np
import pytest

from binocal.benchmark.wide_lenses import LENSES
from binocal.kernels.image_lens import LensFitOptions, fit_image_lens
from wide_lenses import see_board

SIZES = ((640, 480), (1920, 1200))


@pytest.mark.parametrize("size_wh", SIZES, ids=str)
@pytest.mark.parametrize("degrees", LENSES)
@pytest.mark.parametrize("is_robust", [False, True])
def test_exact_projections_of_every_lens_lie_on_one(degrees, size_wh, is_robust):
    worst = 0.0
    for seed, spec in enumerate(("chessboard:5x4:60mm", "chessboard:9x6:30mm", "chessboard:11x8:25mm") * 3):
        xy, points = see_board(degrees, spec, seed, size_wh)
        lens = fit_image_lens(xy, points, size_wh, LensFitOptions(is_robust=is_robust))
        assert lens is not None
        worst = max(worst, lens.residual_px.max() * 640 / size_wh[0])
    assert worst < 0.06  # measured: 0.05; homographies with a polynomial of degree 3 leave up to 9 px


@pytest.mark.parametrize("degrees", LENSES)
def test_a_lens_foretells_points_that_it_was_not_shown(degrees):
    for seed in range(6):
        xy, points = see_board(degrees, "chessboard:9x6:30mm", seed)
        shown = xy[:, 0] < xy[:, 0].max() - 0.01  # all but the last column
        lens = fit_image_lens(xy[shown], points[shown], (640, 480), places_xy=xy)
        assert lens is not None
        assert np.abs(lens.images_px - points).max() < 0.35  # measured: 0.2


@pytest.mark.parametrize("degrees", [60, 180])
def test_wild_points_do_not_bend_the_lens(degrees):
    xy, points = see_board(degrees, "chessboard:9x6:30mm", 3)
    wrong = points.copy()
    wrong[[3, 20, 41]] += [[9, -6], [-4, 7], [20, 15]]
    lens = fit_image_lens(xy, wrong, (640, 480), LensFitOptions(is_robust=True), places_xy=xy)
    assert lens is not None
    assert np.abs(lens.images_px - points).max() < 0.1
    assert np.nonzero(lens.residual_px > 2)[0].tolist() == [3, 20, 41]


def test_a_board_seen_from_behind_or_on_a_line_has_no_lens():
    xy, points = see_board(180, "chessboard:9x6:30mm", 3)
    assert fit_image_lens(xy * [-1, 1], points, (640, 480)) is None
    assert fit_image_lens(xy[:3], points[:3], (640, 480)) is None
    assert fit_image_lens(xy, np.where(xy > 0.1, np.nan, points), (640, 480)) is None


def test_an_equidistant_lens_is_w_alone():
    f, half_diagonal = 200.0, 400.0
    xy = np.stack(np.meshgrid(np.arange(9), np.arange(6)), axis=-1).reshape(-1, 2) * 0.3
    rays = np.column_stack([xy - [1.3, 0.6], np.full(54, 0.5)])
    angle = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])
    points = [319.5, 239.5] + f * (angle / np.hypot(rays[:, 0], rays[:, 1]))[:, None] * rays[:, :2]
    lens = fit_image_lens(xy, points, (640, 480), LensFitOptions(has_one_unknown=True))
    assert lens is not None
    assert lens.bending == pytest.approx([(half_diagonal / f) ** 2, 0, 0], abs=1e-3)
    assert lens.residual_px.max() < 1e-3 and lens.centre_px == pytest.approx([319.5, 239.5])
