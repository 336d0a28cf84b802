"""Several boards, each bent in its own way: each has a shape of its own where it is known from pair to pair."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from binocal import Detections, calibrate
from binocal.boards import BoardSet
from binocal.cameras import Camera, StereoRig
from binocal.evidence.several_boards import boards_from_shot_to_shot
from binocal.geometry import SE3, so3
from binocal.solvers.shape_model import ShapeModel

BOARDS = BoardSet.from_specs(["chessboard:6x5:40mm", "chessboard:7x4:40mm", "chessboard:5x4:60mm"])
BOWS_M = (0.003, -0.002, 0.0)
SHOTS = 6
SIZE_WH = (1280, 960)


@pytest.fixture(scope="module")
def scene():
    """A rig, the boards' points as they are, and a view of each board in each pair of images."""
    rng = np.random.default_rng(1)
    left = Camera("brown4", SIZE_WH, np.array([1210.0, 1208, 634, 485, 0, -0.1, 0.02, 0, 0]))
    right = Camera("brown4", SIZE_WH, np.array([1195.0, 1197, 645, 474, 0, -0.1, 0.02, 0, 0]))
    rig = StereoRig(left, right, SE3(so3.exp(np.radians([0.4, -1.1, 0.3])), np.array([-0.12, 0.001, 0.002])))
    drawn = BOARDS.object_points_m
    points = drawn.copy()
    for bow, place in zip(BOWS_M, BOARDS.places, strict=True):
        distance2 = np.sum((drawn[place] - drawn[place].mean(axis=0)) ** 2, axis=1)
        points[place, 2] += bow * distance2 / distance2.max()
    px = np.full((2, SHOTS * 3, len(points), 2), np.nan)
    for view in range(SHOTS * 3):
        place = BOARDS.places[view % 3]
        seen = np.full((2, len(points[place]), 2), np.nan)
        while not ((seen > 5) & (seen < np.array(SIZE_WH) - 6)).all():
            R = so3.exp(rng.normal(0, 1, 3) * [0.45, 0.45, 0.3])
            middle = np.array([rng.uniform(-0.25, 0.25), rng.uniform(-0.2, 0.2), rng.uniform(0.6, 0.9)])
            T = SE3(R, middle - R @ drawn[place].mean(axis=0))
            seen = np.array(
                [
                    rig.left.project(T.apply(points[place])),
                    rig.right.project((rig.T_right_left @ T).apply(points[place])),
                ]
            )
        px[:, view, place] = seen + rng.normal(0, 0.05, seen.shape)
    shots = tuple(view // 3 for view in range(SHOTS * 3))
    names = tuple(f"{shot} board {view % 3 + 1}" for view, shot in enumerate(shots))
    return rig, points, Detections(drawn, *px, SIZE_WH, SIZE_WH, names, board_spec=BOARDS.spec, shots=shots)


def test_every_board_has_its_own_bow_and_the_rig_none_of_it(scene):
    rig, points, views = scene
    found = calibrate(views, calibrator="lm", model="brown4")
    assert found.rms.all_px < 0.08  # 0.07 px, and 0.5 with the boards held flat
    for bow, place in zip(BOWS_M, BOARDS.places, strict=True):
        height = found.board_shape.points_m[place, 2]
        assert np.std(height - points[place, 2]) < 5e-5  # 1.0e-5 to 1.6e-5
        assert abs(np.ptp(height) - abs(bow)) < 2e-4
    assert found.board_shape.bow_m == pytest.approx(0.003, abs=1e-4)  # of the board that bows most
    for name, error in (
        ("left.fx", found.rig.left.K[0, 0] - rig.left.K[0, 0]),
        ("translation.x", found.rig.T_right_left.t[0] - rig.T_right_left.t[0]),
    ):
        assert abs(error) < 4 * found.covariance.sigma[name]


def test_boards_of_which_nobody_knows_which_is_which_are_as_drawn(scene):
    _, _, views = scene
    once, twice = views.select(np.arange(3 * 5)), replace(views, shots=tuple(shot // 2 for shot in views.shots))
    assert (np.bincount(boards_from_shot_to_shot(once)) == [30, 28, 20]).all()
    assert (boards_from_shot_to_shot(twice) == -1).all()  # each board twice in a pair
    assert (boards_from_shot_to_shot(views.select(np.arange(9))) == -1).all()  # three views of each
    assert calibrate(twice, calibrator="lm", model="brown4").board_shape is None


def test_what_a_board_may_be_is_no_other_boards_matter_nor_that_of_one_as_drawn():
    points = np.ascontiguousarray(BOARDS.object_points_m.T)
    labels = np.repeat([0, 1, -1], [30, 28, 20])
    model, alone = ShapeModel.of_points(points, labels), ShapeModel.of_points(points[:, :30])
    assert model.hidden.shape == (3 * 78, 7 + 7 + 3 * 20) and model.modes.shape[1] == 2 * alone.modes.shape[1]
    variances = np.array([1e-8, 2e-8, 3e-6, 4e-6, 1e-6])
    allowed = np.linalg.inv(model.information(variances)).reshape(3, 78, 3, 78)
    of_first = np.linalg.inv(alone.information(variances)).reshape(3, 30, 3, 30)
    assert np.allclose(allowed[:, :30, :, :30], of_first, rtol=1e-6, atol=1e-15)
    assert np.abs(allowed[:, :30, :, 30:]).max() < 1e-15
    assert np.abs(allowed[:, 58:, :, 58:]).max() < 1e-12  # 1e-5 pitches are 4e-7 m
