import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.simulation import PoseOptions, sample_scene, simulate_detections, table2_rig

BOARD = parse_board("chessboard:11x8:20mm")


@pytest.fixture(scope="module")
def scene():
    return sample_scene(table2_rig(), BOARD, 40, np.random.default_rng(0))


def test_without_noise_the_corners_are_the_projections(scene):
    detections = simulate_detections(scene, np.random.default_rng(0))
    left = scene.rig.left.project(scene.T_left_board.apply(BOARD.object_points_m))
    T_right_board = scene.rig.T_right_left @ scene.T_left_board
    right = scene.rig.right.project(T_right_board.apply(BOARD.object_points_m))
    assert np.array_equal(detections.left_px, left)
    assert np.array_equal(detections.right_px, right)
    assert detections.left_size_wh == detections.right_size_wh == (1280, 960)
    assert detections.is_metric


def test_noise_has_the_stated_spread(scene):
    exact = simulate_detections(scene, np.random.default_rng(0))
    noisy = simulate_detections(scene, np.random.default_rng(0), noise_px=0.1)
    error = np.concatenate([(noisy.left_px - exact.left_px).ravel(), (noisy.right_px - exact.right_px).ravel()])
    # 14080 values: the standard error of the spread is 0.6 %
    assert error.std() == pytest.approx(0.1, rel=0.02)
    assert abs(error.mean()) < 4 * 0.1 / np.sqrt(error.size)


def test_outliers_and_missing_corners_have_the_stated_share_and_size(scene):
    clean = simulate_detections(scene, np.random.default_rng(0), noise_px=0.1)
    dirty = simulate_detections(
        scene, np.random.default_rng(0), noise_px=0.1, outlier_share=0.05, outlier_px=50, missing_share=0.3
    )
    n = 40 * 88
    for a, b in ((clean.left_px, dirty.left_px), (clean.right_px, dirty.right_px)):
        missing = np.isnan(b[..., 0])
        assert missing.sum() == round(0.3 * n)
        distance = np.linalg.norm(b - a, axis=-1)[~missing]
        moved = distance[distance > 0]
        assert moved == pytest.approx(50)
        assert 0.7 * 0.05 * n * 0.7 < len(moved) < 1.3 * 0.05 * n * 0.7


def test_corners_outside_a_image_are_missing():
    scene = sample_scene(table2_rig(), BOARD, 20, np.random.default_rng(0), PoseOptions(min_visible_share=0.5))
    detections = simulate_detections(scene, np.random.default_rng(0))
    assert not detections.left_is_seen.all()
    seen = detections.left_px[detections.left_is_seen]
    assert seen.min() >= -0.5
    assert (seen.max(axis=0) <= [1279.5, 959.5]).all()


def test_bad_shares_are_refused(scene):
    with pytest.raises(ValueError, match="share"):
        simulate_detections(scene, np.random.default_rng(0), outlier_share=1.5)
    with pytest.raises(ValueError, match="noise_px"):
        simulate_detections(scene, np.random.default_rng(0), noise_px=-1)
