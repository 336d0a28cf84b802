from __future__ import annotations

import numpy as np
import pytest

from binocal.benchmark.corner_bound import corner_bound
from binocal.benchmark.marker_boards import draw_marker_board
from binocal.benchmark.marker_corners import MARKER_BOARDS, marker_corner_bounds, run_marker_corners_benchmark


def test_fewer_pixels_tell_less():
    def sigma(**given):
        fixed = {"blur_px": 0.8, "contrast_dn": 180.0, "noise_dn": 2.0, "radius_px": 10.0}
        return np.sqrt(corner_bound(np.array([50.3, 40.8]), np.array([0.2, 1.9]), **fixed, **given)[0, 0])

    assert sigma() == pytest.approx(sigma(strip_px=10.0)) and sigma(strip_px=3.0) > sigma()
    assert sigma(strip_px=1.0) > 1.2 * sigma(strip_px=3.0) and np.isnan(sigma(strip_px=0.0))
    assert sigma(size_wh=(55.0, 100.0)) > 1.1 * sigma()


@pytest.mark.parametrize("spec", MARKER_BOARDS)
def test_ordinary_corners_are_at_the_bound(spec):
    row = run_marker_corners_benchmark(images=1, seed=3, cases=("ordinary",), boards=(spec,))["rows"][0]
    assert row["n_far"] == 0 and row["n_corners"] >= 0.97 * row["n_visible"]
    assert 0.7 < row["over_bound"] < 1.2 and row["within_2_sigma"] > 0.88, row


def test_corners_out_of_view_have_no_bound():
    scene = draw_marker_board(MARKER_BOARDS[0], "partial", 0, 0)
    assert np.array_equal(np.isfinite(marker_corner_bounds(scene)[:, 0, 0]), scene.is_visible)
