"""Figures that need no solve: what they draw, and that nothing is drawn where nothing is known."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="Matplotlib is an extra: pip install binocal[report]")

from binocal.report.axes import draw_map, image_height
from binocal.report.corner_figures import (
    draw_board_points,
    draw_coverage,
    draw_residuals,
    draw_view_means,
    draw_views,
    enlargement,
)
from binocal.report.numbers import three_digits, two_digits
from binocal.report.rig_figures import draw_board
from binocal.report.svg import figure_svg
from binocal.result import BoardShape
from binocal.simulation import table2_rig
from binocal.uncertainty.field import image_grid

GRID = image_grid(table2_rig().left)


def test_a_map_has_a_tip_at_every_known_place_and_none_elsewhere():
    values = np.linspace(1, 2, GRID[..., 0].size).reshape(GRID.shape[:2])
    values[0] = np.nan
    figure = figure_svg(lambda axes: draw_map(axes, GRID, values, "px"), name="map", title="a map")
    assert len(figure.tips) == np.isfinite(values).sum() and "1.08 px at (0, " in figure.tips[0][2]
    assert all(0 < x < 4.6 * 72 and 0 < y < 3.2 * 72 for x, y, _ in figure.tips)
    for flat in (np.full(values.shape, 3.0), np.zeros(values.shape), np.full(values.shape, np.nan)):
        figure = figure_svg(lambda axes, flat=flat: draw_map(axes, GRID, flat, "px"), name="map", title="a map")
        assert figure.svg.startswith("<svg") and ("nothing to show here" in figure.svg) == bool(np.isnan(flat).all())


def test_the_height_of_a_board_is_in_its_unit():
    points = np.array([[x, y, 0.001 * (x == 0.1)] for x in (0.0, 0.1, 0.2) for y in (0.0, 0.1)])
    shape = BoardShape(points, np.full(points.shape, 1e-5), 1e-3, 1e-4, 0.0, 1e-4, 0.0, 1e-3)
    figure = figure_svg(lambda axes: draw_board(axes, shape, ("mm", 1e3)), name="board", title="board")
    assert [text for _, _, text in figure.tips][2] == "+0.667 ± 0.01 mm"


def test_arrows_are_enlarged_by_a_round_factor():
    off = np.random.default_rng(0).normal(0, 0.05, (400, 2))
    factor = enlargement(off, (640, 480))
    assert factor == 200 and enlargement(np.zeros((3, 2)), (640, 480)) == 1
    px = np.random.default_rng(1).uniform(0, 400, (4, 100, 2))
    figure = figure_svg(
        lambda axes: draw_residuals(axes, px, off.reshape(4, 100, 2), (640, 480), "left"), name="r", title="residuals"
    )
    assert "residuals x 200" in figure.svg
    nothing = figure_svg(
        lambda axes: draw_residuals(axes, px, np.full(px.shape, np.nan), (640, 480), "left"), name="r", title="none"
    )
    assert nothing.tips == ()


def test_views_and_points_that_one_camera_did_not_see():
    figure = figure_svg(lambda axes: draw_views(axes, ["a", "b"], [0.1, np.nan], [0.2, 0.3]), name="v", title="views")
    assert [text for _, _, text in figure.tips][1] == "view b: left not seen, right 0.300 px"
    points = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]])
    by_point = np.array([[0.1, 0, 0.1, 0], [np.nan] * 4, [0, 0.1, np.nan, np.nan]])
    figure = figure_svg(lambda axes: draw_board_points(axes, points, by_point, ("mm", 1e3)), name="p", title="points")
    assert len(figure.tips) == 3 and "left (+0.100, +0.000) px" in figure.tips[0][2]


@pytest.mark.parametrize("size_wh", [(4000, 100), (100, 4000), (640, 480)])
def test_figures_are_neither_flat_nor_towering(size_wh):
    assert 2 <= image_height(size_wh, 4.6) <= 6


def test_ten_thousand_views_make_no_larger_figures():
    names = [f"{i}" for i in range(10_000)]
    rng = np.random.default_rng(0)
    figure = figure_svg(
        lambda axes: draw_views(axes, names, *rng.uniform(0, 1, (2, 10_000)).tolist()), name="v", title="views"
    )
    assert len(figure.svg) < 500_000 and len(figure.tips) <= 300
    px = rng.uniform(0, 400, (10_000, 30, 2))
    figure = figure_svg(lambda axes: draw_coverage(axes, px, (640, 480), "left"), name="c", title="coverage")
    assert len(figure.svg) < 300_000 and sum(int(text.split()[0]) for _, _, text in figure.tips) == 300_000
    figure = figure_svg(
        lambda axes: draw_view_means(axes, names, rng.normal(0, 1, (10_000, 4))), name="m", title="means"
    )
    assert len(figure.svg) < 1_000_000 and len(figure.tips) <= 300


def test_large_numbers_have_no_powers_of_ten():
    assert [two_digits(v) for v in (0.01234, 99.4, 171.3, 12345.0)] == ["0.012", "99", "171", "12345"]
    assert [three_digits(v) for v in (0.01234, 999.4, 1234.5)] == ["0.0123", "999", "1234"]
