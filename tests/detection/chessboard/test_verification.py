"""A candidate at full resolution: what is measured, what is looked for again, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from binocal.detection.chessboard import verification
from binocal.detection.chessboard.orientation import orient
from binocal.detection.chessboard.sightings import Candidate
from binocal.detection.chessboard.verification import BoardImage, verify
from binocal.detection.detect import stretch_8_bit
from binocal.detection.finding.lattice import Lattice
from binocal.detection.finding.search import scaled_levels


@pytest.fixture
def whole(shoot):
    """A board's image, and the whole lattice that its first search shows."""

    def find(spec="chessboard:9x6:30mm", **options):
        shot = shoot(spec, **options)
        image = BoardImage(shot.image, stretch_8_bit(shot.image)[0], shot.board)
        for level in scaled_levels(image.image, image.size):
            for lattice in level.lattices:
                if lattice.size == image.size and lattice.n_seen == shot.board.n_points:
                    return image, Candidate(lattice, level), shot.corners_px
        raise AssertionError("no whole lattice")

    return find


def hide_at_first(monkeypatch, n, n_seen):
    """The first measurement sees so many corners, spread over the board; the next hides none."""
    hidden = np.zeros(n, bool)
    hidden[np.random.default_rng(2).permutation(n)[n_seen:]] = True
    looks = iter([hidden, np.zeros(n, bool)])
    monkeypatch.setattr(verification, "are_faint", lambda level, points, grid: next(looks))


@pytest.mark.parametrize(("n_seen", "is_found"), [(54, True), (40, True), (22, True), (21, False)])
def test_lost_corners_are_looked_for_where_the_others_put_them(whole, monkeypatch, n_seen, is_found):
    image, candidate, truth = whole()
    hide_at_first(monkeypatch, 54, n_seen)
    found = verify(image, candidate)  # 22 of 54 are 0.41
    assert found.is_found is is_found
    if is_found:
        assert found.is_seen.all() and np.abs(found.points_px - truth).max() < 0.2
    else:
        assert "do not lie on a smooth grid (21 of 54 do)" in found.reason


@pytest.mark.parametrize(("n_seen", "is_found"), [(12, True), (11, False)])
def test_a_dozen_corners_are_needed_to_look_again(whole, monkeypatch, n_seen, is_found):
    image, candidate, _ = whole("chessboard:5x5:30mm")
    hide_at_first(monkeypatch, 25, n_seen)
    assert verify(image, candidate).is_found is is_found


@pytest.mark.parametrize(("shift", "is_found"), [(0.25, True), (0.35, False)])
def test_corners_that_move_far_from_where_they_were_sought_are_not_them(whole, monkeypatch, shift, is_found):
    image, candidate, _ = whole(xi_rad=(0.0, 0.0, 0.0))
    grid = candidate.level.to_image(candidate.lattice.points_px)
    step_px = np.linalg.norm(grid[0, 1] - grid[0, 0])

    def measure(grey, points_px, board_xy, reach_px):  # as a whole, the grid stays as regular as it was
        unit = np.broadcast_to(np.eye(2), (54, 2, 2))
        return points_px + [shift * step_px, 0.0], unit, 0 * unit

    monkeypatch.setattr(verification, "measure_corners", measure)
    monkeypatch.setattr(verification, "are_faint", lambda level, points, grid: np.zeros(54, bool))
    assert verify(image, candidate).is_found is is_found


def test_a_corner_off_the_smooth_grid_is_not_seen(whole, monkeypatch):
    image, candidate, truth = whole()
    honest, shifts = verification.measure_corners, iter([0.15 * np.linalg.norm(truth[1] - truth[0]), 0.0])

    def measure(grey, points_px, board_xy, reach_px):
        points, covariance, cross = honest(grey, points_px, board_xy, reach_px)
        points = points.copy()
        points[20] += next(shifts)
        return points, covariance, cross

    monkeypatch.setattr(verification, "are_faint", lambda level, points, grid: np.zeros(54, bool))

    monkeypatch.setattr(verification, "measure_corners", measure)
    found = verify(image, candidate)
    assert found.is_found and np.abs(found.points_px - truth).max() < 0.2  # looked for again, and measured at its place


@pytest.mark.parametrize(("n_faint", "is_found"), [(13, True), (14, False)])
def test_three_quarters_of_the_corners_must_be_seen(whole, monkeypatch, n_faint, is_found):
    image, candidate, _ = whole()
    monkeypatch.setattr(verification, "are_faint", lambda level, points, grid: np.arange(54) < n_faint)
    found = verify(image, candidate)
    assert found.is_found is is_found and found.is_seen.sum() == (54 - n_faint if is_found else 0)
    assert f"{54 - n_faint} of " in (found.note if is_found else found.reason)


def test_a_row_beyond_the_lattice_and_a_second_board_are_contradictions(whole):
    image, candidate, _ = whole()
    part = replace(candidate, lattice=replace(candidate.lattice, points_px=candidate.lattice.points_px[:, :-1]))
    shorter = replace(image, board=replace(image.board, columns=part.lattice.size[0], rows=part.lattice.size[1]))
    assert "continues beyond" in verify(shorter, part).reason
    second = Lattice(candidate.lattice.points_px + [2000.0, 0.0], True, 100.0)
    level = replace(candidate.level, lattices=[candidate.lattice, second])
    assert "more than one board" in verify(image, replace(candidate, level=level)).reason


def test_a_lattice_is_turned_to_the_boards_order(whole):
    image, candidate, truth = whole()
    for turns in range(4):
        grid = np.rot90(candidate.lattice.points_px, turns)
        is_dark_first = candidate.lattice.is_dark_first
        for k in range(turns):  # the next first corner is the present row's last
            is_dark_first ^= bool(np.rot90(candidate.lattice.points_px, k).shape[1] % 2)
        oriented = candidate.level.to_image(
            orient(replace(candidate.lattice, points_px=grid, is_dark_first=is_dark_first), image.board)
        )
        assert np.abs(oriented.reshape(-1, 2) - truth).max() < 2.0


def test_a_lattice_none_of_whose_rows_shows_both_ends_is_turned_too(whole):
    image, candidate, truth = whole()
    grid = candidate.lattice.points_px.copy()
    end = slice(None, 3), slice(3, None)
    for rows, column in zip(end, (0, -1), strict=True):
        (grid if grid.shape[1] == 9 else grid.swapaxes(0, 1))[rows, column] = np.nan
    oriented = orient(replace(candidate.lattice, points_px=grid), image.board).reshape(-1, 2)
    seen = np.isfinite(oriented[:, 0])
    assert seen.sum() == 48 and np.abs((candidate.level.to_image(oriented) - truth)[seen]).max() < 2.0
