"""Parts of a marked chessboard without its marks are named by what the other camera sees, where that determines it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from binocal.app.corners import find_corners
from binocal.app.parts_of_boards import expected_corners
from binocal.boards import parse_board
from binocal.cameras import Camera, StereoRig
from binocal.geometry import SE3, so3
from binocal.simulation import RenderOptions, render_image

BOARD = parse_board("chessboard:12x9:30mm:marked")
RIG = StereoRig(
    Camera("brown4", (640, 480), np.array([560.0, 561, 322, 238, 0, -0.1, 0.02, 0, 0])),
    Camera("brown4", (640, 480), np.array([556.0, 557, 316, 243, 0, -0.1, 0.02, 0, 0])),
    SE3(so3.exp(np.radians([0.3, 1.0, -0.4])), np.array([-0.1, 0.001, 0.002])),
)
WHOLE = [
    ((0.4, -0.3, 0.1), (0.06, 0.02, 0.56)),
    ((-0.4, 0.3, -0.2), (0.02, -0.03, 0.58)),
    ((0.1, 0.5, 0), (0.05, 0, 0.6)),
]
NEAR = ((0.1, 0.2, 0.1), (-0.13, 0.0, 0.32))  # whose marks are beyond the right image


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder, rng = tmp_path_factory.mktemp("parts"), np.random.default_rng(0)
    for i, (turn, middle) in enumerate([*WHOLE, NEAR]):
        R = so3.exp(np.array(turn))
        T = SE3(R, np.array(middle) - R @ BOARD.object_points_m.mean(axis=0))
        for side, camera, pose in (("left", RIG.left, T), ("right", RIG.right, RIG.T_right_left @ T)):
            rendered = render_image(camera, pose, BOARD, RenderOptions(noise_dn=2.0), rng)
            cv2.imwrite(str(folder / f"{side}{i}.png"), rendered.image)
            np.save(folder / f"{side}{i}.npy", rendered.corners_px)
    return folder


@pytest.mark.parametrize("rig", [None, RIG])
def test_a_part_is_named_by_the_other_camera_and_the_rig(folder, rig):
    found = find_corners(str(folder / "left*.png"), str(folder / "right*.png"), BOARD, None, None, None, rig=rig)
    (note,) = (note for note in found.notes if "named by" in note)
    assert note.startswith("view 3: right: ") and note.endswith(
        "of 108 corners seen; named by the left camera's corners"
    )
    px = found.detections.right_px[3]
    off = np.linalg.norm(px - np.load(folder / "right3.npy"), axis=1)
    seen = np.isfinite(px[:, 0])
    assert seen.sum() >= 30 and off[seen].max() < 1.0


def test_where_a_corner_must_lie_is_said_only_if_that_is_known(folder):
    found = find_corners(str(folder / "left*.png"), str(folder / "right*.png"), BOARD, None, None, None, rig=RIG)
    views = found.detections
    (expected,) = expected_corners(views, [(3, "right")], rig=RIG)
    truth = np.load(folder / "right3.npy")
    assert np.nanmax(np.linalg.norm(expected - truth, axis=1)) < 0.5
    few = np.full(views.left_px.shape, np.nan)
    few[3, :9] = views.left_px[3, :9] + 3 * np.random.default_rng(0).normal(size=(9, 2))  # one row, badly measured
    from dataclasses import replace

    poor = replace(views, left_px=few, right_px=np.full_like(few, np.nan))
    (expected,) = expected_corners(poor, [(3, "right")], rig=RIG)
    assert expected is None or not np.isfinite(expected[60:]).any()
