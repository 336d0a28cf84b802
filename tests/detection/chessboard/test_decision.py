"""What to do next, and why a board is refused: tables over what was seen, with no image."""

from __future__ import annotations

import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.detection.chessboard.decision import Decision, decide, refused_board
from binocal.detection.chessboard.sightings import Candidate, Sightings
from binocal.detection.finding.lattice import Lattice
from binocal.detection.finding.search import SearchLevel
from binocal.detection.finding.xcorners import SaddleImage, XCorners
from binocal.detection.found import not_found

BOARD = parse_board("chessboard:9x6:30mm")  # 54 corners


def lattice(columns=9, rows=6, n_missing=0, at=(0.0, 0.0), pitch=20.0):
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1) * pitch + at
    grid.reshape(-1, 2)[len(grid.reshape(-1, 2)) - n_missing :] = np.nan
    return Lattice(grid, True, 100.0)


def level(*lattices, n_linked=0):
    nothing = XCorners(np.zeros((0, 2)), np.zeros((0, 4)), np.zeros(0))
    flat = np.zeros((480, 640), np.float32)
    return SearchLevel(SaddleImage(flat, flat, 3.0), nothing, np.eye(2, 3), list(lattices), np.zeros((n_linked, 2)))


def sightings(*levels, **changes):
    seen = Sightings((9, 6), 54, **changes)
    for each in levels:
        seen = seen.with_level(each)
    return seen


def ended(*levels, **changes):
    return sightings(*levels, **changes).without_more_levels()


BEYOND = lattice(10, 7)
TWO = level(lattice(5, 4), lattice(5, 4, at=(500.0, 0.0)))
REFUSED = not_found(54, "no")


@pytest.mark.parametrize(
    ("seen", "step"),
    [
        # search goes on
        (sightings(), Decision.SEARCH),
        (sightings(level()), Decision.SEARCH),
        (sightings(level(lattice(7, 5))), Decision.SEARCH),
        (sightings(TWO), Decision.SEARCH),
        (sightings(level(), refused=REFUSED), Decision.SEARCH),
        # a whole board is measured at once, a nearly whole one after one more search, or where there is none
        (sightings(level(lattice())), Decision.MEASURE),
        (sightings(level(lattice(n_missing=2))), Decision.MEASURE),  # 52 of 54: 96 %
        (sightings(level(lattice(n_missing=3))), Decision.SEARCH),  # 51 of 54: 94 %
        (sightings(level(lattice(n_missing=3)), level()), Decision.MEASURE),
        (sightings(level(lattice(n_missing=3)), level(lattice(n_missing=2))), Decision.MEASURE),
        (ended(level(lattice(n_missing=13))), Decision.MEASURE),  # 41 of 54: 76 %
        (ended(level(lattice(n_missing=14))), Decision.REFUSE),  # 40 of 54: 74 %
        # two searches running that show the same larger board end it
        (sightings(level(BEYOND)), Decision.SEARCH),
        (sightings(level(BEYOND), level(BEYOND), part=None), Decision.GROW),
        (sightings(level(BEYOND), level(), level(BEYOND)), Decision.SEARCH),
        (sightings(level(BEYOND), level(lattice(11, 7))), Decision.SEARCH),
        # stretched images follow where corners were linked and nothing is settled
        (ended(level(n_linked=8)), Decision.STRETCH),
        (ended(level(n_linked=7)), Decision.REFUSE),
        (ended(level(n_linked=8), level(n_linked=2)), Decision.STRETCH),
        (ended(level(n_linked=8), refused=REFUSED), Decision.REFUSE),
        (ended(level(n_linked=8), TWO), Decision.REFUSE),
        (ended(level(lattice(n_missing=3), n_linked=51)), Decision.STRETCH),
        (sightings(level(), is_stretched=True), Decision.SEARCH),
        (sightings(level(), is_stretched=True, refused=REFUSED), Decision.REFUSE),
        (sightings(TWO, is_stretched=True), Decision.REFUSE),
        (ended(level(n_linked=99), is_stretched=True), Decision.REFUSE),
        # a part is grown where nothing else is left, and nothing settled
        (ended(level(lattice(7, 5))), Decision.GROW),
        (ended(level(lattice(7, 2))), Decision.REFUSE),
        (ended(level(lattice(7, 5)), refused=REFUSED), Decision.REFUSE),
        (ended(level(lattice(7, 5)), TWO), Decision.REFUSE),
    ],
)
def test_the_next_step(seen, step):
    assert decide(seen) is step


@pytest.mark.parametrize(
    ("seen", "reason", "size_seen"),
    [
        (ended(level()), "no chessboard found", None),
        (ended(level(lattice(n_missing=30))), "only 24 of the 54 corners were seen", None),
        (ended(level(lattice(7, 5))), "only 7x5 corners of the board's 9x6 were seen", (7, 5)),
        (ended(level(lattice(n_missing=19)), level(lattice(7, 5))), "only 35 of the 54 corners were seen", None),
        (ended(level(lattice(n_missing=20)), level(lattice(7, 5))), "only 7x5 corners of the board's", (7, 5)),
        (ended(level(lattice(10, 6))), "beyond 9x6 corners; the SPEC is probably chessboard:10x6", (10, 6)),
        (ended(level(lattice(7, 7))), "beyond 9x6 corners; the SPEC is probably chessboard:7x7", (7, 7)),
        (ended(TWO, level(lattice(7, 5))), "more than one board in the image (2: 5x4, 5x4); show one", None),
        (ended(TWO, refused=REFUSED), "no", None),
    ],
)
def test_the_reason_of_a_refusal(seen, reason, size_seen):
    found = refused_board(seen, BOARD)
    assert reason in found.reason and found.size_seen == size_seen and np.isnan(found.points_px).all()


def test_the_first_refusal_and_the_first_boards_count():
    seen = sightings(TWO, level(lattice(4, 3), lattice(4, 3, at=(500.0, 0.0)))).with_refused(REFUSED)
    assert [each.size for each in seen.several] == [(5, 4), (5, 4)]
    assert seen.with_refused(not_found(54, "later")).refused is REFUSED


def test_the_fullest_candidate_comes_first_and_the_fullest_part_is_kept():
    seen = sightings(level(lattice(n_missing=9)), level(lattice(n_missing=4)))
    assert [each.lattice.n_seen for each in seen.by_corners_seen()] == [50, 45]
    seen = sightings(level(lattice(7, 4)), level(lattice(7, 5)), level(lattice(6, 4)))
    assert isinstance(seen.part, Candidate) and seen.part.lattice.size == seen.other.size == (7, 5)


def test_what_was_seen_is_not_altered():
    before = sightings(level(lattice(n_missing=3)))
    after = before.with_level(level(lattice()))
    assert len(before.pending) == 1 and not before.is_second_look and len(after.pending) == 2 and after.is_second_look
