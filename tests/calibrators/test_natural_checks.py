"""Matches that are not of one moment, not of these cameras or not of the rig that was given."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from binocal.app.pair_matching import matches_of
from binocal.calibrators.natural import NaturalRequest, calibrate_from_matches
from binocal.calibrators.natural_cameras import assumed_covariance, slopes_of
from binocal.cameras import Camera, StereoRig
from binocal.datasets import open_dataset
from binocal.errors import InconsistentViewsError
from binocal.evidence.point_matches import PointMatches
from binocal.geometry import SE3, so3
from binocal.matching.relative_pose import estimate_relative_pose
from binocal.simulation import simulate_matches
from binocal.solvers.epipolar import EpipolarProblem
from binocal.solvers.epipolar_diagnosis import camera_misfit
from binocal.solvers.relative_pose import RelativePose
from streets import SIZE, T_RIGHT_LEFT, cameras, street


def solve(matches, pair=None, old=T_RIGHT_LEFT, filed=None):
    known = pair or cameras()
    guess = lambda found: estimate_relative_pose(known, found.left_px, found.right_px)  # noqa: E731
    return calibrate_from_matches(matches, NaturalRequest(known, old, 0.54, guess=guess, filed=filed))


def pairs(rng, n):
    return [replace(street(rng, cameras(), 200, 0.1), names=(f"pair {k}",)) for k in range(n)]


def exchanged(matches):
    return replace(matches, left_px=matches.right_px, right_px=matches.left_px)


def turned_by_180(px):
    return np.array(SIZE) - 1 - px


def with_focal_length(camera, factor):
    parameters = camera.parameters.copy()
    parameters[:2] *= factor
    return Camera(camera.model, camera.size_wh, parameters)


def test_exchanged_sides_are_named():
    one = street(np.random.default_rng(0), cameras(), 300, 0.1)
    for start in ({"old": T_RIGHT_LEFT}, {"old": None, "filed": T_RIGHT_LEFT}):
        with pytest.raises(InconsistentViewsError, match="left and right are exchanged"):
            solve(exchanged(one), cameras()[::-1], **start)


def test_one_camera_upside_down_is_named():
    plain = tuple(Camera("brown4", SIZE, np.array([720, 721, 620.5, 187, 0, 0, 0, 0, 0.0])) for _ in range(2))
    one = street(np.random.default_rng(1), plain, 300, 0.1)
    one = replace(one, right_px=turned_by_180(one.right_px))
    with pytest.raises(InconsistentViewsError, match="upside down against the other's"):
        solve(one, plain)


def test_a_pair_of_two_moments_is_named():
    """The rig went two metres forward between the exposures."""
    rng = np.random.default_rng(2)
    one = street(rng, cameras(), 1500, 0.1)
    rays = cameras()[0].unproject(one.left_px)
    points = rays / rays[:, 2:] * rng.uniform(6, 40, (len(rays), 1))
    px = cameras()[1].project(SE3(T_RIGHT_LEFT.R, T_RIGHT_LEFT.t - [0.0, 0.0, 2.0]).apply(points))
    inside = ((px > 0) & (px < np.array(SIZE) - 1)).all(axis=1)
    one = replace(one, right_px=np.where(inside[:, None], px, one.right_px)).select(inside)
    for start in ({"old": T_RIGHT_LEFT}, {"old": None, "filed": T_RIGHT_LEFT}):
        with pytest.raises(InconsistentViewsError, match="not of one moment"):
            solve(one, **start)
    rest = pairs(rng, 3)
    found = solve(PointMatches.joined([rest[0], replace(one, names=("late",)).select(np.arange(200)), *rest[1:]]))
    assert [f.code for f in found.findings] == ["pairs-left-out"] and "late (" in found.findings[0].text
    assert [view.name for view in found.views] == ["pair 0", "pair 1", "pair 2"]
    assert np.degrees(so3.angle_rad(found.rig.T_right_left.R @ T_RIGHT_LEFT.R.T)) < 0.05


def test_an_exchanged_pair_is_left_out_and_half_of_them_refused():
    rng = np.random.default_rng(3)
    flat = tuple(Camera("brown4", SIZE, np.array([720, 720, 620, 187, 0, 0, 0, 0, 0.0])) for _ in range(2))
    beside = SE3(np.eye(3), np.array([-0.54, 0.0, 0.0]))

    def rectified():
        one = street(rng, flat, 200, 0.0)
        near = flat[0].unproject(one.left_px)
        near = near / near[:, 2:] / rng.uniform(1 / 60, 1 / 4, (200, 1))
        right = flat[1].project(beside.apply(near)) + rng.normal(0, 0.1, (200, 2))
        return replace(one, right_px=right)

    parts = [replace(rectified(), names=(str(k),)) for k in range(4)]
    three = PointMatches.joined([*parts[:3], exchanged(parts[3])])
    found = solve(three, flat, old=beside)
    assert "3 (its points lie behind the cameras" in found.findings[0].text and len(found.views) == 3
    half = PointMatches.joined([*parts[:2], *(exchanged(part) for part in parts[2:])])
    with pytest.raises(InconsistentViewsError, match="2 of 4 pairs do not fit together"):
        calibrate_from_matches(half, NaturalRequest(flat))
    assert len(solve(half, flat, old=beside).views) == 2  # an old rig says which


def test_rectified_images_of_a_raw_rig_are_named():
    one = street(np.random.default_rng(4), cameras(), 300, 0.05)
    same_row = np.column_stack([one.right_px[:, 0], one.left_px[:, 1]])
    same_row[:, 1] += np.random.default_rng(5).normal(0, 0.05, 300)
    for start in ({"old": T_RIGHT_LEFT}, {"old": None, "filed": T_RIGHT_LEFT}):
        with pytest.raises(InconsistentViewsError, match="lie on equal rows"):
            solve(replace(one, right_px=same_row), **start)


def test_cameras_mounted_anew_are_found_without_their_files_pose():
    """One above the other by the file, side by side and 20 degrees turned in truth: told, with a word about it."""
    one = street(np.random.default_rng(4), cameras(), 300, 0.05)
    filed = SE3(so3.exp(np.radians([0.0, 20.0, 0.0])), np.array([0.0, -0.5, 0.0]))
    found = solve(one, old=None, filed=filed)
    assert np.degrees(so3.angle_rad(found.rig.T_right_left.R @ T_RIGHT_LEFT.R.T)) < 0.1
    (said,) = found.findings
    assert said.code == "pose-unlike-file" and 80 < said.figures["direction_deg"] < 100
    assert not solve(one, old=None, filed=T_RIGHT_LEFT).findings


def test_a_turned_rig_of_rectified_images_is_no_raw_rig():
    rng = np.random.default_rng(6)
    flat = tuple(Camera("brown4", SIZE, np.array([720, 720, 620, 187, 0, 0, 0, 0, 0.0])) for _ in range(2))
    one = street(rng, flat, 300, 0.0)
    points = flat[0].unproject(one.left_px)
    points = points / points[:, 2:] / rng.uniform(1 / 60, 1 / 4, (300, 1))
    beside = SE3(np.eye(3), np.array([-0.54, 0.0, 0.0]))
    one = replace(one, right_px=flat[1].project(beside.apply(points)) + rng.normal(0, 0.1, (300, 2)))
    for axis in np.eye(3):
        found = solve(one, flat, old=SE3(so3.exp(np.radians(3.0) * axis), beside.t))
        assert np.degrees(so3.angle_rad(found.rig.T_right_left.R)) < 0.1 and not found.findings


def test_wrong_focal_length_is_asked_for():
    one = street(np.random.default_rng(7), cameras(), 600, 0.1)
    left, right = cameras()
    found = solve(one, (left, with_focal_length(right, 1.004)))
    (ask,) = (f for f in found.findings if f.code == "matches-ask-for-other-cameras")
    assert ask.figures["parameter"] in ("left.f", "right.f") and ask.figures["saved_percent"] > 40
    assert "focal length of the" in ask.text and "%" in ask.text
    assert not solve(one).findings


def test_other_cameras_are_named_not_called_drift():
    """Focal lengths of both cameras or of one, and a lens; 0.3 to 1.2 px are left beside 0.1 px of noise."""
    one = street(np.random.default_rng(7), cameras(), 600, 0.1)
    left, right = cameras()
    without_lens = tuple(Camera(c.model, c.size_wh, np.r_[c.parameters[:5], np.zeros(4)]) for c in cameras())
    for others in (
        (left, with_focal_length(right, 1.05)),
        (with_focal_length(left, 0.7), with_focal_length(right, 0.7)),
        without_lens,
    ):
        for old in (T_RIGHT_LEFT, None):
            with pytest.raises(InconsistentViewsError, match="cameras' own parameters do not fit the images"):
                solve(one, others, old)


def test_cameras_as_a_good_calibration_leaves_them_are_no_others():
    """Errors of one assumed standard deviation leave a tenth of a pixel here, none of it beyond what they may leave."""
    rng = np.random.default_rng(5)
    root = np.linalg.cholesky(assumed_covariance(cameras(), of_no_lens=True) + 1e-18 * np.eye(18))
    for _ in range(4):
        moved = np.split(root @ rng.normal(size=18), 2)
        wrong = tuple(replace(c, parameters=c.parameters + m) for c, m in zip(cameras(), moved, strict=True))
        assert solve(street(rng, cameras(), 600, 0.1), wrong).noise_px < 0.2


def test_pairs_that_differ_are_no_sign_of_other_cameras():
    """Of two pairs the right camera of one is turned by a tenth of a degree, which leaves half a pixel."""
    one, two = pairs(np.random.default_rng(8), 2)
    turned = SE3(so3.exp(np.radians([0.1, 0.0, 0.0])) @ T_RIGHT_LEFT.R, T_RIGHT_LEFT.t)
    two = simulate_matches(StereoRig(*cameras(), turned), 200, np.random.default_rng(9), noise_px=0.1).matches
    matches = PointMatches.joined([one, two])
    problem, _ = EpipolarProblem.of_matches(cameras(), matches)
    pose = RelativePose.of(T_RIGHT_LEFT)
    covariance = assumed_covariance(cameras(), of_no_lens=True)
    slopes = slopes_of(problem, matches, pose, cameras(), np.sqrt(np.diagonal(covariance)))
    equations = problem.linearize(pose, np.asarray(1.0), "squared")
    assert camera_misfit(equations, matches.pair, slopes, covariance) is None


def test_a_rig_knocked_on_the_way_is_no_other_camera(data_dir):
    """EuRoC's right camera is turned by 0.2 deg of pitch between two pairs: weights at a pose in between feigned other cameras."""
    data = open_dataset(f"euroc:{data_dir / 'euroc_micro'}")
    rig, pairs = data.rig, list(data.pairs())
    known = rig.left, rig.right
    before, after = (matches_of([pairs[k]], known)[0] for k in (0, 8))
    rays = rig.right.unproject(after.right_px) @ so3.exp(np.radians([0.2, 0.0, 0.0]))
    matches = PointMatches.joined([before, replace(after, right_px=rig.right.project(rays))])
    with pytest.raises(InconsistentViewsError, match="no one pose fits all"):
        calibrate_from_matches(matches, NaturalRequest(known, rig.T_right_left, rig.baseline_m))


def knocked(deg: float, n_before: int, n_after: int) -> PointMatches:
    """Pairs of a rig whose right camera is turned by so much pitch between two of them."""
    rng = np.random.default_rng(12)
    turned = SE3(so3.exp(np.radians([deg, 0.0, 0.0])) @ T_RIGHT_LEFT.R, T_RIGHT_LEFT.t)
    rigs = [StereoRig(*cameras(), pose) for pose in [T_RIGHT_LEFT] * n_before + [turned] * n_after]
    parts = [simulate_matches(rig, 200, rng, noise_px=0.1).matches for rig in rigs]
    return PointMatches.joined([replace(part, names=(str(k),)) for k, part in enumerate(parts)])


@pytest.mark.parametrize(
    ("deg", "n_before", "n_after", "words"),
    [
        (0.1, 2, 2, "4 of 4 pairs do not fit together: each fits these cameras with a pose of its own"),
        (0.3, 3, 2, "2 of 5 pairs do not fit together: 3, 4 show a right camera that is turned by 0.3 deg"),
        (2.0, 2, 2, "2 of 4 pairs do not fit together: .* is turned by 2 deg .*: the rig was knocked on the way"),
        (2.0, 2, 3, "2 of 5 pairs do not fit together: 0, 1 show"),
    ],
)
def test_a_rig_knocked_half_way_is_refused(deg, n_before, n_after, words):
    with pytest.raises(InconsistentViewsError, match=words):
        solve(knocked(deg, n_before, n_after))


def test_a_single_pair_of_another_pose_is_left_out():
    (said,) = solve(knocked(2.0, 3, 1)).findings
    assert said.code == "pairs-left-out" and "or the rig was knocked" in said.text


def test_pairs_of_a_rig_that_flexes_disagree():
    """The right camera of every other pair is turned by 0.05 deg of pitch: 0.3 px. Of a stiff rig nothing is said."""
    rng = np.random.default_rng(11)
    turned = SE3(so3.exp(np.radians([0.05, 0.0, 0.0])) @ T_RIGHT_LEFT.R, T_RIGHT_LEFT.t)
    rigs = [StereoRig(*cameras(), pose) for pose in (T_RIGHT_LEFT, turned)]
    parts = [replace(simulate_matches(rigs[k % 2], 200, rng, noise_px=0.1).matches, names=(str(k),)) for k in range(4)]
    (said,) = solve(PointMatches.joined(parts)).findings
    assert said.code == "pairs-disagree" and 0.1 < said.figures["apart_px"] < 0.5
    assert not solve(PointMatches.joined(pairs(rng, 3))).findings
