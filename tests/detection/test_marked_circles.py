"""Circle grids that need not be whole, and grids of rings."""

from __future__ import annotations

import numpy as np
import pytest

from binocal import detect
from binocal.boards import parse_board

OUT_OF_VIEW = {"xi_rad": (0.1, 0.4, 2.5), "distance": 1.2, "shift": (0.25, 0.1)}


@pytest.mark.parametrize("style", ["large", "hollow"])
def test_marked_circles_name_those_that_are_in_view(shoot, style):
    shot = shoot(f"circles:11x9:30mm:{style}", **OUT_OF_VIEW)
    found = detect(shot.image, shot.board)
    assert found.is_found, found.reason
    assert 50 < found.is_seen.sum() < 75 and f"{found.is_seen.sum()} of 99" in found.note
    error = (found.points_px - shot.corners_px)[found.is_seen]
    assert np.abs(error).max() < 0.15  # measured 0.03 to 0.06


def test_marks_tell_a_turned_board_and_a_mirrored_image(shoot):
    shot = shoot("circles:7x7:30mm:large", (0.1, 0.2, -2.9))
    found = detect(shot.image, shot.board)
    assert found.is_found and np.abs(found.points_px - shot.corners_px).max() < 0.15
    assert "mirrored" in detect(np.ascontiguousarray(shot.image[:, ::-1]), shot.board).reason


@pytest.mark.parametrize("style", ["large", "hollow"])
@pytest.mark.parametrize(("way", "n_marks"), [((-0.42, -0.05), 2), ((-0.3, -0.3), 1)])
def test_with_marks_out_of_view_the_boards_edges_name_the_rest(shoot, style, way, n_marks):
    shot = shoot(f"circles:11x9:30mm:{style}", (0.2, 0.3, 0.4), 0.95, way)
    is_in_view = np.isfinite(shot.corners_px[:, 0])
    assert is_in_view[list(shot.board.marked_points)].sum() == n_marks
    found = detect(shot.image, shot.board)
    assert found.is_found, found.reason
    assert np.abs((found.points_px - shot.corners_px)[found.is_seen]).max() < 0.2
    assert found.is_seen.sum() > 0.75 * is_in_view.sum()


def test_without_edges_and_marks_in_view_nothing_is_named(shoot):
    shot = shoot("circles:11x9:30mm:large", distance=0.7, shift=(-0.5, -0.4))
    found = detect(shot.image, shot.board)
    assert not found.is_found and "not the three large ones" in found.reason
    assert (
        "not the three hollow ones"
        in detect(shoot("circles:8x6:30mm").image, parse_board("circles:8x6:30mm:hollow")).reason
    )


@pytest.mark.parametrize("spec", ["circles:8x6:30mm:rings", "acircles:4x9:20mm:rings"])
def test_rings_are_found_as_discs_are(shoot, spec):
    shot = shoot(spec)
    found = detect(shot.image, shot.board)
    assert found.is_found and found.is_seen.all(), found.reason
    error = found.points_px - shot.corners_px
    assert np.sqrt(np.mean(error**2)) < 0.05 and np.abs(error.mean(axis=0)).max() < 0.04  # measured 0.026 and 0.02
