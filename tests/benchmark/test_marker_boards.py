from __future__ import annotations

import numpy as np
import pytest

from binocal.benchmark import marker_boards, marker_peers
from binocal.benchmark.marker_boards import BOARDS, draw_marker_board, run_marker_board_benchmark
from binocal.benchmark.marker_peers import marker_board_finders


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
        (b, f) for b in BOARDS for f in (("binocal",) if "puzzle" in b else ("binocal", "OpenCV"))
    ]
    own = [row for row in table["rows"] if row["finder"] == "binocal"]
    assert all(
        row["n_found"] >= 0.97 * row["n_visible"] and row["n_wrong"] == 0 and row["rms_px"] < 0.02 for row in own
    )
    assert table["text"].count("\n") == 8


def test_opencv_names_a_part_of_a_marked_board_as_it_is():
    scene = draw_marker_board(BOARDS[2], "ordinary", 0, 1)
    off = np.linalg.norm(marker_board_finders(scene.board)["OpenCV"](scene.image) - scene.corners_px, axis=1)
    assert np.isfinite(off).all() and off.max() < 2.0  # measured 1.1
    assert np.isnan(marker_board_finders(scene.board)["OpenCV"](np.full((480, 640), 90, np.uint8))).all()


@pytest.mark.parametrize("is_installed", [False, True])
def test_apriltag_is_run_where_it_reads_the_tags_and_its_absence_is_said(monkeypatch, is_installed):
    found = np.full((144, 2), np.nan)
    monkeypatch.setattr(marker_boards, "has_apriltag", lambda: is_installed)
    monkeypatch.setattr(marker_peers, "has_apriltag", lambda: is_installed)
    monkeypatch.setattr(marker_peers, "_apriltag", lambda board: lambda image: found)
    table = run_marker_board_benchmark(images=1, cases=("one bit",))
    names = ["binocal", "OpenCV", "AprilTag 3"][: 3 if is_installed else 2]
    assert [(row["board"], row["finder"]) for row in table["rows"]] == [(BOARDS[1], name) for name in names]
    assert table["rows"][0]["n_found"] >= 0.97 * table["rows"][0]["n_visible"]
    assert ("pip install pupil-apriltags" in table["text"]) == (not is_installed)
