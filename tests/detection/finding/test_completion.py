"""Holes, borders and what lies beyond them, on drawn boards: each limit from both sides."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from binocal.detection.finding.completion import predict_missing, trim_borders
from binocal.detection.finding.groups import CornerGroup, join_across_gaps
from binocal.detection.finding.lattice import Lattice, continues_beyond
from binocal.detection.finding.xcorners import SaddleImage, XCorners, find_x_corners

PITCH = 24


def drawn(columns=8, rows=5, last_step=1.0):
    """An image with so many corners, dark square first; its last row may be further off than a step. And the corners."""
    lines = [np.arange(1, n + 1) * float(PITCH) for n in (columns, rows)]
    lines[1][-1] += (last_step - 1) * PITCH
    y, x = np.mgrid[: (rows + 2) * PITCH, : (columns + 1) * PITCH]
    squares = [
        np.searchsorted(line, at.ravel(), side="right").reshape(at.shape)
        for line, at in zip(lines, (x, y), strict=True)
    ]
    image = np.where((squares[0] + squares[1]) % 2 == 1, 210.0, 40.0)
    return image, np.stack(np.meshgrid(*lines), axis=-1) - 0.5


def saddles_of(image):
    return SaddleImage.of(cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.2), 4.0)


def goes_on(image, corners):
    """Whether the lattice without its last column is seen to go on."""
    saddles = saddles_of(image)
    return continues_beyond(saddles, find_x_corners(saddles), Lattice(corners[:, :-1], True, 170.0))


@pytest.mark.parametrize(("contrast", "expected"), [(1.0, True), (0.7, True), (0.55, False)])
def test_a_column_beyond_has_the_lattices_contrast(contrast, expected):
    image, corners = drawn()
    beyond = image[:, int(corners[0, -1, 0]) - PITCH // 2 :]
    beyond[...] = 125 + contrast * (beyond - 125)
    assert goes_on(image, corners) is expected


def test_a_lattice_fainter_than_what_is_beyond_it_ends_there():
    image, corners = drawn()
    before = image[:, : int(corners[0, -1, 0]) - PITCH // 2]
    before[...] = 125 + 0.6 * (before - 125)
    saddles = saddles_of(image)
    assert not continues_beyond(saddles, find_x_corners(saddles), Lattice(corners[:, :-1], True, 0.6 * 170.0))


def test_every_corner_and_every_edge_of_a_column_beyond_must_be_seen():
    image, corners = drawn()
    x, y = corners[2, -1].astype(int)
    covered, cut = image.copy(), image.copy()
    covered[y - 8 : y + 9, x - 8 : x + 9] = 120.0
    cut[y + 9 : y + 16, x - 8 : x + 9] = 120.0  # the edge to the next corner of the column
    assert goes_on(image, corners) and not goes_on(covered, corners) and not goes_on(cut, corners)


@pytest.mark.parametrize(("last_step", "n_rows"), [(1.0, 5), (1.2, 5), (1.4, 4)])
def test_a_border_row_that_breaks_the_step_is_taken_off(last_step, n_rows):
    image, corners = drawn(last_step=last_step)
    grid = np.concatenate([corners, np.full((5, 8, 1), 170.0)], axis=-1)
    trimmed, is_bright_first = trim_borders(saddles_of(image).smooth, grid, False)
    assert trimmed.shape == (n_rows, 8, 3) and not is_bright_first


def test_a_border_row_without_edges_is_taken_off():
    image, corners = drawn()
    image[int(corners[-1, 0, 1]) - PITCH // 2 :] = 120.0
    grid = np.concatenate([corners, np.full((5, 8, 1), 170.0)], axis=-1)
    assert trim_borders(saddles_of(image).smooth, grid, False)[0].shape == (4, 8, 3)


@pytest.mark.parametrize(("shift", "is_predicted"), [(0.4, True), (2.0, False)])
def test_row_and_column_must_agree_on_a_hole(shift, is_predicted):
    grid = np.stack(np.meshgrid(10.0 * np.arange(5), 10.0 * np.arange(5)), axis=-1)
    grid[:, 2, 0] += 10.0 * shift  # its column says further right than its row
    grid[2, 2] = np.nan
    assert np.isfinite(predict_missing(grid)[0][2, 2]).all() == is_predicted


@pytest.mark.parametrize(("off", "n_joined"), [(0.0, 21), (0.15, 21), (0.25, 20)])
@pytest.mark.parametrize(("ahead", "is_near"), [(2, True), (3, False)])
def test_a_corner_beyond_a_gap_joins_where_it_lies_on_a_cell(off, n_joined, ahead, is_near):
    cells = np.stack(np.meshgrid(np.arange(5), np.arange(4)), axis=-1).reshape(-1, 2)
    places = np.concatenate([cells, [[4 + ahead, 1]]])
    quarter = np.arange(4) * np.pi / 2
    rays = np.array([np.roll(quarter, -(place.sum() % 2)) for place in places])
    points = 20.0 * places
    points[-1, 0] += off * 20
    corners = XCorners(points, rays, np.full(21, 100.0))
    group = CornerGroup(np.arange(20), cells, cells.sum(axis=1) % 2, 31)
    members, joined = join_across_gaps(corners, group)
    assert len(members) == len(joined) == (n_joined if is_near else 20)
    turned = XCorners(points, np.roll(rays, 1, axis=1), corners.contrast_dn)
    turned.rays_rad[:20] = rays[:20]  # the lone one has the other colours
    assert len(join_across_gaps(turned, group)[0]) == 20
