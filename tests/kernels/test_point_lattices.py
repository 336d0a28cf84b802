"""The compiled lattices of plain points, and components, against plain statements."""

import cv2
import numpy as np
import plain_point_lattice as plain
import pytest

from binocal.kernels import _kernel
from binocal.kernels.point_lattices import GrowthLimits, find_nearest, grow_lattice
from binocal.kernels.spots import find_components

LIMITS = GrowthLimits(plain.MAX_STEP_ERROR, plain.SURE_STEP_ERROR, plain.MAX_RADIUS_RATIO)


def bent_grid(rng, columns=9, rows=8, noise=0.5, n_strays=25):
    """A grid bent by a lens, in an order of chance, with gaps and strays; radii that grow to one side."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(float(columns)), np.arange(float(rows))))
    points = 40 * np.column_stack([x + 0.2 * y + 0.2 * x * x / columns, y - 0.1 * x + 0.1 * x * y / columns])
    points = points[rng.random(len(points)) > 0.06] + 100
    points = np.concatenate([points + rng.normal(0, noise, points.shape), rng.uniform(60, 500, (n_strays, 2))])
    points = rng.permutation(points)
    return points, 8 * np.exp(0.001 * points[:, 0] + rng.normal(0, 0.2, len(points)))


@pytest.mark.parametrize("seed", range(4))
def test_neighbours_are_the_plain_statement(seed):
    points, _ = bent_grid(np.random.default_rng(seed))
    found, expected = find_nearest(points, 8), plain.find_nearest(points, 8)
    assert np.array_equal(found[0], expected[0])
    assert np.allclose(found[1], expected[1]) and np.allclose(found[2], expected[2])


@pytest.mark.parametrize("size", [(9, 8), (60, 2)])
def test_growth_is_the_plain_statement(size):
    n_members = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        points, radii = bent_grid(rng, *size, noise=rng.uniform(0, 1.5))
        free = rng.random(len(points)) > 0.02
        start = int(np.argmin(np.linalg.norm(points - points.mean(axis=0), axis=1)))
        basis = np.array([[48.0, -4.0], [8.0, 44.0]])
        members, cells = grow_lattice(points, radii, free, start, basis, LIMITS)
        expected, expected_cells = plain.grow_lattice(points, radii, free, start, basis)
        assert np.array_equal(members, expected) and np.array_equal(cells, expected_cells)
        n_members.append(len(members))
    assert max(n_members) > 60 and np.median(n_members) > 20


def test_points_that_are_no_numbers_are_refused():
    points = np.array([[0.0, 0.0], [1.0, np.nan], [2.0, 2.0]])
    with pytest.raises(ValueError, match="finite"):
        find_nearest(points, 2)
    with pytest.raises(ValueError, match="finite"):
        grow_lattice(points, np.ones(3), np.ones(3, bool), 0, np.eye(2), LIMITS)
    with pytest.raises(ValueError, match="lengths"):
        _kernel.find_nearest(np.zeros((3, 2)), np.zeros((3, 2), np.int64), np.zeros((3, 1)), np.zeros((3, 2)))
    assert all(part.shape == (1, 0) for part in find_nearest(np.zeros((1, 2)), 0))


@pytest.mark.parametrize("seed", range(6))
def test_components_are_the_plain_statement(seed):
    rng = np.random.default_rng(seed)
    image = cv2.GaussianBlur(
        rng.uniform(0, 255, (60 + seed, 83 - seed)).astype(np.uint8), (0, 0), (0.3, 1, 2)[seed % 3]
    )
    around = cv2.blur(image, (15, 15))
    found = find_components(image, around, 2, 3, 30.0)
    expected = plain.find_components(image, around, 2, 3, 30.0)
    records = np.column_stack(
        [found.areas_px, found.sizes_wh, found.means_px, found.moments_px2, found.holds_mean.astype(float)]
    )
    assert len(records) == len(expected) > 2
    assert np.allclose(records, expected, atol=1e-6)


def test_more_components_than_there_was_room_for_are_found():
    image = np.full((200, 200), 200, np.uint8)
    image[1:-1:3, 1:-1:3] = 50
    found = find_components(image, np.full_like(image, 180), 6, 1, 10.0)
    assert len(found.areas_px) == 66 * 66 and (found.areas_px == 1).all() and found.holds_mean.all()
    with pytest.raises(ValueError, match="shapes"):
        _kernel.find_spots(image, image[:, :-1].copy(), 6, 1, 10.0, np.empty((4, _kernel.SPOT_SIZE)))
