"""Faults of a whole set are named, sound sets are not: each kind on simulated rigs, from corners."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from binocal import calibrate
from binocal.boards import parse_board
from binocal.cameras import Camera
from binocal.errors import CalibrationError, InconsistentViewsError
from binocal.evidence import Detections
from binocal.geometry import so3
from binocal.set_checks.copies import different_poses, first_of_copies
from binocal.simulation import random_rig, sample_board_poses

CHESSBOARD = "chessboard:9x6:30mm"
SEEDS = range(3)
N_VIEWS, NOISE_PX, FROM = 16, 0.08, 7


class Recording:
    """A random rig's views of a board, to be spoiled before the cameras see them."""

    def __init__(self, seed, spec=CHESSBOARD, model="brown4", n_views=N_VIEWS):
        self.rng = np.random.default_rng([seed, 17])
        self.rig, self.board = random_rig(self.rng, model), parse_board(spec)
        self.n_views, self.spec = n_views, spec
        self.points = self.board.object_points_m
        T = sample_board_poses(self.rig, self.board, n_views, self.rng)
        self.in_left = T.apply(self.points)
        self.in_right = self.rig.T_right_left.apply(self.in_left)
        self.left, self.right = [self.rig.left] * n_views, [self.rig.right] * n_views

    def corners(self, points=None):
        pixels = []
        for cameras, inside in ((self.left, self.in_left), (self.right, self.in_right)):
            px = np.stack([camera.project(x) for camera, x in zip(cameras, inside, strict=True)])
            px += self.rng.normal(0, NOISE_PX, px.shape)
            px[((px < 0) | (px > np.array(cameras[0].size_wh) - 1)).any(axis=-1)] = np.nan
            pixels.append(px)
        size = {"right_image_size_wh": self.rig.right.size_wh, "board_spec": self.spec}
        return Detections.from_arrays(self.points if points is None else points, *pixels, self.rig.left.size_wh, **size)


def other_lens(camera, focal=1.0, shift_px=0.0):
    parameters = camera.parameters.copy()
    parameters[:2] *= focal
    parameters[2] += shift_px
    return Camera(camera.model, camera.size_wh, parameters)


def codes(calibration):
    return {found.code for found in calibration.findings}


@pytest.mark.parametrize("model", ["brown4", "fisheye4"])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_sound_set_has_nothing_to_be_named(seed, model):
    assert codes(calibrate(Recording(seed, model=model).corners(), model=model)) == set()


@pytest.mark.parametrize("seed", SEEDS)
def test_a_camera_that_was_knocked_is_named_with_view_and_angle(seed):
    views = Recording(seed)
    axis = views.rng.normal(size=3)
    turn = so3.exp(np.radians(0.2) * axis / np.linalg.norm(axis))
    views.in_right[FROM:] = views.in_right[FROM:] @ turn.T
    found = [f for f in calibrate(views.corners(), model="brown4").findings if f.code == "rig-changed"]
    assert [f.figures["view"] for f in found] == [f"{FROM:02d}"]
    assert found[0].figures["kind"] in ("turned", "shifted")
    if found[0].figures["kind"] == "turned":
        assert found[0].figures["size"] == pytest.approx(0.2, rel=0.25)


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_camera_that_was_refocused_is_named(side):
    views = Recording(1)
    cameras = getattr(views, side)
    setattr(views, side, [*cameras[:FROM], *(other_lens(c, focal=1.003) for c in cameras[FROM:])])
    found = [f for f in calibrate(views.corners(), model="brown4").findings if f.code == "rig-changed"]
    assert [f.figures["kind"] for f in found] == ["refocused"]
    assert found[0].figures["size"] == pytest.approx(0.3, rel=0.3)


def test_an_image_that_is_shifted_in_some_views_is_two_states():
    views = Recording(0)
    moved = [2, 3, 6, 8, 9, 12, 14]
    views.left = [other_lens(c, shift_px=2.0) if i in moved else c for i, c in enumerate(views.left)]
    found = [f for f in calibrate(views.corners(), model="brown4").findings if f.code == "rig-has-two-states"]
    assert len(found) == 1 and found[0].figures["n_views"] in (len(moved), N_VIEWS - len(moved))


@pytest.mark.parametrize("seed", SEEDS)
def test_a_rig_that_drifts_is_named(seed):
    views = Recording(seed, n_views=20)
    axis = views.rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    for view in range(20):
        views.in_right[view] = views.in_right[view] @ so3.exp(np.radians(0.3) * view / 19 * axis).T
    assert codes(calibrate(views.corners(), model="brown4")) & {"rig-drifts", "rig-changed"} == {"rig-drifts"}


@pytest.mark.parametrize("seed", SEEDS)
def test_cameras_not_triggered_together_are_named(seed):
    views = Recording(seed)
    views.in_right = views.in_right + views.rng.normal(0, 0.6e-3, (N_VIEWS, 1, 3))
    calibration = calibrate(views.corners(), model="brown4")
    assert "exposures-apart" in codes(calibration) and calibration.exposure.are_apart
    assert calibration.exposure.alone_px == pytest.approx(NOISE_PX, rel=0.15)


def test_a_board_in_the_hand_is_refused_for_the_pairs():
    views = Recording(2)
    views.in_right = views.in_right + views.rng.normal(0, 8e-3, (N_VIEWS, 1, 3))
    with pytest.raises(InconsistentViewsError, match="not taken together") as caught:
        calibrate(views.corners(), model="brown4")
    assert caught.value.findings[0].code == "pairs-not-together"


@pytest.mark.parametrize("n_copies", [1, 5])
def test_copies_count_once(n_copies):
    detections = Recording(3).corners()
    twice = detections.select(np.r_[0:N_VIEWS, np.zeros(n_copies, dtype=int)])
    twice = replace(twice, names=(*detections.names, *(f"copy{i}" for i in range(n_copies))))
    once, calibration = calibrate(detections, model="brown4"), calibrate(twice, model="brown4")
    np.testing.assert_array_equal(calibration.rig.T_right_left.t, once.rig.T_right_left.t)
    np.testing.assert_array_equal(calibration.covariance.matrix, once.covariance.matrix)
    assert codes(calibration) == {"views-copied"}
    assert [(v.name, v.code) for v in calibration.rejected] == [(f"copy{i}", "view-copied") for i in range(n_copies)]


def test_one_view_six_times_is_said_to_be_copies():
    detections = Recording(3).corners()
    same = replace(detections.select(np.zeros(6, dtype=int)), names=tuple("012345"))
    with pytest.raises(CalibrationError, match="5 of 6 views are copies") as caught:
        calibrate(same)
    assert caught.value.findings[0].code == "too-few-views-beside-copies"
    assert caught.value.rejected["1"] == "a copy of view 0"


def test_views_of_one_pose_are_counted():
    views = Recording(4, n_views=8)
    views.in_left, views.in_right = (np.repeat(x, 3, axis=0) for x in (views.in_left, views.in_right))
    views.left, views.right = views.left * 3, views.right * 3
    calibration = calibrate(views.corners(), model="brown4")
    found = [f for f in calibration.findings if f.code == "few-different-poses"]
    assert found and found[0].figures == {"n_given": 24, "n_poses": 8}


def test_a_rig_on_three_shared_views_is_said():
    detections = Recording(5).corners()
    right = detections.right_px.copy()
    right[3:] = np.nan
    calibration = calibrate(replace(detections, right_px=right), model="brown4")
    found = [f for f in calibration.findings if f.code == "rests-on-few-views"]
    assert found and found[0].figures["n_shared"] == 3


def test_a_change_that_throws_the_last_views_out_is_named():
    views = Recording(6)
    views.in_right[-4:] = views.in_right[-4:] @ so3.exp(np.radians([2.0, 1.0, 0.5])).T
    found = [f for f in calibrate(views.corners(), model="brown4").findings if f.code == "changed-from-view"]
    assert found and (found[0].figures["first"], found[0].figures["last"]) == ("12", "15")


@pytest.mark.parametrize(("moved", "is_said"), [((2, 9), False), ((2, 6, 9, 13), True)])
def test_many_scattered_views_left_out_are_a_warning(moved, is_said):
    views = Recording(6)
    for view in moved:
        views.in_right[view] = views.in_right[view] @ so3.exp(views.rng.normal(0, 0.03, 3)).T
    calibration = calibrate(views.corners(), model="brown4")
    assert {v.name for v in calibration.rejected} == {f"{view:02}" for view in moved}
    found = [f.figures for f in calibration.findings if f.code == "many-views-left-out"]
    assert found == ([{"n_out": 4, "n_given": 16, "views": "02, 06, 09, 13"}] if is_said else [])


@pytest.mark.parametrize("gap", [0.29, 0.25])
def test_the_right_gap_of_an_aprilgrid_is_given(gap):
    views = Recording(7, spec="aprilgrid:5x4:40mm:0.3", n_views=20)
    drawn = replace(views.board, tag_gap_ratio=gap).object_points_m
    views.spec = f"aprilgrid:5x4:40mm:{gap}"
    found = [f for f in calibrate(views.corners(drawn), model="brown4").findings if f.code == "aprilgrid-gap-wrong"]
    assert found and found[0].figures["given"] == gap and found[0].figures["found"] == pytest.approx(0.3, abs=5e-3)


@pytest.mark.parametrize("step", [1, 9])
def test_left_lists_shifted_by_a_column_or_row_are_refused(step):
    detections = Recording(8).corners()
    left = np.full_like(detections.left_px, np.nan)
    left[:, :-step] = detections.left_px[:, step:]
    if step == 1:
        left[:, 8::9] = np.nan  # the last of every row has no neighbour
    with pytest.raises(InconsistentViewsError, match=r"off by one (column|row)"):
        calibrate(replace(detections, left_px=left), model="brown4")


@pytest.mark.parametrize("seed", [6, 11, 22])
def test_motion_that_shifted_lists_would_lessen_is_called_motion(seed):
    views = Recording(seed, n_views=10)
    views.in_right += 0.15 * 0.03 * views.rng.normal(0, 1, (10, 1, 3))
    with pytest.raises(CalibrationError) as error:
        calibrate(views.corners(), model="brown4")
    assert {found.code for found in error.value.findings} == {"pairs-not-together"}


@pytest.mark.parametrize("factor", [1000.0, 1e-3])
def test_millimetres_for_metres_are_doubted(factor):
    detections = Recording(10).corners()
    scaled = replace(detections, object_points_m=factor * detections.object_points_m)
    assert codes(calibrate(scaled, model="brown4")) == {"scale-doubtful"}
    assert codes(calibrate(replace(scaled, is_metric=False), model="brown4")) == set()


def test_first_of_copies_and_different_poses():
    detections = Recording(9, n_views=5).corners().select(np.array([0, 1, 0, 2, 1]))
    assert first_of_copies(detections).tolist() == [0, 1, 0, 3, 1]
    assert different_poses(detections, 0.5).tolist() == [True, True, False, True, False]


def test_a_wild_step_of_a_freed_solve_is_no_error():
    """Two recordings in one, half of the rig turned: whatever comes out, it is a calibration or a refusal."""
    for seed in range(4):
        views = Recording(20 + seed)
        other = Recording(40 + seed)
        views.in_left[8:], views.in_right[8:] = other.in_left[8:], other.in_right[8:]
        views.left[8:], views.right[8:] = other.left[8:], other.right[8:]
        try:
            assert codes(calibrate(views.corners(), model="brown4"))
        except CalibrationError as error:
            assert error.findings


@pytest.mark.parametrize(("step", "by"), [(1, 1), (-1, -1)])
def test_the_remedy_of_shifted_lists_puts_them_right(step, by):
    detections = Recording(8).corners()
    columns = np.arange(54) % 9
    source = np.arange(54) + step
    inside = (columns + step >= 0) & (columns + step < 9)
    left = np.full_like(detections.left_px, np.nan)
    left[:, inside] = detections.left_px[:, source[inside]]
    with pytest.raises(InconsistentViewsError) as caught:
        calibrate(replace(detections, left_px=left), model="brown4")
    (found,) = caught.value.findings
    # what the left lists call column c is column c + step of the board
    assert (found.code, found.figures["line"], found.figures["by"]) == ("corner-lists-shifted", "column", by)
