"""A bent board with a print that is off: where its points are, and images of it."""

from __future__ import annotations

import numpy as np

import binocal
from binocal.boards import parse_board
from binocal.simulation import PoseOptions, RenderOptions, render_image, sample_board_poses, table2_rig
from binocal.simulation.printed_shape import draw_printed_shape

BOARD = parse_board("chessboard:6x4:20mm")


def test_points_are_where_their_drawing_is_printed():
    shape = draw_printed_shape(BOARD, np.random.default_rng(0), bow_m=3e-4, error_m=5e-5)
    drawn = BOARD.object_points_m / BOARD.pitch_m
    points = shape.points(drawn)
    assert np.allclose(np.stack(shape.drawn_at(points[:, 0], points[:, 1]), axis=-1), drawn[:, :2], atol=1e-12)
    assert np.allclose(points[:, 2], shape.height(points[:, 0], points[:, 1]))
    off_m = (shape.points_m(BOARD) - BOARD.object_points_m)[:, :2]
    assert 3e-5 < off_m.std() < 7e-5
    line = shape.middle[:, None] + shape.half * shape.across[:, None] * np.array([0.0, 1.0])
    assert np.allclose(np.abs(shape.height(*line)) * BOARD.pitch_m, [3e-4, 0.0], atol=1e-12)


def test_what_pixels_see_is_looked_up_at_every_fourth():
    shape = draw_printed_shape(BOARD, np.random.default_rng(0), bow_m=0.0, error_m=5e-5)
    v, u = np.mgrid[0:203, 0:301] / 25.0  # pixels of a 25th of a pitch
    x, y = u - 0.1 * v - 2.0, v + 0.05 * u - 2.0
    off = np.stack(shape.drawn_over_image(x, y)) - np.stack(shape.drawn_at(x, y))
    inside = (x > -0.5) & (x < 5.5) & (y > -0.5) & (y < 3.5)  # beyond lies the rim, where offsets end
    assert np.abs(off[:, inside]).max() * 25 < 1e-3 and np.sqrt(np.mean(off[:, inside] ** 2)) * 25 < 1e-4


def test_a_flat_sheet_without_errors_is_the_board():
    shape = draw_printed_shape(BOARD, np.random.default_rng(0), bow_m=0.0, error_m=0.0)
    assert np.array_equal(shape.points_m(BOARD), BOARD.object_points_m)


def test_an_image_shows_the_corners_where_they_are():
    rng, rig = np.random.default_rng(1), table2_rig()
    T = sample_board_poses(rig, BOARD, 1, rng, PoseOptions(fill=(0.3, 0.4)))[0]
    shape = draw_printed_shape(BOARD, rng, bow_m=1e-3, error_m=5e-5)
    seen = render_image(rig.left, T, BOARD, RenderOptions(noise_dn=0.0, clutter_dn=0.0, shape=shape), rng)
    found = binocal.detect(seen.image, BOARD)
    flat_px = rig.left.project(T.apply(BOARD.object_points_m))
    error, moved = found.points_px - seen.corners_px, flat_px - seen.corners_px
    # what is left is that the print's lines bend between the corners
    assert np.sqrt(np.mean(error**2)) < 0.02 < 0.3 < np.sqrt(np.mean(moved**2))
    assert np.abs(error.mean(axis=0)).max() < 0.003
