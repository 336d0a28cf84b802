from __future__ import annotations

import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.cameras import Camera
from binocal.detection.finding.circle_layout import match_circles, measure_lattice
from binocal.detection.finding.point_lattice import grow_point_lattices
from binocal.geometry import SE3
from binocal.geometry.so3 import exp
from binocal.initialization.symmetries import board_symmetries

SIZE_WH = 1280, 960


def through_lens(spec, field_deg, xi_rad, distance):
    """The board's circles through an equidistant lens: their images, in an order of chance, and which is which."""
    board = parse_board(spec)
    f = SIZE_WH[0] / np.radians(field_deg)
    camera = Camera("fisheye4", SIZE_WH, np.r_[f, f, SIZE_WH[0] / 2, SIZE_WH[1] / 2, np.zeros(5)])
    points = board.object_points_m
    R, extent = exp(np.array(xi_rad)), float(np.ptp(points[:, 0]))
    seen = camera.project(SE3(R, np.array([0, 0, distance * extent]) - R @ points.mean(axis=0)).apply(points))
    order = np.random.default_rng(1).permutation(board.n_points)
    return board, seen[order], order


def grow(points, board):
    radii = np.full(len(points), 10.0)
    return grow_point_lattices(points, radii, SIZE_WH, least=board.n_points // 2, enough=board.n_points)


@pytest.mark.parametrize("spec", ["circles:7x5:30mm", "circles:10x10:30mm", "acircles:4x11:20mm"])
@pytest.mark.parametrize("field_deg", [110, 150, 180])
@pytest.mark.parametrize("xi_rad", [(0.1, 0.2, 0.3), (-0.4, 0.3, 2.0), (0.3, -0.4, -2.5)])
def test_grids_are_followed_through_strong_lenses(spec, field_deg, xi_rad):
    board, points, order = through_lens(spec, field_deg, xi_rad, distance=0.55)
    (lattice,) = grow(points, board)
    index = match_circles(lattice, points, board)
    assert index is not None and (index >= 0).all()
    named = order[index]  # the true circle of each board point
    symmetries = board_symmetries(board.object_points_m)
    turns = [k for k, R in enumerate(symmetries.motions.R) if R[2, 2] > 0]
    assert any(np.array_equal(named, symmetries.order[k]) for k in turns)


@pytest.mark.parametrize("roll_rad", [0.3, 1.2, 2.5, -2.0])
def test_a_narrow_grid_is_not_sheared_by_a_place(roll_rad):
    board, points, order = through_lens("circles:2x12:30mm", 60, (0.1, 0.2, roll_rad), distance=12)
    points, order = points[order != 5], order[order != 5]
    (lattice,) = grow(points, board)
    index = match_circles(lattice, points, board)
    assert index is not None and (index < 0).sum() == 1
    known = np.flatnonzero(index >= 0)
    named = order[index[known]].tolist()
    assert named in (known.tolist(), (23 - known).tolist())  # itself, or turned by half


def test_a_stray_spot_beyond_the_grid_does_not_change_its_size():
    board, points, order = through_lens("circles:7x5:30mm", 60, (0.1, 0.2, 0.3), distance=1.5)
    place = np.argsort(order)
    beyond = 2 * points[place[13]] - points[place[12]]  # where the second row would go on
    points = np.concatenate([points, [beyond]])
    (lattice,) = grow(points, board)
    assert len(lattice.members) == 36
    index = match_circles(lattice, points, board)
    assert index is not None and sorted(index) == list(range(35))
    assert measure_lattice(lattice, points, "circles") in (((7, 5), 35), ((5, 7), 35))


def test_a_larger_grid_is_not_cut_to_the_board():
    board, points, _ = through_lens("circles:7x5:30mm", 60, (0.1, 0.2, 0.3), distance=1.5)
    (lattice,) = grow(points, board)
    assert match_circles(lattice, points, parse_board("circles:6x5:30mm")) is None


def test_points_without_order_make_no_lattice():
    points = np.random.default_rng(0).uniform(0, 1000, (60, 2))
    assert all(
        len(lattice.members) < 20
        for lattice in grow_point_lattices(points, np.full(60, 9.0), SIZE_WH, least=4, enough=60)
    )
