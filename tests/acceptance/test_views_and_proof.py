"""Views that contradict the rest, and the proof that lets a clean start stand."""

from dataclasses import replace

import numpy as np
import pytest

from binocal import acceptance
from binocal.acceptance.figures import corner_spacing_px
from binocal.boards import parse_board
from binocal.calibrators import calibrate, joint
from binocal.findings import finding
from binocal.simulation import flip_view, sample_scene, simulate_detections, table2_rig


@pytest.fixture(scope="module")
def detections():
    rng = np.random.default_rng(0)
    scene = sample_scene(table2_rig(), parse_board("chessboard:9x6:30mm"), 8, rng)
    return simulate_detections(scene, rng, noise_px=0.1)


@pytest.fixture(scope="module")
def sound(detections):
    return calibrate(detections, model="brown4", calibrator="lm")


def corner_masks(detections, n_used, side="right", view=2):
    used = {s: getattr(detections, f"{s}_is_seen").copy() for s in ("left", "right")}
    used[side][view, n_used:] = False
    return used["left"], used["right"]


def test_a_view_needs_half_of_its_corners_in_each_camera(detections):
    lengths2 = (np.full((8, 54), 4.0), np.full((8, 54), 9.0))
    assert acceptance.contradicting_views(detections, lengths2, corner_masks(detections, 27)) == {}
    (view, found), = acceptance.contradicting_views(detections, lengths2, corner_masks(detections, 26)).items()  # fmt: skip
    assert view == 2 and found.code == "view-contradicts"
    assert found.figures == {"camera": "right", "n_unused": 28, "n_seen": 54, "typical_px": 3.0}


def test_a_view_that_no_camera_saw_contradicts_nothing(detections):
    px = detections.left_px.copy()
    px[2] = np.nan
    unseen = replace(detections, left_px=px)
    lengths2 = (np.zeros((8, 54)), np.zeros((8, 54)))
    assert acceptance.contradicting_views(unseen, lengths2, (unseen.left_is_seen, unseen.right_is_seen)) == {}


def test_the_joint_solve_rejects_a_view_that_the_diagnosis_let_pass(detections, monkeypatch):
    # One view's right corners lie 15 px off, all alike: its own pose fits them, the rig does not.
    px = detections.right_px.copy()
    px[3] += [15.0, -9.0]
    shifted = replace(detections, right_px=px)
    diagnosis = joint.diagnose_views(shifted, "brown4")
    blind = replace(diagnosis, is_used=np.ones(8, dtype=bool), rejected=())
    start = joint.diagnose_views(detections, "brown4")
    blind = replace(blind, R_left_board=start.R_left_board, t_left_board=start.t_left_board)
    monkeypatch.setattr(joint, "diagnose_views", lambda *_, **__: blind)
    calibration = calibrate(shifted, model="brown4", calibrator="lm")
    (rejected,) = calibration.rejected
    assert rejected.name == shifted.names[3] and rejected.code == "view-contradicts"
    assert len(calibration.views) == 7


def spread(n_views=8, n=54, px2=0.02):
    return (np.full((n_views, n), px2), np.full((n_views, n), px2))


def evenly(lengths2, used=None, homography_px=0.1):
    used = used or tuple(np.ones(side.shape, dtype=bool) for side in lengths2)
    n_seen = np.full(2 * len(lengths2[0]), lengths2[0].shape[1])
    return acceptance.fits_evenly(n_seen, used, lengths2, lengths2, homography_px)


def test_images_must_fit_alike():
    left, right = spread()
    assert evenly((left, right))
    right = right.copy()
    right[5] *= 3.9
    assert evenly((left, right), homography_px=0.2)
    right[5] *= 4.1 / 3.9  # RMS 2.02 times that of the median image
    assert not evenly((left, right), homography_px=0.2)


def test_images_must_fit_as_well_as_homographies_of_their_own():
    lengths2 = spread(px2=200.0)  # 10 px for one coordinate
    assert evenly(lengths2, homography_px=10 / 1.19) and not evenly(lengths2, homography_px=10 / 1.21)


def test_an_image_that_lost_corners_proves_nothing():
    lengths2 = spread(n=100)
    used = [np.ones(side.shape, dtype=bool) for side in lengths2]
    used[0][1, :5] = False
    assert evenly(lengths2, tuple(used))
    used[0][1, :6] = False
    assert not evenly(lengths2, tuple(used))


def sigma_of(calibration, name, value):
    matrix = calibration.covariance.matrix.copy()
    i = calibration.covariance.names.index(name)
    matrix[i], matrix[:, i] = 0.0, 0.0
    matrix[i, i] = value**2
    return replace(calibration, covariance=replace(calibration.covariance, matrix=matrix))


def test_each_doubt_alone_is_enough(sound):
    rig, spacing_px = sound.rig, corner_spacing_px(sound.evidence.detections, 4)
    assert acceptance.is_beyond_doubt(sound)
    parameters = rig.right.parameters.copy()
    parameters[3] = 0.59 * 960
    away = replace(sound, rig=replace(rig, right=replace(rig.right, parameters=parameters)))
    exchanged = replace(rig, T_right_left=rig.T_right_left.inverse())
    doubts = {
        "noise": replace(sound, noise_px=0.0101 * spacing_px),
        "centre": away,
        "focal length": sigma_of(sound, "left.fy", 0.0051 * rig.left.parameters[1]),
        "translation": sigma_of(sound, "translation.z", 0.021 * rig.baseline_m),
        "exchanged": replace(sound, rig=exchanged),
        "no evidence": replace(sound, evidence=None),
        "a finding": replace(sound, findings=(finding("cameras-exchanged"),)),
    }
    assert {name: acceptance.is_beyond_doubt(doubtful) for name, doubtful in doubts.items()} == dict.fromkeys(
        doubts, False
    )
    assert acceptance.is_beyond_doubt(replace(sound, noise_px=0.0099 * spacing_px))


def test_a_set_with_one_reversed_view_is_not_taken_for_clean(detections):
    calibration = calibrate(flip_view(detections, 4, side="right"), model="brown4", calibrator="lm")
    assert [view.note for view in calibration.views if view.note]
