"""What a difference of two rigs is uncertain by: errors of the same intrinsics count once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from binocal.app.natural_drift import covariance_in_common, drift_of, made_by_recalibrate, reference_values
from binocal.calibrators.natural import NaturalRequest, calibrate_from_matches
from binocal.calibrators.natural_cameras import assumed_covariance
from binocal.errors import DataError
from binocal.result import Covariance
from streets import T_RIGHT_LEFT, cameras, street

POSE = tuple(f"{part}.{axis}" for part in ("rotation", "translation") for axis in "xyz")


def test_what_two_poses_have_in_common_is_what_their_intrinsics_do_to_them():
    rng = np.random.default_rng(0)
    names = ("left.fx", "left.k1", "right.fx")
    root = np.diag([0.3, 1e-3, 0.4]) @ rng.normal(size=(3, 3))
    of_cameras = root @ root.T
    first, second = rng.normal(size=(2, 6, 3)) * [1e-4, 0.1, 1e-4]

    def bears(steps):
        top = np.hstack([of_cameras, of_cameras @ steps.T])
        return np.vstack([top, np.hstack([steps @ of_cameras, steps @ of_cameras @ steps.T + 1e-8 * np.eye(6)])])

    new, old = (Covariance((*names, *POSE), bears(steps)) for steps in (first, second))
    np.testing.assert_allclose(covariance_in_common(new, old), first @ of_cameras @ second.T, rtol=1e-6, atol=1e-15)
    board_alone = Covariance(POSE, old.matrix[3:, 3:])
    assert not covariance_in_common(new, board_alone).any()


def test_a_rig_from_recalibrate_differs_by_less_than_by_its_cameras_errors():
    """Six sets of cameras that are wrong as assumed; pitch differed by 0.03 of what was stated when these counted twice."""
    rng = np.random.default_rng(5)
    root = np.linalg.cholesky(assumed_covariance(cameras(), of_no_lens=False) + 1e-18 * np.eye(18))
    scores = []
    for _ in range(6):
        moved = np.split(root @ rng.normal(size=18), 2)
        wrong = tuple(replace(c, parameters=c.parameters + m) for c, m in zip(cameras(), moved, strict=True))
        request = NaturalRequest(wrong, T_RIGHT_LEFT, 0.54)
        old = calibrate_from_matches(street(rng, cameras(), 400, 0.1), request)
        again = replace(request, old=old.rig.T_right_left, intrinsics=old.covariance)
        new = calibrate_from_matches(street(rng, cameras(), 200, 0.1), again)
        made = made_by_recalibrate(old)
        assert made is not None and made["n_matches"] == 400
        drift = drift_of(new, old.rig, old.covariance, None, made)
        twice = drift_of(new, old.rig, old.covariance, None)
        assert drift.sigma_deg[0] < 0.5 * twice.sigma_deg[0] and not drift.is_sure
        scores.append(drift.z)
    rms = np.sqrt(np.mean(np.square(scores), axis=0))
    assert (rms > 0.1).all() and (rms < 1.3).all(), rms  # measured 0.18, 0.71, 0.21 of ten
    assert made_by_recalibrate(replace(old, provenance={})) is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ([1], "no object of names and values"),
        ("R", "R is missing"),
        ({"R": [[1, 0], [0, 1]]}, "R is not 3 x 3 finite numbers"),
        ({"R": [[1, 0, 0], [0, 1, 0], [0, 0, 2]]}, "R is no rotation"),
        ({"T_direction": [0, 0, 0]}, "T_direction is not of length 1"),
        ({"T_direction": ["left"]}, "T_direction is not 3 finite numbers"),
        ({"random_rotation_covariance_rad2": [[0, 0, 0]] * 3}, "is no covariance"),
        ({"random_rotation_covariance_rad2": (-1e-9 * np.eye(3)).tolist()}, "is no covariance"),
        ({"pairs": 3}, "pairs is no list of names"),
    ],
)
def test_a_damaged_reference_is_refused_by_what_is_wrong(change, words):
    sound = {"R": np.eye(3).tolist(), "T_direction": [-1.0, 0.0, 0.0], "pairs": ["0"]}
    sound |= {"random_rotation_covariance_rad2": (1e-9 * np.eye(3)).tolist()}
    assert np.array_equal(reference_values(sound)[0], np.eye(3))
    if isinstance(change, str):
        change = {key: value for key, value in sound.items() if key != change}
    elif isinstance(change, dict):
        change = sound | change
    with pytest.raises(DataError, match=f"reference is damaged: .*{words}.*; write it anew"):
        reference_values(change)
