from __future__ import annotations

import numpy as np
import pytest

from binocal.benchmark.marker_boards import (
    BOARDS,
    draw_marker_board,
    marker_board_finders,
    run_marker_board_benchmark,
)


@pytest.mark.parametrize("case", ["covered", "stray"])
def test_hidden_corners_are_not_asked_for(case):
    scene = draw_marker_board(BOARDS[0], case, 0, 0)
    assert np.array_equal(scene.image, draw_marker_board(BOARDS[0], case, 0, 0).image)
    inside = np.isfinite(scene.corners_px[:, 0])
    assert 0.3 * scene.board.n_points <= inside.sum() and scene.is_visible.sum() <= inside.sum()
    assert scene.is_visible.any() and np.isfinite(scene.spacing_px[inside]).all()


def test_the_table_has_a_row_for_each_finder():
    table = run_marker_board_benchmark(images=1, cases=("ordinary",))
    assert [(row["board"], row["finder"]) for row in table["rows"]] == [
        (b, f) for b in BOARDS for f in ("binocal", "OpenCV")
    ]
    own = [row for row in table["rows"] if row["finder"] == "binocal"]
    assert all(
        row["n_found"] >= 0.97 * row["n_visible"] and row["n_wrong"] == 0 and row["rms_px"] < 0.02 for row in own
    )
    assert table["text"].count("\n") == 7


def test_opencv_names_a_part_of_a_marked_board_as_it_is():
    scene = draw_marker_board(BOARDS[2], "ordinary", 0, 1)
    off = np.linalg.norm(marker_board_finders(scene.board)["OpenCV"](scene.image) - scene.corners_px, axis=1)
    assert np.isfinite(off).all() and off.max() < 2.0  # measured 1.1
    assert np.isnan(marker_board_finders(scene.board)["OpenCV"](np.full((480, 640), 90, np.uint8))).all()
