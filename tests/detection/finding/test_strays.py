from __future__ import annotations

import numpy as np
import pytest

from binocal.cameras import Camera
from binocal.detection.finding.strays import find_strays, stray_note
from binocal.geometry import SE3
from binocal.geometry.so3 import exp


def markers(columns, rows):
    """Corners of the markers of a ChArUco board, squares."""
    squares = np.array([(x, y) for y in range(rows) for x in range(columns) if (x + y) % 2])
    return squares[:, None] + np.array([[0.15, 0.15], [0.85, 0.15], [0.85, 0.85], [0.15, 0.85]])


def seen_by(places, camera, xi_rad, distance):
    X = np.concatenate([places.reshape(-1, 2), np.zeros((4 * len(places), 1))], axis=1)
    R = exp(np.array(xi_rad))
    return camera.project(SE3(R, np.array([0, 0, distance]) - R @ X.mean(axis=0)).apply(X)).reshape(-1, 4, 2)


PINHOLE = Camera("brown4", (640, 480), np.r_[600, 600, 320, 240, 0, -0.3, 0.1, 0, 0])
FISHEYE = Camera("fisheye4", (640, 480), np.r_[230.0, 230, 320, 240, 0, 0, 0, 0, 0])


@pytest.mark.parametrize(("camera", "distance"), [(PINHOLE, 16.0), (FISHEYE, 5.0)])
@pytest.mark.parametrize("xi_rad", [(0.3, -0.2, 0.1), (-0.6, 0.5, 2.0)])
def test_strays_are_told_from_the_board_whatever_the_lens(camera, distance, xi_rad):
    rng = np.random.default_rng(0)
    places = markers(12, 9)
    quads = seen_by(places, camera, xi_rad, distance) + rng.normal(0, 0.4, (len(places), 4, 2))
    assert not find_strays(places, quads).any()
    for n_strays in (1, 3, 12):
        strays = rng.choice(len(places), n_strays, replace=False)
        moved = quads.copy()
        moved[strays] = quads[strays[0]] + rng.uniform(150, 400, (n_strays, 1, 2))
        found = find_strays(places, moved)
        assert found[strays].all() and found.sum() <= n_strays + 1  # one whose neighbours are all stray goes with them


def test_where_no_majority_agrees_none_is_believed():
    places = markers(6, 5)
    quads = seen_by(places, PINHOLE, (0.1, 0.2, 0.0), 10.0)
    assert find_strays(places[:2], quads[:2]).all()
    order = np.random.default_rng(1).permutation(len(places))
    assert find_strays(places, quads[order]).all()
    assert find_strays(places, quads[:, ::-1]).all()  # seen from behind


def test_the_note_counts():
    assert stray_note(1, "tag") == "a tag lies elsewhere than on the board and was left out"
    assert stray_note(2, "marker") == "2 markers lie elsewhere than on the board and were left out"
