import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.cameras import CAMERA_MODELS
from binocal.errors import SceneError
from binocal.geometry import SE3
from binocal.simulation import (
    PoseOptions,
    StereoScene,
    fronto_parallel,
    printed_extent_m,
    random_rig,
    same_pose,
    sample_board_poses,
    sample_scene,
    table2_rig,
    visible_px,
)

BOARD = parse_board("chessboard:11x8:20mm")


def _tilt_deg(T_left_board):
    return np.degrees(np.arccos(np.clip(T_left_board.R[:, 2, 2], -1, 1)))


@pytest.mark.parametrize("model", CAMERA_MODELS)
def test_whole_pattern_is_in_both_images_for_every_camera_model(model):
    for seed in range(6):
        rng = np.random.default_rng(seed)
        scene = sample_scene(random_rig(rng, model), BOARD, 12, rng)
        left, right = scene.project()
        assert left.shape == (12, 88, 2)
        assert np.isfinite(left).all()
        assert np.isfinite(right).all()
        x0, y0, x1, y1 = printed_extent_m(BOARD)
        corners = np.array([[x0, y0, 0], [x1, y0, 0], [x1, y1, 0], [x0, y1, 0]])
        assert np.isfinite(visible_px(scene.rig.left, scene.T_left_board.apply(corners))).all()
        assert np.isfinite(visible_px(scene.rig.right, scene.T_right_board.apply(corners))).all()
        assert (scene.T_left_board.R[:, 2, 2] > 0).all()  # seen from the front


def test_tilts_and_their_directions_are_spread_and_the_image_is_covered():
    scene = sample_scene(table2_rig(), BOARD, 40, np.random.default_rng(1))
    tilt = _tilt_deg(scene.T_left_board)
    assert tilt.min() >= 10 - 1e-9
    assert tilt.max() <= 45 + 1e-9
    assert np.histogram(tilt, bins=[10, 20, 30, 45])[0].min() >= 6
    normal = scene.T_left_board.R[:, :, 2]
    quadrant = (normal[:, 0] > 0) * 2 + (normal[:, 1] > 0)
    assert np.bincount(quadrant, minlength=4).min() >= 5
    for px in scene.project():
        cells = {(int(u // 160), int(v // 160)) for u, v in px.reshape(-1, 2)}
        assert len(cells) / 48 > 0.8  # measured 0.92 / 0.92


def test_board_fills_the_share_asked_for():
    options = PoseOptions(fill=(0.3, 0.35), tilt_deg=(0, 0), roll_deg=0)
    scene = sample_scene(table2_rig(), BOARD, 10, np.random.default_rng(0), options)
    left, _ = scene.project()
    printed = (left[..., 0].max(axis=1) - left[..., 0].min(axis=1)) * 12 / 10 / 1280
    assert printed.min() > 0.27
    assert printed.max() < 0.37


def test_partial_boards_reach_the_edge_and_keep_the_share():
    options = PoseOptions(min_visible_share=0.5)
    scene = sample_scene(table2_rig(), BOARD, 30, np.random.default_rng(0), options)
    seen = [np.isfinite(px[..., 0]).mean(axis=1) for px in scene.project()]
    assert min(s.min() for s in seen) >= 0.5
    assert np.mean(seen[0] < 1) > 0.2


def test_named_degenerate_sets():
    rng = np.random.default_rng(0)
    flat = fronto_parallel(table2_rig(), BOARD, 20, rng)
    assert _tilt_deg(flat).max() < 1e-5
    assert np.ptp(flat.t, axis=0).min() > 0.01
    fisheye = random_rig(rng, "fisheye4")
    assert _tilt_deg(fronto_parallel(fisheye, BOARD, 20, rng)).max() < 1e-5
    same = same_pose(table2_rig(), BOARD, 20, rng)
    assert same.t.shape == (20, 3)
    assert np.ptp(same.t, axis=0).max() == 0
    assert np.ptp(same.R, axis=0).max() == 0


def test_same_seed_same_poses():
    first, second = (sample_board_poses(table2_rig(), BOARD, 7, np.random.default_rng(3)) for _ in range(2))
    assert np.array_equal(first.t, second.t)
    assert np.array_equal(first.R, second.R)
    assert sample_board_poses(table2_rig(), BOARD, 0, np.random.default_rng(3)).t.shape == (0, 3)


def test_an_impossible_scene_ends_with_figures():
    options = PoseOptions(fill=(1.5, 2.0))
    with pytest.raises(SceneError, match=r"0 of 5 board poses found: a pattern of 0.24 x 0.18") as error:
        sample_board_poses(table2_rig(), BOARD, 5, np.random.default_rng(0), options)
    assert (error.value.placed, error.value.wanted) == (0, 5)


def test_units_of_rig_and_board_must_agree():
    with pytest.raises(ValueError, match="metric"):
        sample_board_poses(table2_rig(), parse_board("chessboard:9x6"), 3, np.random.default_rng(0))
    with pytest.raises(ValueError, match="batch"):
        StereoScene(table2_rig(), BOARD, SE3.identity())


def test_options_are_checked():
    for bad in ({"fill": (0.8, 0.3)}, {"tilt_deg": (10, 95)}, {"min_visible_share": 0}):
        with pytest.raises(ValueError):
            PoseOptions(**bad)
