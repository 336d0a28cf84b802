import cv2
import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.cameras import Camera, StereoRig
from binocal.geometry import SE3
from binocal.simulation import (
    PoseOptions,
    RenderOptions,
    random_rig,
    render_image,
    render_light,
    sample_scene,
    table2_rig,
)

CHESS = parse_board("chessboard:11x8:20mm")
LARGE = PoseOptions(fill=(0.5, 0.7), margin_px=10)


def _render(spec, seed, **options):
    rng = np.random.default_rng(seed)
    board = parse_board(spec)
    scene = sample_scene(table2_rig(), board, 1, rng, LARGE)
    image = render_image(scene.rig.left, scene.T_left_board[0], board, RenderOptions(**options), rng)
    return board, scene, image


def test_truth_is_the_projection_and_nan_outside_the_image():
    rig = table2_rig()
    rng = np.random.default_rng(1)
    scene = sample_scene(rig, CHESS, 12, rng, PoseOptions(min_visible_share=0.4, fill=(0.6, 0.8)))
    share = [np.isfinite(px[:, 0]).mean() for px in scene.project()[0]]
    view = int(np.argmin(share))
    assert share[view] < 1
    image = render_image(rig.left, scene.T_left_board[view], CHESS, RenderOptions(), rng)
    assert np.array_equal(image.corners_px, scene.project()[0][view], equal_nan=True)
    assert image.image.shape == (960, 1280)
    assert image.image.dtype == np.uint8


@pytest.mark.parametrize("seed", [1, 2])
def test_opencvs_chessboard_finder_agrees(seed):
    board, _, image = _render("chessboard:9x6:30mm", seed)
    is_found, corners = cv2.findChessboardCorners(image.image, (board.columns, board.rows))
    assert is_found
    corners = cv2.cornerSubPix(image.image, corners, (5, 5), (-1, -1), (3, 50, 1e-4)).reshape(-1, 2)
    if np.abs(corners[0] - image.corners_px[0]).max() > 20:
        corners = corners[::-1]
    error = corners - image.corners_px
    assert np.abs(error.mean(axis=0)).max() < 0.02  # measured 0.004
    assert np.abs(error).max() < 0.15  # measured 0.08


@pytest.mark.parametrize("is_legacy", [False, True])
def test_opencvs_charuco_detector_agrees(is_legacy):
    board, _, image = _render("charuco:7x6:30mm:22mm:DICT_5X5_50", 3, is_legacy_charuco=is_legacy)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_50)
    theirs = cv2.aruco.CharucoBoard((7, 6), board.pitch_m, board.marker_m, dictionary)
    theirs.setLegacyPattern(is_legacy)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(theirs).detectBoard(image.image)
    assert sorted(ids.ravel()) == list(range(board.n_points))
    assert np.allclose(theirs.getChessboardCorners(), board.object_points_m)
    error = corners.reshape(-1, 2) - image.corners_px[ids.ravel()]
    assert np.abs(error.mean(axis=0)).max() < 0.03  # measured 0.01
    assert np.abs(error).max() < 0.25


@pytest.mark.parametrize("border_bits", [1, 2])
def test_opencvs_tag_detector_reads_the_aprilgrid(border_bits):
    board, _, image = _render("aprilgrid:4x3:40mm:0.3", 4, border_bits=border_bits)
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = border_bits
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(image.image)
    assert sorted(ids.ravel()) == list(range(12))
    truth = image.corners_px.reshape(-1, 4, 2)
    order = {int(tag): place for place, tag in enumerate(board.tag_ids)}
    for tag, found in zip(ids.ravel(), corners, strict=True):
        # OpenCV up to 5.0 takes the lower right corner of a tag36h11 for its first; unrefined, it is 1 to 4 px off
        distance = min(np.abs(np.roll(found[0], turn, axis=0) - truth[order[int(tag)]]).max() for turn in (0, 2))
        assert distance < 5


@pytest.mark.parametrize("spec", ["circles:9x7:20mm", "acircles:4x11:10mm"])
def test_opencvs_circle_finder_sees_the_projected_discs(spec):
    board, scene, image = _render(spec, 3)
    flag = cv2.CALIB_CB_ASYMMETRIC_GRID if board.kind == "acircles" else cv2.CALIB_CB_SYMMETRIC_GRID
    is_found, found = cv2.findCirclesGrid(image.image, (board.columns, board.rows), flags=flag)
    assert is_found
    # what a finder sees is the centroid of the projected disc, not the projected centre, which is the truth
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    spacing = np.linalg.norm(board.object_points_m[1:] - board.object_points_m[0], axis=1).min()
    ring = 0.25 * spacing * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    rims = scene.rig.left.project(scene.T_left_board[0].apply((board.object_points_m[:, None] + ring).reshape(-1, 3)))
    u, v = np.moveaxis(rims.reshape(board.n_points, -1, 2), -1, 0)
    next_u, next_v = np.roll(u, -1, axis=1), np.roll(v, -1, axis=1)
    cross = u * next_v - next_u * v
    area = cross.sum(axis=1) * 3
    centroid = np.stack([((u + next_u) * cross).sum(axis=1) / area, ((v + next_v) * cross).sum(axis=1) / area], axis=-1)
    nearest = np.linalg.norm(found.reshape(-1, 1, 2) - centroid, axis=-1).argmin(axis=0)
    error = found.reshape(-1, 2)[nearest] - centroid
    assert np.abs(error.mean(axis=0)).max() < 0.02
    assert np.abs(error).max() < 0.1
    assert np.abs(centroid - image.corners_px).max() < 0.5


def test_levels_noise_gamma_and_depth():
    rig = table2_rig()
    rng = np.random.default_rng(0)
    T = SE3(np.eye(3), np.array([-0.1, -0.07, 0.5]))
    plain = {"clutter_dn": 0, "background_dn": 100, "black_dn": 20, "white_dn": 220}
    light = render_light(rig.left, T, CHESS, RenderOptions(**plain), rng)
    u, v = rig.left.project(T.apply(np.array([[-0.01, -0.01, 0], [0.01, -0.01, 0]]))).round().astype(int).T
    assert light[v, u] == pytest.approx([20, 220], abs=1e-3)  # the first square is black, its neighbour white
    assert light[2, 2] == pytest.approx(100)
    noisy = render_image(rig.left, T, CHESS, RenderOptions(**plain, noise_dn=3), rng).image
    assert noisy[:100].std() == pytest.approx(np.sqrt(9 + 1 / 12), rel=0.01)
    encoded = render_image(rig.left, T, CHESS, RenderOptions(**plain, noise_dn=0, gamma=2.2), rng).image
    assert encoded[2, 2] == round(255 * (100 / 255) ** (1 / 2.2))
    deep = render_image(rig.left, T, CHESS, RenderOptions(**plain, noise_dn=0, bit_depth=16), rng).image
    assert deep.dtype == np.uint16
    assert deep[2, 2] == 25700


def test_light_falls_along_the_board_and_toward_the_corners():
    rig = table2_rig()
    T = SE3(np.eye(3), np.array([-0.1, -0.07, 0.5]))
    plain = {"clutter_dn": 0, "noise_dn": 0, "black_dn": 0, "white_dn": 100, "background_dn": 100}
    light = render_light(rig.left, T, CHESS, RenderOptions(**plain, shading=(0.4, 0)), np.random.default_rng(0))
    u, v = rig.left.project(T.apply(np.array([[0.01, -0.01, 0], [0.19, 0.13, 0]]))).round().astype(int).T
    # both squares are white; they lie 0.18 m apart on a pattern of 0.24 m
    assert light[v[1], u[1]] - light[v[0], u[0]] == pytest.approx(100 * 0.4 * 0.18 / 0.24, abs=0.2)
    vignetted = render_light(rig.left, T, CHESS, RenderOptions(**plain, vignetting=0.3), np.random.default_rng(0))
    assert vignetted[[0, -1, 0, -1], [0, 0, -1, -1]].mean() == pytest.approx(70, abs=0.5)


def test_a_board_across_the_image_edge_looks_like_the_same_board_in_a_larger_image():
    parameters = np.array([800.0, 800, 160, 120, 0, -0.1, 0.05, 0, 0])
    small = Camera("brown4", (320, 240), parameters)
    parameters[2:4] += 100
    large = Camera("brown4", (520, 440), parameters)
    T = SE3(np.eye(3), np.array([0.03, 0.02, 0.5]))
    options = RenderOptions(blur_px=2.0, clutter_dn=0)
    for sheet in (CHESS, parse_board("circles:9x7:20mm")):
        light = [render_light(c, T, sheet, options, np.random.default_rng(0)) for c in (small, large)]
        assert np.abs(light[0] - light[1][100:340, 100:420]).max() < 0.02
    away = SE3(np.eye(3), np.array([5.0, 0.0, 0.5]))
    assert np.ptp(render_light(small, away, CHESS, options, np.random.default_rng(0))) == 0


def test_a_circular_fisheye_is_black_outside_its_circle():
    camera = Camera("fisheye4", (640, 480), np.array([130.0, 130, 320, 240, 0, 0.01, -0.02, 0.003, -0.002]))
    rig = StereoRig(camera, camera, SE3(np.eye(3), np.array([-0.1, 0, 0])))
    rng = np.random.default_rng(0)
    board = parse_board("aprilgrid:6x6:88mm:0.3")
    scene = sample_scene(rig, board, 2, rng, PoseOptions(fill=(0.2, 0.5)))
    image = render_image(camera, scene.T_left_board[1], board, RenderOptions(noise_dn=0), rng)
    assert not image.image[[0, 0, -1, -1], [0, -1, 0, -1]].any()
    assert image.image[240, 320] > 0
    assert np.isfinite(image.corners_px).all()


def test_same_seed_same_image_and_other_seed_other_clutter():
    images = [_render("chessboard:9x6:30mm", seed)[2].image for seed in (5, 5, 6)]
    assert np.array_equal(images[0], images[1])
    assert np.abs(images[0].astype(int) - images[2]).mean() > 5


@pytest.mark.usefixtures("unchecked_types")
def test_wrong_poses_and_options_are_refused():
    rig = table2_rig()
    rng = np.random.default_rng(0)
    back = SE3(np.diag([1.0, -1.0, -1.0]), np.array([0, 0, 0.5]))
    with pytest.raises(ValueError, match="back of the board"):
        render_light(rig.left, back, CHESS, RenderOptions(), rng)
    with pytest.raises(ValueError, match="one pose"):
        render_light(rig.left, SE3(np.eye(3)[None], np.zeros((1, 3))), CHESS, RenderOptions(), rng)
    for bad in ({"blur_px": -1}, {"gamma": 0}, {"bit_depth": 12}, {"blur_kind": "box"}, {"border_bits": 0}):
        with pytest.raises(ValueError):
            RenderOptions(**bad)


@pytest.mark.parametrize("model", ["brown5", "brown8", "fisheye4"])
def test_other_camera_models_render_what_a_finder_agrees_with(model):
    rng = np.random.default_rng(8)
    rig = random_rig(rng, model, size_wh=(1280, 960))
    board = parse_board("chessboard:7x5:40mm")
    scene = sample_scene(rig, board, 1, rng, PoseOptions(fill=(0.5, 0.6), tilt_deg=(5, 15), margin_px=30))
    image = render_image(rig.right, scene.T_right_board[0], board, RenderOptions(), rng)
    is_found, corners = cv2.findChessboardCorners(image.image, (7, 5))
    assert is_found
    corners = cv2.cornerSubPix(image.image, corners, (5, 5), (-1, -1), (3, 50, 1e-4)).reshape(-1, 2)
    nearest = np.linalg.norm(corners[:, None] - image.corners_px, axis=-1).argmin(axis=0)
    error = corners[nearest] - image.corners_px
    assert np.abs(error.mean(axis=0)).max() < 0.03
    assert np.abs(error).max() < 0.2


def test_what_stands_behind_the_board_is_seen_where_no_board_is():
    rig = table2_rig()
    scene = sample_scene(rig, CHESS, 1, np.random.default_rng(4), LARGE)
    wall = np.full((960, 1280), 77.0)
    light = render_light(rig.left, scene.T_left_board[0], CHESS, RenderOptions(behind=wall), np.random.default_rng(0))
    assert 0.2 < np.mean(np.abs(light - 77) < 1e-3) < 0.9
    with pytest.raises(ValueError, match=r"rows and columns, \(960, 1280\); got \(2, 2\)"):
        wrong = RenderOptions(behind=np.zeros((2, 2)))
        render_light(rig.left, scene.T_left_board[0], CHESS, wrong, np.random.default_rng(0))
