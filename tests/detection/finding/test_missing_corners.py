from __future__ import annotations

import numpy as np
import pytest

from binocal.detection.finding.marker_codes import CodeKind
from binocal.detection.finding.marker_grid import charuco_grid
from binocal.detection.finding.marker_search import search_markers
from binocal.detection.finding.missing_corners import grow_missing


@pytest.fixture(scope="module")
def sighting(shoot):
    shot = shoot("charuco:8x6:30mm:22mm:DICT_5X5_50", size_wh=(640, 480), distance=1.9)
    grid = charuco_grid(shot.board, False)
    kind = CodeKind(shot.board.dictionary, 1, grid.free, grid.free / (1 - 2 * grid.free))
    return shot, search_markers(shot.image, [grid], [kind], 0).sightings[0]


def test_missed_corners_are_found_in_parts_of_the_full_image(sighting):
    shot, seen = sighting
    truth = shot.corners_px[seen.grid.points]
    known = seen.known_px.copy()
    known[:2, :3] = known[4, 6] = np.nan
    before = known.copy()
    grown = grow_missing(shot.image, seen.grid, known, seen.reading.lens, is_inverted=False)
    assert np.linalg.norm(grown - truth, axis=-1).max() < 1.0  # measured 0.5
    assert np.array_equal(known, before, equal_nan=True)
    assert np.array_equal(grown[~np.isnan(before)], before[~np.isnan(before)])


def test_a_hidden_corner_stays_missing(sighting):
    shot, seen = sighting
    known = seen.known_px.copy()
    known[2, 3] = np.nan
    x, y = np.rint(seen.known_px[2, 3]).astype(int)
    image = shot.image.copy()
    image[y - 12 : y + 13, x - 12 : x + 13] = 120
    assert np.isnan(grow_missing(image, seen.grid, known, seen.reading.lens, is_inverted=False)[2, 3]).all()
    inverted = grow_missing(shot.image, seen.grid, known, seen.reading.lens, is_inverted=True)
    assert np.isnan(inverted[2, 3]).all()


def test_a_whole_board_is_left_as_it_is(sighting):
    shot, seen = sighting
    assert grow_missing(shot.image, seen.grid, seen.known_px, seen.reading.lens, is_inverted=False) is seen.known_px
