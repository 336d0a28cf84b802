"""What a marker board's lattice bears beyond the SPEC's board, and which of its rows it lacks."""

from __future__ import annotations

import pytest

from binocal import detect
from binocal.boards import format_board, parse_board

CHARUCO = "charuco:7x5:30mm:22mm:DICT_5X5_50"  # of odd columns: ids run on in pairs of rows
EVEN = "charuco:6x5:30mm:22mm:DICT_5X5_50"
APRIL = "aprilgrid:4x3:40mm:0.3:5"


@pytest.fixture(scope="module")
def images(shoot):
    return {spec: shoot(spec, distance=2.2, size_wh=(800, 600)).image for spec in (CHARUCO, EVEN, APRIL)}


@pytest.mark.parametrize(
    ("shown", "given"),
    [
        (CHARUCO, f"{CHARUCO}:7"),
        (CHARUCO, "charuco:7x4:30mm:22mm:DICT_5X5_50"),
        (EVEN, f"{EVEN}:1"),
        (APRIL, "aprilgrid:4x3:40mm:0.3:2"),
        (APRIL, "aprilgrid:4x3:40mm:0.3:7"),
        (APRIL, "aprilgrid:4x2:40mm:0.3:5"),
    ],
)
def test_ids_beside_the_board_prove_the_spec(images, shown, given):
    found = detect(images[shown], parse_board(given))
    assert not found.is_found and "continues beyond the SPEC's" in found.reason
    assert found.spec_seen == format_board(parse_board(shown))


@pytest.mark.parametrize("shown", [CHARUCO, EVEN, APRIL])
def test_the_right_spec_has_nothing_to_say(images, shown):
    found = detect(images[shown], parse_board(shown))
    assert found.is_found and not found.note and not found.spec_seen


@pytest.mark.parametrize(
    ("shown", "given", "right"),
    [
        (CHARUCO, "charuco:7x7:30mm:22mm:DICT_5X5_50", "7x5"),
        (APRIL, "aprilgrid:4x4:40mm:0.3:5", "4x3"),
    ],
)
def test_rows_that_the_print_lacks_are_noted(images, shown, given, right):
    found = detect(images[shown], parse_board(given))
    assert found.is_found and f"is the board one of {right}?" in found.note
    cut = images[shown].copy()
    cut[:300] = 128  # where half of the board is covered, nothing is known of its rows
    assert "is the board one of" not in detect(cut, parse_board(shown)).note
