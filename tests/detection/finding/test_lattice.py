from __future__ import annotations

import cv2
import numpy as np

from binocal.detection.finding.completion import predict_missing
from binocal.detection.finding.groups import link_corners
from binocal.detection.finding.lattice import continues_beyond, find_lattices
from binocal.detection.finding.xcorners import SaddleImage, find_x_corners, read_rings
from binocal.detection.measuring.saddles import localize_saddles


def smooth_of(image):
    return cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.0)


def saddles_of(image):
    return SaddleImage.of(smooth_of(image), 3.0)


def lattices_of(saddles):
    corners = find_x_corners(saddles)
    return find_lattices(saddles, corners, link_corners(saddles, corners))


def test_x_corners_are_the_boards_and_their_rays_follow_the_edges(shoot):
    shot = shoot("chessboard:9x6:30mm", (0.0, 0.0, 0.0), clutter_dn=0.0)
    corners = find_x_corners(saddles_of(shot.image))
    distance = np.linalg.norm(corners.points_px[:, None] - shot.corners_px[None], axis=-1)
    assert distance.min(axis=0).max() < 1.0
    at = distance.argmin(axis=0)
    assert np.abs(np.sin(2 * corners.rays_rad[at])).max() < 0.2  # along the axes of an upright board
    is_bright_after = (corners.rays_rad[at, 0] % np.pi) < np.pi / 4
    assert len(np.unique(is_bright_after.reshape(6, 9)[:, ::2] ^ (np.arange(6) % 2 == 0)[:, None])) >= 1


def test_edges_and_flat_areas_are_no_corners():
    image = np.zeros((60, 60), np.float32)
    image[:, 30:] = 200
    is_corner, _, _ = read_rings(smooth_of(image), np.array([[29.5, 30.0], [10.0, 10.0]], np.float32), 3.0)
    assert not is_corner.any()
    assert len(find_x_corners(saddles_of(np.full((60, 60), 90, np.uint8)))) == 0


def test_a_lattice_has_the_boards_size_and_order(shoot):
    shot = shoot("chessboard:9x6:30mm")
    saddles = saddles_of(shot.image)
    lattice = lattices_of(saddles)[0]
    assert lattice.size == (9, 6) and lattice.n_seen == 54
    a, b = lattice.points_px[0, 1] - lattice.points_px[0, 0], lattice.points_px[1, 0] - lattice.points_px[0, 0]
    assert a[0] * b[1] - a[1] * b[0] > 0  # not mirrored
    assert not continues_beyond(saddles, find_x_corners(saddles), lattice)


def test_a_part_of_a_board_is_seen_to_continue(shoot):
    saddles = saddles_of(shoot("chessboard:9x6:30mm").image)
    lattice = lattices_of(saddles)[0]
    part = type(lattice)(lattice.points_px[:, :-1], lattice.is_dark_first, lattice.contrast_dn)
    assert continues_beyond(saddles, find_x_corners(saddles), part)


def test_a_hole_is_predicted_from_its_neighbours():
    grid = np.stack(np.meshgrid(10.0 * np.arange(5), 8.0 * np.arange(4)), axis=-1)
    holed = grid.copy()
    holed[1, 2] = np.nan
    predicted, spacing = predict_missing(holed)
    assert np.allclose(predicted[1, 2], grid[1, 2]) and spacing[1, 2] == 8.0
    assert np.isfinite(predicted[..., 0]).sum() == 1


def test_saddles_are_localised_from_two_pixels_away(shoot):
    shot = shoot("chessboard:9x6:30mm", noise_dn=1.0)
    spacing = np.full(54, 25.0)
    rough = shot.corners_px + np.random.default_rng(0).uniform(-2, 2, (54, 2))
    rough[7] = np.nan
    found = localize_saddles(shot.image, rough, spacing)
    error = np.linalg.norm(found - shot.corners_px, axis=1)
    assert np.isnan(error[7]) and np.nanmax(error) < 0.3  # measured 0.15
    flat = localize_saddles(np.full((60, 60), 90, np.uint8), np.array([[30.2, 30.4]]), np.array([12.0]))
    assert np.allclose(flat, [[30.2, 30.4]])


def test_parts_of_a_board_are_joined_across_a_gap(shoot):
    saddles = saddles_of(shoot("chessboard:9x6:30mm", (0.1, 0.2, 0.1)).image)
    corners = find_x_corners(saddles)
    grid = lattices_of(saddles)[0].points_px
    if grid.shape[0] > grid.shape[1]:
        grid = grid.transpose(1, 0, 2)
    gap = grid[:, 4]  # the links across this column are lost with its corners
    is_kept = np.linalg.norm(corners.points_px[:, None] - gap[None], axis=-1).min(axis=1) > 3
    rest = type(corners)(corners.points_px[is_kept], corners.rays_rad[is_kept], corners.contrast_dn[is_kept])
    groups = link_corners(saddles, rest)
    assert len(groups[0]) == 24 and len(groups[1]) == 24
    lattices = find_lattices(saddles, rest, groups, size=(9, 6))
    assert lattices[0].size == (9, 6) and lattices[0].n_seen == 54 and len(lattices) == 1
