"""The compiled reading of lattices with markers against plain statements."""

from __future__ import annotations

import numpy as np
import plain_marker_grids as plain
import plain_xcorners
import pytest
from test_xcorners import make_board

from binocal.kernels import images, marker_grids
from binocal.kernels.marker_grids import FieldLens, Lines

WIDE = FieldLens.of_field((640, 480), np.radians(150))
LENSES = [FieldLens(), WIDE]
LINES = Lines(np.array([0, 1, 1.3, 2.3, 2.6, 3.6]), np.array([0, 1, 1.3, 2.3]), 1.3)


def lattice(lens=WIDE, tilt=0.5):
    """A tilted board's crossings through a lens, exactly."""
    xy = np.stack(np.meshgrid(LINES.x, LINES.y), axis=-1) - [1.8, 1.1]
    at = np.stack([xy[..., 0], np.cos(tilt) * xy[..., 1], 2.5 + np.sin(tilt) * xy[..., 1]], axis=-1)
    if not lens.f_px:
        return 300 * at[..., :2] / at[..., 2:] + [320, 240]
    off = np.hypot(at[..., 0], at[..., 1])
    return [lens.cx, lens.cy] + (lens.f_px * np.arctan2(off, at[..., 2]) / off)[..., None] * at[..., :2]


def linked(columns, rows):
    """The links of a whole lattice, rays to the right, down, left and up."""
    neighbour, back_ray = np.full((columns * rows, 4), -1), np.full((columns * rows, 4), -1)
    for i in range(columns * rows):
        y, x = divmod(i, columns)
        for ray, (dx, dy) in enumerate(plain_xcorners.STEPS):
            if 0 <= x + dx < columns and 0 <= y + dy < rows:
                # A corner's first ray has its bright sector after it: it turns from each corner to the next.
                neighbour[i, (ray + x + y) % 4] = i + dx + columns * dy
                back_ray[i, (ray + x + y) % 4] = (ray + 2 + x + y + dx + dy) % 4
    return neighbour, back_ray


def test_faces_are_all_closed_ways_clockwise():
    faces, is_bright = marker_grids.find_faces(*linked(5, 4))
    first = np.array([5 * y + x for y in range(3) for x in range(4)])
    assert faces.tolist() == np.stack([first, first + 1, first + 6, first + 5], axis=-1).tolist()
    assert np.array_equal(is_bright, (first // 5 + first % 5) % 2 == 0)
    neighbour, back_ray = linked(5, 4)
    neighbour[6, 2], neighbour[7, 3] = -1, -1  # one link between corners 6 and 7
    assert len(marker_grids.find_faces(neighbour, back_ray)[0]) < 12


@pytest.mark.parametrize(("is_oblique", "n_neighbours"), [(False, 24), (True, 96)])
def test_links_beside_markers_are_read_close_to_the_edge(monkeypatch, is_oblique, n_neighbours):
    image, points = make_board(4.0)
    is_corner, rays, contrast = images.read_rings(image, points, 4.0, 6.0, 0.45)
    points, rays, contrast = points[is_corner], rays[is_corner], contrast[is_corner]

    def is_edge(image, start, way, sign, contrast):
        aside = np.clip(1.3 / max(np.linalg.norm(way), 1), 0.05, 0.4) * np.array([-way[1], way[0]])
        along = start + np.array([[0.15], [0.3], [0.5], [0.7], [0.85]]) * way
        step = plain_xcorners.sample(image, along + aside) - plain_xcorners.sample(image, along - aside)
        return bool((sign * step > 0.3 * contrast).all())

    monkeypatch.setattr(plain_xcorners, "is_edge", is_edge)
    neighbour, _ = images.link_corners(image, points, rays, contrast, 0.44, has_markers=True, is_oblique=is_oblique)
    expected, _ = plain_xcorners.link_corners(image, points, rays, contrast, 0.44, n_neighbours=n_neighbours)
    assert np.array_equal(neighbour, expected) and (neighbour >= 0).sum() > 40


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_cells_are_means_of_bilinear_values(lens, dtype):
    image = np.random.default_rng(0).integers(0, 255, (480, 640)).astype(dtype)
    grid = lattice()
    quads = np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]], axis=-2).reshape(-1, 4, 2)
    places = np.random.default_rng(1).uniform(-0.1, 1.1, (7, 4, 2))
    cells = marker_grids.read_cells(image, quads, places, lens)
    for quad, values in zip(quads, cells, strict=True):
        at = plain.in_face(quad, lens, places.reshape(-1, 2))
        assert np.allclose(values, plain_xcorners.sample(image, at).reshape(7, 4).mean(axis=1), atol=0.01)


@pytest.mark.parametrize("lens", LENSES)
def test_predictions_are_the_plain_statement_and_follow_the_lens(lens):
    known = lattice(lens)
    known[1:3, 2:4] = np.nan
    places = np.array([[1.3, 1.0], [2.0, 1.2], [-0.3, 0.0], [3.6, 2.3]])
    predicted = marker_grids.predict_places(LINES, known, lens, places)
    assert np.allclose(predicted, [plain.predict(LINES, known, lens, place) for place in places], atol=1e-6)
    whole = lattice(lens)
    assert np.linalg.norm(predicted[0] - whole[1, 2]) < 0.1 and np.linalg.norm(predicted[3] - whole[3, 5]) < 0.1
    each = marker_grids.predict_each(LINES, known, lens)
    assert np.array_equal(np.isnan(each), np.isnan(known)) and np.nanmax(np.abs(each - known)) < 0.5
    known[0, 0] += 5
    off = np.linalg.norm(marker_grids.predict_each(LINES, known, lens) - known, axis=-1)
    assert np.unravel_index(np.nanargmax(off), off.shape) == (0, 0) and off[0, 0] > 4
    few = np.full_like(known, np.nan)
    few[0, :3] = known[0, :3]
    assert np.isnan(marker_grids.predict_places(LINES, few, lens, places)).all()


@pytest.mark.parametrize("lens", LENSES)
def test_steps_are_differences_of_predictions(lens):
    known = lattice(lens)
    known[1, 2] = np.nan
    steps = marker_grids.predict_steps(LINES, known, lens, 0.2)
    assert np.array_equal(np.isnan(steps[..., 0, 0]), np.isnan(known[..., 0]))
    for row, column in ((0, 0), (2, 3)):
        at = np.array([LINES.x[column], LINES.y[row]])
        for axis in (0, 1):
            off = 0.2 * np.eye(2)[axis]
            ahead, behind = (plain.predict(LINES, known, lens, at + sign * off) for sign in (1, -1))
            # Weights about the corner itself, not about the places probed.
            assert np.linalg.norm(steps[row, column, axis] - (ahead - behind) / 0.4) < 0.02 * np.linalg.norm(
                ahead - behind
            )


def test_votes_leave_out_what_lies_elsewhere():
    grid = lattice()
    crossings = np.array([[[x, y], [x + 1, y], [x + 1, y + 1], [x, y + 1]] for y in (0, 2) for x in (0, 2, 4)])
    quads = grid[crossings[..., 1], crossings[..., 0]]
    corners = np.stack([LINES.x[crossings[..., 0]], LINES.y[crossings[..., 1]]], axis=-1)
    group, agreeing, disagreeing = marker_grids.vote_on_tags(quads, corners, WIDE, LINES.pitch)
    assert len(set(group.tolist())) == 1 and (agreeing == 5).all() and (disagreeing == 0).all()
    corners[[0, 4]] = corners[[4, 0]]
    group, agreeing, disagreeing = marker_grids.vote_on_tags(quads, corners, WIDE, LINES.pitch)
    others = np.array([1, 2, 3, 5])
    assert len(set(group[others].tolist())) == 1 and (agreeing[others] == 3).all() and (disagreeing[others] == 2).all()
    assert (group[[0, 4]] != group[1]).all()


def test_a_lattice_grows_over_its_board_and_not_beyond():
    image, points = make_board(4.0)
    x, y = np.arange(5.0), np.arange(4.0)
    turn, shear = 0.3, 0.15
    A = np.linalg.inv(np.array([[np.cos(turn), np.sin(turn)], [shear - np.sin(turn), np.cos(turn)]]) / 17)
    true = np.stack(np.meshgrid(x + 4, y + 1), axis=-1) @ A.T
    lines = Lines(x, y, 1.0)
    known = np.full_like(true, np.nan)
    known[1:3, 1:3] = true[1:3, 1:3]
    sign = 1.0 if image[tuple(np.rint((np.array([4.5, 1.5]) @ A.T)[::-1]).astype(int))] > 120 else -1.0
    grown, is_new = marker_grids.grow_lattice(image, lines, sign, 0.3, known, points, FieldLens())
    assert is_new.sum() == 16 and np.abs(grown - true).max() < 0.8  # the starts are off by up to 0.7
    none, is_new = marker_grids.grow_lattice(image, lines, -sign, 0.3, known, points, FieldLens())
    assert not is_new.any() and np.array_equal(none, known, equal_nan=True)
    away = points + [6.0, 0.0]
    assert not marker_grids.grow_lattice(image, lines, sign, 0.3, known, away, FieldLens())[1].any()


@pytest.mark.usefixtures("unchecked_types")
def test_arrays_that_do_not_match_are_refused():
    with pytest.raises(ValueError, match="lengths"):
        marker_grids.find_faces(np.zeros((2, 4), np.int64), np.zeros((1, 4), np.int64))
    with pytest.raises(ValueError, match="lengths"):
        marker_grids.predict_places(LINES, np.zeros((2, 2, 2)), WIDE, np.zeros((1, 2)))
    with pytest.raises(ValueError, match="lengths"):
        marker_grids.vote_on_tags(np.zeros((2, 4, 2)), np.zeros((1, 4, 2)), WIDE, 1.0)
