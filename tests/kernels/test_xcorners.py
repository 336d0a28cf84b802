"""The compiled reading of X-corners, their links and groups against plain statements."""

import cv2
import numpy as np
import plain_xcorners as plain
import pytest

from binocal.kernels import images


def make_board(noise_dn=4.0, seed=0, dtype=np.float32):
    """A slanted checker of 17 px squares, smooth edges, with noise; and every place where squares meet."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[:150, :190].astype(float)
    turn, shear = 0.3, 0.15
    x, y = (np.cos(turn) * u + np.sin(turn) * v) / 17, (np.cos(turn) * v + (shear - np.sin(turn)) * u) / 17
    image = 120 + 80 * np.tanh(8 * np.sin(np.pi * x) * np.sin(np.pi * y)) + noise_dn * rng.standard_normal(u.shape)
    A = np.array([[np.cos(turn), np.sin(turn)], [shear - np.sin(turn), np.cos(turn)]]) / 17
    cells = np.stack(np.meshgrid(np.arange(-3, 15), np.arange(-6, 12)), axis=-1).reshape(-1, 2)
    points = cells @ np.linalg.inv(A).T
    points = points[((points > 8) & (points < [181, 141])).all(axis=1)]
    return np.clip(np.rint(image), 0, 255).astype(dtype), points + rng.uniform(-0.5, 0.5, points.shape)


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_samples_are_bilinear_and_repeat_the_border(dtype):
    image, _ = make_board(dtype=dtype)
    points = np.random.default_rng(1).uniform(-5, 195, (40, 3, 2))
    assert np.allclose(images.sample(image, points), plain.sample(image, points), atol=1e-3)
    assert images.sample(image, np.array([[189.0, 149.0]]))[0] == image[149, 189]
    assert images.sample(image, np.array([[np.nan, 1.0]]))[0] == 0
    assert images.sample(image, np.zeros((0, 2))).shape == (0,)


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
@pytest.mark.parametrize("noise_dn", [2.0, 25.0])
def test_rings_are_the_plain_statement(dtype, noise_dn):
    image, points = make_board(noise_dn, dtype=dtype)
    points = np.concatenate([points, np.random.default_rng(2).uniform(0, 150, (60, 2))])
    is_corner, rays, contrast = images.read_rings(image, points, 4.0, 6.0, 0.35)
    assert 20 < is_corner.sum() < len(points)
    for i, point in enumerate(points):
        expected, span = plain.read_ring(image, point, 4.0, 6.0, 0.35)
        assert contrast[i] == pytest.approx(span, abs=1e-3)
        assert is_corner[i] == (expected is not None)
        if expected is not None:
            assert np.allclose(rays[i], expected, atol=1e-4)


def test_saddles_are_the_plain_statement():
    image, points = make_board(dtype=np.uint8)
    fit = np.random.default_rng(3).standard_normal((5, 81)) * 1e-4
    step = np.arange(-4, 5)
    y, x = (axis.ravel() for axis in np.meshgrid(step, step, indexing="ij"))
    fit += np.linalg.pinv(np.stack([x * x, x * y, y * y, x, y, np.ones_like(x)], axis=-1).astype(float))[:5]
    points = np.concatenate([points, [[2.0, 50.0], [60.0, 148.0], [np.nan, np.nan]]])
    moved = images.localize_saddles(image, points, fit, 4)
    assert (
        np.array_equal(moved[-3:], points[-3:], equal_nan=True) and (moved[:-3] != points[:-3]).any(axis=1).mean() > 0.9
    )
    assert np.allclose(moved[:-3], [plain.localize_saddle(image, point, fit, 4) for point in points[:-3]], atol=1e-9)


@pytest.mark.parametrize("noise_dn", [3.0, 30.0])
def test_links_and_groups_are_the_plain_statements(noise_dn):
    image, points = make_board(noise_dn)
    is_corner, rays, contrast = images.read_rings(image, points, 4.0, 6.0, 0.45)
    points, rays, contrast = points[is_corner], rays[is_corner], contrast[is_corner]
    neighbour, back_ray = images.link_corners(image, points, rays, contrast, 0.44)
    expected, expected_back = plain.link_corners(image, points, rays, contrast, 0.44)
    assert np.array_equal(neighbour, expected) and (neighbour >= 0).sum() > 40
    assert np.array_equal(back_ray[neighbour >= 0], expected_back[neighbour >= 0])
    groups, plain_groups = (f(points, neighbour, back_ray) for f in (images.grow_groups, plain.grow_groups))
    assert len(groups) == len(plain_groups) > 0
    for group, expected_group in zip(groups, plain_groups, strict=True):
        assert all(np.array_equal(part, whole) for part, whole in zip(group, expected_group, strict=True))
    way = points[neighbour[neighbour >= 0]] - points[np.nonzero(neighbour >= 0)[0]]
    start, sign = points[np.nonzero(neighbour >= 0)[0]], np.tile([1.0, -1.0], len(way))[: len(way)]
    seen = images.follow_edges(image, start, way, sign, np.full(len(way), 60.0))
    assert seen.tolist() == [plain.is_edge(image, *edge, 60.0) for edge in zip(start, way, sign, strict=True)]


def test_a_link_across_a_shadow_does_not_shear_a_group():
    points = np.stack(np.meshgrid(np.arange(6.0), np.arange(4.0)), axis=-1).reshape(-1, 2) * 20
    neighbour, back_ray = np.full((24, 4), -1), np.full((24, 4), -1)
    for i, (x, y) in enumerate((points / 20).astype(int)):
        for ray, (dx, dy) in enumerate(plain.STEPS):
            if 0 <= x + dx < 6 and 0 <= y + dy < 4:
                neighbour[i, ray], back_ray[i, ray] = i + dx + 6 * dy, (ray + 2) % 4
    neighbour[14, 0], neighbour[9, 2], neighbour[15, 2], neighbour[8, 0] = 9, 14, -1, -1  # (2, 2) to (3, 1), not (3, 2)
    groups, plain_groups = (f(points, neighbour, back_ray) for f in (images.grow_groups, plain.grow_groups))
    assert all(np.array_equal(part, whole) for part, whole in zip(groups[0], plain_groups[0], strict=True))
    members, cells, _ = groups[0]
    assert len(members) == 24 and np.array_equal(cells - cells[members == 0], (points[members] / 20).astype(int))


@pytest.mark.usefixtures("unchecked_types")
def test_no_corners_give_no_groups():
    image = np.zeros((40, 40), np.float32)
    none = np.zeros((0, 2)), np.zeros((0, 4)), np.zeros(0)
    neighbour, back_ray = images.link_corners(image, *none, 0.4)
    assert neighbour.shape == (0, 4) and images.grow_groups(none[0], neighbour, back_ray) == []
    assert images.read_rings(image, np.array([[20.0, 20.0]]), 3.0, 6.0, 0.35)[0].tolist() == [False]
    with pytest.raises(ValueError, match="lengths"):
        images.link_corners(image, np.zeros((2, 2)), np.zeros((1, 4)), np.zeros(2), 0.4)


@pytest.mark.usefixtures("unchecked_types")
def test_the_response_is_the_plain_statement():
    image, _ = make_board(noise_dn=8.0)
    response = images.saddle_response(image)
    assert np.allclose(response, plain.saddle_response(image), rtol=1e-4, atol=1e-2)
    into = np.empty_like(image)
    assert images.saddle_response(image, into) is into and np.array_equal(into, response)
    with pytest.raises(ValueError, match="shape"):
        images.saddle_response(image, np.empty((3, 3), np.float32))


@pytest.mark.parametrize("reach, margin, least, most", [(1, 1, -1e9, 100_000), (2, 5, 50.0, 40), (4, 3, 1e9, 10)])
def test_peaks_are_the_plain_statement(reach, margin, least, most):
    image, _ = make_board(noise_dn=8.0)
    response = images.saddle_response(image)
    peaks = images.find_peaks(response, reach, margin, least, most)
    expected = plain.find_peaks(response.astype(float), reach, margin, least, most)
    assert len(peaks) == len(expected) and (len(peaks) > 0) == (least < 1e6)
    assert np.allclose(peaks, expected, atol=1e-5)


def test_points_that_are_no_numbers_have_no_links():
    # the search for nearest points once sorted by them, which ended in a crash
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 100, (300, 2))
    lost = rng.random(300) < 0.3
    points[lost, rng.integers(0, 2, lost.sum())] = rng.choice([np.nan, np.inf, -np.inf], lost.sum())
    smooth = rng.integers(0, 255, (100, 100), dtype=np.uint8)
    rays, contrast = rng.uniform(0, 3, (300, 4)), np.full(300, 50.0)
    neighbour, _ = images.link_corners(smooth, points, rays, contrast, 3.2)
    assert (neighbour[lost] == -1).all() and not np.isin(neighbour, np.flatnonzero(lost)).any()
    found, _ = images.link_corners(smooth, points[~lost], rays[~lost], contrast[~lost], 3.2)
    place = np.append(np.flatnonzero(~lost), -1)
    assert np.array_equal(neighbour[~lost], place[found]) and (found >= 0).any()


@pytest.mark.parametrize("shape", [(0, 0), (0, 5), (5, 0)])
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_an_empty_image_is_refused(shape, dtype):
    image, points, n4 = np.zeros(shape, dtype), np.ones((3, 2)), np.zeros((3, 4))
    with pytest.raises(ValueError, match="one pixel at least"):
        images.sample(image, points)
    with pytest.raises(ValueError, match="one pixel at least"):
        images.read_rings(image, points, 3.0, 1.0, 0.5)
    with pytest.raises(ValueError, match="one pixel at least"):
        images.follow_edges(image, points, points, np.ones(3), np.ones(3))
    with pytest.raises(ValueError, match="one pixel at least"):
        images.link_corners(image, points, n4, np.ones(3), 0.3)


def test_a_negative_reach_is_refused():
    with pytest.raises(ValueError, match="reach must be 0 or more"):
        images.localize_saddles(np.zeros((9, 9), np.uint8), np.ones((1, 2)), np.ones((5, 1)), -1)


def test_edges_with_dots_on_their_middles_are_followed_beside_them():
    side = 24
    image = np.kron(np.indices((5, 6)).sum(axis=0) % 2, np.ones((side, side))).astype(np.float32) * 200 + 20
    corners = np.stack(np.meshgrid(np.arange(1, 6), np.arange(1, 5)), axis=-1).reshape(-1, 2) * side - 0.5
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    for n, corner in enumerate(corners):
        for step in ([0.5, 0.0], [0.0, 0.5]):
            dot = corner + np.array(step) * side
            image[np.hypot(x - dot[0], y - dot[1]) < side / 6] = 20 + 200 * (n % 2)
    image = cv2.GaussianBlur(image, (0, 0), 1.0)
    rays = np.tile([0.0, np.pi / 2, np.pi, 1.5 * np.pi], (20, 1))
    # The square beyond a corner is dark where the sum of its places is even: there the second ray has its bright sector after it.
    is_dark = (corners + 0.5).sum(axis=1) // side % 2 == 0
    rays[is_dark] = np.roll(rays[is_dark], -1, axis=1)
    contrast = np.full(20, 200.0)
    dotted, _ = images.link_corners(image, corners, rays, contrast, 0.4, has_dots=True)
    assert (dotted >= 0).sum() == 2 * (4 * 4 + 5 * 3)
