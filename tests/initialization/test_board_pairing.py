"""Boards that look alike are paired by geometry, on corners with noise; what cannot be known is not paired."""

from __future__ import annotations

import numpy as np
import pytest

from binocal.boards import BoardSet
from binocal.cameras import Camera, StereoRig
from binocal.geometry import SE3, so3
from binocal.initialization.board_pairing import SeenBoards, pair_boards
from binocal.simulation import draw_room

BOARDS = BoardSet.from_specs(["chessboard:7x5:90mm", "chessboard:11x7:60mm"])
POINTS = BOARDS.object_points_m


def room_rig(baseline_m=0.3):
    left = Camera("brown4", (1392, 1024), np.array([984.0, 983, 690, 505, 0, -0.32, 0.11, 6e-4, -3e-4]))
    right = Camera("brown4", (1392, 1024), np.array([979.0, 980, 702, 512, 0, -0.31, 0.10, -4e-4, 2e-4]))
    return StereoRig(left, right, SE3(so3.exp(np.radians([0.5, 1.2, -0.4])), np.array([-baseline_m, 0.004, -0.01])))


def seen(room, side, rng, *, shot=0, noise_px=0.1, turned=()):
    """What a camera sees of a room, in an order of its own, and that order; ``turned`` boards are numbered from the other end."""
    camera = room.rig.left if side == "left" else room.rig.right
    rows = []
    for k, (board, T) in enumerate(room.seen_by(side)):
        px = np.full((len(POINTS), 2), np.nan)
        corners = camera.project(T.apply(board.object_points_m)) + noise_px * rng.standard_normal((board.n_points, 2))
        px[BOARDS.places[room.kind[k]]] = corners[::-1] if k in turned else corners
        rows.append(px)
    order = rng.permutation(len(rows))
    kinds = np.array(room.kind)[order]
    return SeenBoards(np.full(len(rows), shot), kinds, np.array(rows)[order], camera.size_wh), order


def joined(parts):
    return SeenBoards(
        *(np.concatenate([getattr(part, name) for part in parts]) for name in ("shot", "kind", "px")), parts[0].size_wh
    )


@pytest.mark.parametrize("seed", [0])
def test_every_board_of_a_room_finds_itself_in_one_shot(seed):
    rng = np.random.default_rng(seed)
    room = draw_room(room_rig(), BOARDS, rng)
    left, of_left = seen(room, "left", rng)
    right, of_right = seen(room, "right", rng, turned=(1, 4))
    pairs = pair_boards(POINTS, BOARDS.places, left, right)
    assert not pairs.problem
    np.testing.assert_array_equal(of_left[pairs.left], of_right[pairs.right])
    assert len(pairs.left) == len(room.kind)
    for i, j, order in zip(pairs.left, pairs.right, pairs.order, strict=True):
        place = BOARDS.places[int(left.kind[i])]
        is_turned = of_right[j] in (1, 4)
        np.testing.assert_array_equal(
            order[place] - place.start, np.arange(place.stop - place.start)[:: -1 if is_turned else 1]
        )


def test_boards_that_one_camera_sees_are_not_paired_with_others():
    rng = np.random.default_rng(5)
    room = draw_room(room_rig(), BOARDS, rng)
    left, of_left = seen(room, "left", rng)
    right, of_right = seen(room, "right", rng)
    kept = of_right >= 3  # three boards are hidden from the right camera, and the left one sees none of two others
    few = SeenBoards(right.shot[kept], right.kind[kept], right.px[kept], right.size_wh)
    shown = of_left < len(of_left) - 2
    left = SeenBoards(left.shot[shown], left.kind[shown], left.px[shown], left.size_wh)
    pairs = pair_boards(POINTS, BOARDS.places, left, few)
    assert sorted(of_left[shown][pairs.left]) == list(range(3, len(of_left) - 2))
    np.testing.assert_array_equal(of_left[shown][pairs.left], of_right[kept][pairs.right])


def test_a_rig_that_is_known_pairs_two_boards():
    rng = np.random.default_rng(6)
    room = draw_room(room_rig(), BOARDS, rng, columns=2, rows=1)
    left, of_left = seen(room, "left", rng)
    right, of_right = seen(room, "right", rng)
    pairs = pair_boards(POINTS, BOARDS.places, left, right, rig=room.rig)
    assert len(pairs.left) == 2
    np.testing.assert_array_equal(of_left[pairs.left], of_right[pairs.right])


def evenly_hung(n=5, step_m=0.9):
    """Boards that are alike, side by side on one wall, a step apart, tilted alike."""
    rig = room_rig()
    R = so3.exp(np.array([0.2, 0.5, 0.05]))
    one = BoardSet.from_specs("chessboard:7x5:90mm")
    along = R @ np.array([step_m, 0, 0])
    T = SE3(np.tile(R, (n, 1, 1)), np.array([-0.3, -0.2, 4.0]) + along * (np.arange(n) - n // 2)[:, None])
    return rig, one, T


def test_an_even_row_of_boards_is_not_paired():
    rig, one, T = evenly_hung()
    points = one.object_points_m
    rng = np.random.default_rng(0)
    sides = []
    for camera, poses in ((rig.left, T), (rig.right, rig.T_right_left @ T)):
        px = camera.project(poses.apply(points)) + 0.05 * rng.standard_normal((5, len(points), 2))
        sides.append(SeenBoards(np.zeros(5, int), np.zeros(5, int), px, camera.size_wh))
    pairs = pair_boards(points, one.places, *sides)
    assert pairs.problem and not len(pairs.left)


def test_boards_alone_of_their_kind_need_no_proof_and_too_few_alike_ones_are_said():
    rng = np.random.default_rng(7)
    room = draw_room(room_rig(), BOARDS, rng)
    first, second = room.kind.index(0), room.kind.index(1)
    left, of_left = seen(room, "left", rng)
    right, of_right = seen(room, "right", rng)
    chosen = [np.flatnonzero(np.isin(order, (first, second))) for order in (of_left, of_right)]
    two = [SeenBoards(s.shot[c], s.kind[c], s.px[c], s.size_wh) for s, c in zip((left, right), chosen, strict=True)]
    pairs = pair_boards(POINTS, BOARDS.places, *two)
    np.testing.assert_array_equal(of_left[chosen[0]][pairs.left], of_right[chosen[1]][pairs.right])
    assert len(pairs.left) == 2
    alike = [k for k, kind in enumerate(room.kind) if kind == 0][:2]
    chosen = [np.flatnonzero(np.isin(order, alike)) for order in (of_left, of_right)]
    two = [SeenBoards(s.shot[c], s.kind[c], s.px[c], s.size_wh) for s, c in zip((left, right), chosen, strict=True)]
    assert "too few boards" in pair_boards(POINTS, BOARDS.places, *two).problem


def test_two_alike_boards_carried_about_together_are_told_apart_by_several_shots():
    rng = np.random.default_rng(8)
    lefts, rights, truth = [], [], ([], [])
    for shot in range(5):
        room = draw_room(room_rig(), BOARDS, rng, columns=2, rows=1)
        for parts, orders, side in ((lefts, truth[0], "left"), (rights, truth[1], "right")):
            one, order = seen(room, side, rng, shot=shot)
            parts.append(one)
            orders.extend(10 * shot + order)
    pairs = pair_boards(POINTS, BOARDS.places, joined(lefts), joined(rights))
    assert len(pairs.left) == len(truth[0])
    np.testing.assert_array_equal(np.array(truth[0])[pairs.left], np.array(truth[1])[pairs.right])
