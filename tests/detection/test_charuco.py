from __future__ import annotations

import cv2
import numpy as np
import pytest

from binocal import detect
from binocal.boards import parse_board
from binocal.detection.charuco import detect_charuco, marker_squares
from binocal.detection.detect import stretch_8_bit

SPEC = "charuco:8x6:30mm:22mm:DICT_5X5_50"


@pytest.mark.parametrize("is_legacy", [False, True])
@pytest.mark.parametrize("spec", [SPEC, "charuco:7x5:30mm:22mm:DICT_4X4_50", "charuco:5x8:30mm:20mm:DICT_6X6_250"])
def test_both_layouts_are_told_by_the_image(shoot, spec, is_legacy):
    shot = shoot(spec, is_legacy_charuco=is_legacy, size_wh=(800, 600), distance=1.9)
    found, layout = detect_charuco(shot.image, stretch_8_bit(shot.image)[0], shot.board)
    assert found.is_found and found.is_seen.all(), found.reason
    assert layout == ("legacy" if is_legacy and shot.board.rows % 2 == 0 else "current")
    assert np.sqrt(np.nanmean((found.points_px - shot.corners_px) ** 2)) < 0.06  # measured 0.02 to 0.04 px per axis


def test_markers_with_two_bits_of_black_around_them(shoot):
    shot = shoot(SPEC, size_wh=(800, 600), distance=1.9, border_bits=2)
    found = detect(shot.image, shot.board)
    assert found.is_seen.all() and np.nanmax(np.abs(found.points_px - shot.corners_px)) < 0.1


def test_squares_of_ten_pixels_keep_their_corners(shoot):
    """Their markers begin 1.3 px from the edges: the fit's bands hold hardly more than the blurred edges themselves."""
    n_seen = 0
    for seed in range(3):
        shot = shoot(SPEC, distance=10.0, xi_rad=(0.2, -0.3, 0.4 * seed), seed=seed, blur_px=0.5, noise_dn=2.0)
        found = detect(shot.image, shot.board)
        n_seen += found.is_seen.sum()
        error = found.points_px - shot.corners_px
        assert np.sqrt(np.nanmean(error**2)) < 0.025 and np.nanmax(np.abs(error)) < 0.08  # measured 0.017, 0.048
    assert n_seen >= 101  # of 105; 103 are, and 87 without what the other corners tell


def test_a_partial_board_is_used_and_its_hidden_corners_are_not(shoot):
    shot = shoot(SPEC, distance=0.7, size_wh=(800, 600))
    found = detect(shot.image, shot.board)
    inside = np.isfinite(shot.corners_px[:, 0])
    assert found.is_found and 8 <= found.is_seen.sum() <= inside.sum() < shot.board.n_points
    error = (found.points_px - shot.corners_px)[found.is_seen]
    assert np.isfinite(error).all() and np.abs(error).max() < 0.2
    assert (
        np.isfinite(found.covariance_px2[found.is_seen]).all() and np.isnan(found.covariance_px2[~found.is_seen]).all()
    )


def test_exchanged_columns_and_rows_contradict_the_markers(shoot):
    found = detect(
        shoot(SPEC, size_wh=(800, 600), distance=1.9).image, parse_board("charuco:6x8:30mm:22mm:DICT_5X5_50")
    )
    assert not found.is_found and "do not lie as on a board of 6x8" in found.reason


def test_another_dictionary_is_not_found(shoot):
    assert "no marker" in detect(shoot(SPEC).image, parse_board("charuco:8x6:30mm:22mm:DICT_7X7_50")).reason


def test_an_unknown_dictionary_is_the_callers_mistake(shoot):
    with pytest.raises(ValueError, match="not an ArUco dictionary"):
        detect(shoot(SPEC).image, parse_board("charuco:8x6:30mm:22mm:DICT_NONE"))


def test_layouts_differ_where_rows_are_even_only():
    even, odd = parse_board(SPEC), parse_board("charuco:8x5:30mm:22mm:DICT_5X5_50")
    assert marker_squares(even, "legacy")[0].tolist() == [0, 0]
    assert marker_squares(even, "current")[0].tolist() == [1, 0]
    assert np.array_equal(marker_squares(odd, "legacy"), marker_squares(odd, "current"))


def paste_marker(image, dictionary, marker, centre, side_px, turn_deg=20.0):
    """The image with a marker stuck on it."""
    drawn = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(dictionary), marker, side_px)
    drawn = cv2.copyMakeBorder(drawn, 5, 5, 5, 5, cv2.BORDER_CONSTANT, value=230)
    size = (image.shape[1], image.shape[0])
    turn = cv2.getRotationMatrix2D((drawn.shape[1] / 2, drawn.shape[0] / 2), turn_deg, 1.0)
    turn[:, 2] += np.array(centre) - np.array(drawn.shape[::-1]) / 2
    covered = cv2.warpAffine(np.full(drawn.shape, 255, np.uint8), turn, size) > 128
    return np.where(covered, cv2.warpAffine(drawn, turn, size), image)


@pytest.mark.parametrize("centre", [(60, 60), (740, 540), (400, 300)])
def test_one_stray_marker_costs_no_more_than_what_it_covers(shoot, centre):
    """A marker of the board's dictionary that lies elsewhere would fold the board in a least-squares fit over all."""
    shot = shoot("charuco:14x10:30mm:22mm:DICT_5X5_100", size_wh=(800, 600), distance=0.75)
    clean = detect(shot.image, shot.board)
    for marker in (0, 69):  # neither is in view
        image = paste_marker(shot.image, cv2.aruco.DICT_5X5_100, marker, centre, 56)
        found = detect(image, shot.board)
        assert found.is_found, found.reason
        away = np.linalg.norm(clean.points_px - np.array(centre), axis=1) > 60
        assert (found.is_seen[away] >= clean.is_seen[away]).mean() > 0.93  # measured 0.95 to 1
        assert np.nanmax(np.abs(found.points_px - shot.corners_px)[away]) < 0.3


def test_markers_of_a_wrong_board_are_not_called_stray(shoot):
    shot = shoot(SPEC, size_wh=(800, 600), distance=1.9)
    assert not detect(shot.image, parse_board("charuco:7x6:30mm:22mm:DICT_5X5_50")).is_found
    assert "elsewhere" not in detect(shot.image, shot.board).note


def test_markers_that_the_saturated_paper_runs_into_give_no_corner(shoot):
    shot = shoot(
        "charuco:9x7:20mm:15mm:DICT_5X5_100", size_wh=(960, 720), white_dn=420.0, black_dn=60.0, background_dn=220.0,
        blur_px=1.5,
    )  # fmt: skip
    found = detect(shot.image, shot.board)
    if found.is_found:
        assert np.nanmax(np.abs(found.points_px - shot.corners_px)) < 0.1  # up to 2 px where they were kept


def test_two_equal_boards_are_said_to_be_two(shoot):
    """One of them was taken."""
    image = shoot(SPEC, size_wh=(640, 480), distance=1.7).image
    found = detect(np.hstack([image, image]), parse_board(SPEC))
    assert found.is_among_several and found.reason.startswith("more than one board in the image")


def test_an_inverted_print_is_found_and_a_mirror_image_named(shoot):
    shot = shoot(SPEC, size_wh=(800, 600), distance=1.9)
    found = detect(255 - shot.image, shot.board)
    assert found.is_found and found.is_seen.all(), found.reason
    assert np.abs(found.points_px - shot.corners_px).max() < 0.1  # measured 0.03
    mirrored = detect(np.ascontiguousarray(shot.image[:, ::-1]), shot.board)
    assert not mirrored.is_found and "mirrored" in mirrored.reason


def test_corners_behind_a_covered_middle_are_found(shoot):
    shot = shoot("charuco:14x10:30mm:22mm:DICT_5X5_100", size_wh=(800, 600), distance=1.3)
    image = shot.image.copy()
    image[:, 370:450] = 90
    found = detect(image, shot.board)
    hidden = np.abs(shot.corners_px[:, 0] - 409.5) < 44
    assert found.is_seen[~hidden].mean() > 0.97 and not found.is_seen[np.abs(shot.corners_px[:, 0] - 409.5) < 36].any()
    assert np.nanmax(np.abs(found.points_px - shot.corners_px)) < 0.2


@pytest.mark.parametrize(
    "spec", ["charuco:8x6:30mm:22mm:DICT_ARUCO_MIP_36h12", "charuco:8x6:30mm:22mm:DICT_APRILTAG_16h5"]
)
def test_other_dictionaries(shoot, spec):
    shot = shoot(spec, size_wh=(800, 600), distance=1.9)
    found = detect(shot.image, shot.board)
    assert found.is_seen.all() and np.abs(found.points_px - shot.corners_px).max() < 0.15


def test_markers_from_another_id_on(shoot):
    shot = shoot("charuco:8x6:30mm:22mm:DICT_5X5_100:40", size_wh=(800, 600), distance=1.9)
    found = detect(shot.image, shot.board)
    assert found.is_seen.all() and np.abs(found.points_px - shot.corners_px).max() < 0.15, found.reason
    other = detect(shot.image, parse_board(SPEC))
    assert not other.is_found


def test_few_corners_beside_many_markers_are_noted(shoot):
    """Discs on two thirds of the corners: the markers between them are whole."""
    shot = shoot(SPEC, size_wh=(800, 600), distance=1.2)
    image = shot.image.copy()
    for x, y in shot.corners_px[np.arange(len(shot.corners_px)) % 3 > 0]:
        cv2.circle(image, (round(x), round(y)), 9, 120, -1)
    found = detect(image, shot.board)
    assert found.is_found and "corners beside its markers could be measured" in found.note, (found.reason, found.note)
    seen = found.is_seen
    assert np.abs(found.points_px - shot.corners_px)[seen].max() < 0.3


def test_markers_with_two_bits_of_border():
    board = parse_board(SPEC)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_50)
    drawn = cv2.aruco.CharucoBoard((8, 6), board.pitch_m, board.marker_m, dictionary).generateImage(
        (1600, 1200), borderBits=2
    )
    corners = np.array([[90.0, 60], [700, 110], [660, 540], [60, 500]], np.float32)
    H = cv2.getPerspectiveTransform(
        np.array([[-0.5, -0.5], [1599.5, -0.5], [1599.5, 1199.5], [-0.5, 1199.5]], np.float32), corners
    )
    image = cv2.warpPerspective(
        cv2.GaussianBlur(drawn, (0, 0), 2.5), H, (800, 600), flags=cv2.INTER_AREA, borderValue=200
    )
    found = detect(image, board)
    truth = cv2.perspectiveTransform(board.object_points_m[None, :, :2] / board.pitch_m * 200 - 0.5, H)[0]
    assert found.is_found and found.is_seen.all(), found.reason
    assert np.abs(found.points_px - truth).max() < 0.1
