"""PuzzleBoards, partly visible or not, in rendered images."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from binocal import detect
from binocal.boards import parse_board

SPEC = "puzzleboard:11x8:30mm:start=50,101"


def off_px(shot, found):
    """How far each corner found is from the truth; those found must be seen."""
    off = np.linalg.norm(found.points_px - shot.corners_px, axis=1)[found.is_seen]
    assert np.isfinite(off).all()
    return off


@pytest.mark.parametrize("turn", [0.1, 1.7, 3.2, 4.8])
def test_a_whole_board_is_named_whichever_way_up(shoot, turn):
    shot = shoot(SPEC, xi_rad=(0.2, -0.2, turn), distance=1.7)
    found = detect(shot.image, shot.board)
    assert found.is_seen.all() and not found.note, found.reason
    assert off_px(shot, found).max() < 0.15


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.1, 0.1), (-0.2, 0.05)])
def test_any_part_is_named(shoot, shift):
    shot = shoot(SPEC, xi_rad=(0.3, -0.2, 0.4), distance=0.6, shift=shift)
    found = detect(shot.image, shot.board)
    n_inside = int(np.isfinite(shot.corners_px[:, 0]).sum())
    assert found.is_found, found.reason
    assert 0.8 * n_inside <= found.is_seen.sum() <= n_inside < 70 and f"{found.is_seen.sum()} of" in found.note
    assert off_px(shot, found).max() < 0.2


def test_two_parts_on_both_sides_of_a_hand_are_named(shoot):
    shot = shoot(SPEC, distance=1.4, xi_rad=(0.0, 0.1, 0.1))
    image = shot.image.copy()
    middle = int(np.nanmean(shot.corners_px[:, 0]))
    image[:, middle - 45 : middle + 45] = 120
    found = detect(image, shot.board)
    seen = found.points_px[found.is_seen, 0]
    assert found.is_found and (seen < middle).sum() >= 24 and (seen > middle).sum() >= 24
    assert off_px(shot, found).max() < 0.3


def test_white_print_on_black_is_found(shoot):
    shot = shoot(SPEC, distance=1.7, black_dn=210.0, white_dn=30.0)
    found = detect(shot.image, shot.board)
    assert found.is_seen.all() and off_px(shot, found).max() < 0.2


def test_what_is_not_the_board_has_no_names(shoot):
    shot = shoot(SPEC, distance=1.7)
    assert "is the board mirrored" in detect(np.ascontiguousarray(shot.image[:, ::-1]), shot.board).reason
    elsewhere = detect(shot.image, parse_board("puzzleboard:11x8:30mm")).reason
    assert "another part of the pattern, columns 50 to 60 and rows 101 to 108" in elsewhere
    plain = detect(shoot("chessboard:11x8:30mm", distance=1.7).image, shot.board)
    assert not plain.is_found and "shows no dots" in plain.reason
    markers = detect(shoot("charuco:12x9:30mm:22mm:DICT_5X5_100", distance=1.7).image, shot.board)
    assert not markers.is_found and "shows no dots" in markers.reason
    empty = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 255, (480, 640)).astype(np.uint8), (0, 0), 2.0)
    assert not detect(empty, shot.board).is_found
