from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from binocal import detect
from binocal.benchmark.marker_boards import draw_marker_board
from binocal.boards import parse_board
from binocal.detection.aprilgrid import TagLayout, detect_aprilgrid
from binocal.detection.detect import stretch_8_bit

SPEC = "aprilgrid:5x4:40mm:0.3"


@pytest.mark.parametrize("border_bits", [1, 2])
def test_tags_of_both_borders(shoot, border_bits):
    shot = shoot(SPEC, size_wh=(960, 720), border_bits=border_bits)
    found = detect(shot.image, shot.board)
    assert found.is_found and found.is_seen.sum() >= 40, found.reason  # measured 68 to 80
    error = (found.points_px - shot.corners_px)[found.is_seen]
    assert np.sqrt(np.mean(error**2)) < 0.05 and np.abs(error).max() < 0.3  # measured 0.02 px


def test_ids_that_run_from_the_top_are_read_in_the_boards_order_too(shoot):
    shot = shoot(SPEC, size_wh=(960, 720))
    upside_down = np.ascontiguousarray(shot.image[::-1, ::-1])
    found, layout = detect_aprilgrid(upside_down, stretch_8_bit(upside_down)[0], shot.board)
    assert layout is not None and layout.is_bottom_up  # turning the image does not turn the print
    back = np.array([959, 719]) - found.points_px
    assert np.nanmax(np.abs(back - shot.corners_px)) < 0.3


def test_a_layout_that_is_given_is_taken(shoot):
    shot = shoot(SPEC, size_wh=(960, 720))
    _, proved = detect_aprilgrid(shot.image, stretch_8_bit(shot.image)[0], shot.board)
    assert isinstance(proved, TagLayout)
    other = replace(proved, turns=(proved.turns + 1) % 4)
    found, _ = detect_aprilgrid(shot.image, stretch_8_bit(shot.image)[0], shot.board, other)
    assert not found.is_found and "do not lie as on a 5x4 grid" in found.reason


def test_a_wrong_gap_or_size_is_refused(shoot):
    image = shoot(SPEC, size_wh=(960, 720)).image
    assert not detect(image, parse_board("aprilgrid:4x5:40mm:0.3")).is_found
    assert "gap 1" in detect(image, parse_board("aprilgrid:5x4:40mm:1.0")).reason
    reason = detect(image, parse_board("aprilgrid:5x4:40mm:0.5")).reason
    assert reason == "its tags lie about 0.30 of their side apart, the SPEC says 0.5; measure the gap"


def test_two_equal_boards_are_said_to_be_two(shoot):
    """The reason was: only 1 tag of the board found."""
    image = shoot(SPEC, size_wh=(640, 480), distance=1.7).image
    found = detect(np.hstack([image, image]), parse_board(SPEC))
    assert found.is_among_several and found.reason.startswith("more than one board in the image")


def test_other_ids_are_named(shoot):
    shot = shoot(SPEC, size_wh=(960, 720))
    found = detect(shot.image, replace(shot.board, first_tag_id=300))
    assert "the board has 300 to 319" in found.reason


def test_no_tag(shoot):
    assert "no tag" in detect(shoot("chessboard:7x6:30mm").image, parse_board(SPEC)).reason


def test_one_stray_tag_is_left_out(shoot):
    shot = shoot("aprilgrid:6x6:40mm:0.3", size_wh=(960, 720), distance=0.75)
    clean = detect(shot.image, shot.board)
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    drawn = cv2.aruco.generateImageMarker(family, 0, 70, borderBits=2)
    image = shot.image.copy()
    image[10:100, 860:950] = cv2.copyMakeBorder(drawn, 10, 10, 10, 10, cv2.BORDER_CONSTANT, value=235)
    found = detect(image, shot.board)
    assert found.is_found, found.reason
    assert found.is_seen.sum() >= 0.9 * clean.is_seen.sum()
    assert np.nanmax(np.abs(found.points_px - shot.corners_px)) < 0.5


def test_an_inverted_print_is_found_and_a_mirror_image_named(shoot):
    shot = shoot(SPEC, size_wh=(960, 720))
    found = detect(255 - shot.image, shot.board)
    assert found.is_seen.mean() > 0.97 and np.nanmax(np.abs(found.points_px - shot.corners_px)) < 0.1, found.reason
    mirrored = detect(np.ascontiguousarray(shot.image[:, ::-1]), shot.board)
    assert not mirrored.is_found and "mirrored" in mirrored.reason


def test_another_family_from_another_id_on(shoot):
    shot = shoot("aprilgrid:5x4:40mm:0.3:tag25h9:12", size_wh=(960, 720))
    found = detect(shot.image, shot.board)
    assert found.is_seen.mean() > 0.97, found.reason
    # Only tag36h11's own up is known: of others OpenCV may hold it turned, which the layout allows for.
    assert np.nanmax(np.abs(found.points_px - shot.corners_px)) < 0.2


def test_a_board_forty_times_as_large_at_one_end_is_found():
    """Between the corners of its nearest tags lie those of codes and of a dozen far tags: neighbours are looked for farther away."""
    scene = draw_marker_board("aprilgrid:6x6:40mm:0.3", "wide", 71, 3)
    found = detect(scene.image, scene.board)
    off = np.linalg.norm(found.points_px - scene.corners_px, axis=1)
    assert np.isfinite(off).sum() >= 60 and np.nanmax(off) < 0.3  # measured 73 of 119
