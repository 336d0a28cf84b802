from __future__ import annotations

import numpy as np
import pytest

from binocal.benchmark.circle_boards import BOARDS, cases_of, circle_board_rows, draw_circle_scene
from binocal.boards import parse_board


def test_plain_grids_are_whole_in_view_and_marked_ones_may_not_be():
    assert "partial" in cases_of(parse_board(BOARDS[2])) and "partial" not in cases_of(parse_board(BOARDS[0]))
    scene = draw_circle_scene(BOARDS[1], "stray", 0, 0)
    assert scene.is_visible.all() and np.isfinite(scene.centres_px).all()
    assert 0.35 <= draw_circle_scene(BOARDS[2], "partial", 0, 0).is_visible.mean() < 1


@pytest.mark.parametrize("case", ["ordinary", "none"])
def test_rows_count_what_is_found_and_what_is_wrong(case):
    own, theirs = circle_board_rows(images=1, seed=0, cases=[case], boards=BOARDS[2:3])
    assert (own["finder"], theirs["finder"]) == ("binocal", "OpenCV") and own["n_wrong"] == 0
    (of_squares,) = circle_board_rows(images=1, seed=0, cases=[case], boards=BOARDS[-2:-1])
    assert of_squares["n_wrong"] == 0 and of_squares["n_found"] == of_squares["n_visible"]
    n = 99 if case == "ordinary" else 0
    assert own["n_found"] == own["n_visible"] == n and (own["rms_px"] is None) == (not n)
