from __future__ import annotations

from dataclasses import replace

import numpy as np

from binocal.metrics.image import length_error, pixel_error
from binocal.metrics.order import order_corners
from rigs import make_detections, make_poses, make_rig


def scene(noise_px: float = 0.1):
    rng = np.random.default_rng(0)
    rig, poses = make_rig(), make_poses(6, rng)
    return rig, make_detections(rig, poses, noise_px=noise_px, rng=rng)


def test_views_in_order_are_left_alone():
    rig, detections = scene()
    ordered = order_corners(rig, detections)
    assert ordered.notes == ()
    np.testing.assert_array_equal(ordered.detections.right_px, detections.right_px)
    assert pixel_error(rig, ordered.detections, ordered.T_left_board).all_px < 0.15


def test_reversed_views_are_repaired_and_named():
    rig, detections = scene()
    right, left = detections.right_px.copy(), detections.left_px.copy()
    right[1], left[4] = right[1, ::-1], left[4, ::-1]
    ordered = order_corners(rig, replace(detections, right_px=right, left_px=left))
    assert [note.split(":")[0] for note in ordered.notes] == ["view 1", "view 4"] and "reversed" in ordered.notes[0]
    assert pixel_error(rig, ordered.detections, ordered.T_left_board).all_px < 0.15
    assert length_error(rig, ordered.detections).scale_rms_percent < 0.2


def test_all_views_reversed():
    rig, detections = scene()
    ordered = order_corners(rig, replace(detections, right_px=detections.right_px[:, ::-1]))
    assert len(ordered.notes) == 6
    np.testing.assert_array_equal(ordered.detections.right_px, detections.right_px)


def test_a_wrong_pair_is_not_explained_away():
    rig, detections = scene()
    right = detections.right_px.copy()
    right[2] += [0.0, 40.0]
    ordered = order_corners(rig, replace(detections, right_px=right))
    assert ordered.notes == ()
    np.testing.assert_array_equal(ordered.detections.right_px, right)


def test_a_turn_that_leaves_a_view_strange_is_no_repair():
    rig, detections = scene()
    right = detections.right_px.copy()
    right[0] = right[1, ::-1]  # another view's: 25 px off as given, 3 px turned
    ordered = order_corners(rig, replace(detections, right_px=right))
    assert ordered.notes == ()


def test_what_only_a_mirror_explains_is_not_repaired():
    rig, detections = scene()
    rows = np.arange(88).reshape(8, 11)
    right = detections.right_px[:, rows[:, ::-1].ravel()]
    ordered = order_corners(rig, replace(detections, right_px=right))
    assert ordered.notes == ()
    np.testing.assert_array_equal(ordered.detections.right_px, right)


def test_a_view_without_enough_corners_has_no_pose():
    rig, detections = scene()
    left, right = detections.left_px.copy(), detections.right_px.copy()
    left[3], right[3, 2:] = np.nan, np.nan
    ordered = order_corners(rig, replace(detections, left_px=left, right_px=right))
    error = pixel_error(rig, ordered.detections, ordered.T_left_board)
    assert np.isnan(error.view_rms_px).tolist() == [False, False, False, True, False, False]
