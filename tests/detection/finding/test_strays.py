from __future__ import annotations

import numpy as np
import pytest

from binocal.cameras import Camera
from binocal.detection.finding.strays import find_strays, stray_note
from binocal.geometry import SE3
from binocal.geometry.so3 import exp
from wide_lenses import wide_camera


def markers(columns, rows):
    """Corners of the markers of a ChArUco board, squares."""
    squares = np.array([(x, y) for y in range(rows) for x in range(columns) if (x + y) % 2])
    return squares[:, None] + np.array([[0.15, 0.15], [0.85, 0.15], [0.85, 0.85], [0.15, 0.85]])


def seen_by(places, camera, xi_rad, distance):
    X = np.concatenate([places.reshape(-1, 2), np.zeros((4 * len(places), 1))], axis=1)
    R = exp(np.array(xi_rad))
    return camera.project(SE3(R, np.array([0, 0, distance]) - R @ X.mean(axis=0)).apply(X)).reshape(-1, 4, 2)


SIZE_WH = (640, 480)
PINHOLE = Camera("brown4", SIZE_WH, np.r_[600, 600, 320, 240, 0, -0.3, 0.1, 0, 0])
FISHEYE = Camera("fisheye4", SIZE_WH, np.r_[230.0, 230, 320, 240, 0, 0, 0, 0, 0])


@pytest.mark.parametrize(("camera", "distance"), [(PINHOLE, 16.0), (FISHEYE, 5.0)])
@pytest.mark.parametrize("xi_rad", [(0.3, -0.2, 0.1), (-0.6, 0.5, 2.0)])
def test_strays_are_told_from_the_board_whatever_the_lens(camera, distance, xi_rad):
    rng = np.random.default_rng(0)
    places = markers(12, 9)
    quads = seen_by(places, camera, xi_rad, distance) + rng.normal(0, 0.4, (len(places), 4, 2))
    assert not find_strays(places, quads, SIZE_WH).any()
    for n_strays in (1, 3, 12):
        strays = rng.choice(len(places), n_strays, replace=False)
        moved = quads.copy()
        moved[strays] = quads[strays[0]] + rng.uniform(150, 400, (n_strays, 1, 2))
        found = find_strays(places, moved, SIZE_WH)
        assert found[strays].all() and found.sum() <= n_strays + 1  # one whose neighbours are all stray goes with them


@pytest.mark.parametrize("degrees", [110, 150, 180, 200])
def test_a_near_board_through_a_wide_lens_has_no_strays(degrees):
    """Large markers near the rim lie by more than their side from where three beside them put them: 9 of 25 images at 200 deg."""
    camera, places = wide_camera(degrees), markers(8, 6)
    X = np.concatenate([places.reshape(-1, 2), np.zeros((4 * len(places), 1))], axis=1)
    n_images = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        ray = camera.unproject(rng.uniform(0.2, 0.8, 2) * SIZE_WH)
        ray = ray / np.linalg.norm(ray)
        axis = np.cross([0.0, 0.0, 1.0], ray)
        towards = exp(axis / np.linalg.norm(axis) * np.arctan2(np.linalg.norm(axis), ray[2]))
        tilt, way = np.radians(rng.uniform(0, 45)), rng.uniform(0, 2 * np.pi)
        R = towards @ exp(tilt * np.array([np.cos(way), np.sin(way), 0.0]))
        in_camera = SE3(R, ray * rng.uniform(2.8, 6.0) - R @ X.mean(axis=0)).apply(X)
        quads = camera.project(in_camera).reshape(-1, 4, 2)
        is_inside = (np.isfinite(quads) & (quads > 2) & (quads < np.array(SIZE_WH) - 3)).all(axis=(1, 2))
        if is_inside.sum() < 8:
            continue
        n_images += 1
        seen = quads[is_inside] + rng.normal(0, 0.3, (is_inside.sum(), 4, 2))
        assert not find_strays(places[is_inside], seen, SIZE_WH).any(), seed
    assert n_images > 20


def test_where_no_majority_agrees_none_is_believed():
    places = markers(6, 5)
    quads = seen_by(places, PINHOLE, (0.1, 0.2, 0.0), 10.0)
    assert find_strays(places[:2], quads[:2], SIZE_WH).all()
    order = np.random.default_rng(1).permutation(len(places))
    assert find_strays(places, quads[order], SIZE_WH).all()
    assert find_strays(places, quads[:, ::-1], SIZE_WH).all()  # seen from behind


def test_the_note_counts():
    why = "(misread, or none of the board's)"  # a marker near the rim of a 200 degree lens is bent until it reads as another
    assert stray_note(1, "tag") == f"a tag lies elsewhere than its number does on the board {why} and was left out"
    assert stray_note(2, "marker").startswith(f"2 markers lie elsewhere than their numbers do on the board {why}")
