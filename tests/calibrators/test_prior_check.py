"""A prior that is not of this rig is refused or said, one that is passes; and what is no information is refused."""

from dataclasses import replace

import numpy as np
import pytest

import binocal
from binocal import RigPrior
from binocal.boards import parse_board
from binocal.calibrators import joint, prior_check
from binocal.calibrators.prior_check import Disagreement, check_disagreement
from binocal.cameras import Camera
from binocal.errors import InconsistentViewsError
from binocal.geometry import SE3
from binocal.simulation import sample_scene, simulate_detections, table2_rig

BOARD = parse_board("chessboard:8x6:30mm")
RIG = table2_rig()


def corners(rig, n_views, seed):
    rng = np.random.default_rng(seed)
    return simulate_detections(sample_scene(rig, BOARD, n_views, rng), rng, noise_px=0.2)


def solved(detections, **options):
    return binocal.calibrate(detections, model="brown4", calibrator="lm", **options)


def refocused(factor):
    def camera(old):
        return Camera(old.model, old.size_wh, old.parameters * np.where(np.arange(9) < 2, factor, 1.0))

    return replace(RIG, left=camera(RIG.left), right=camera(RIG.right))


def widened(factor):
    return replace(RIG, T_right_left=SE3(RIG.T_right_left.R, factor * RIG.T_right_left.t))


@pytest.fixture(scope="module")
def earlier():
    return solved(corners(RIG, 20, 1))


@pytest.mark.parametrize("rig", [refocused(1.1), refocused(2.0), widened(1.02), widened(1.2)])
def test_a_prior_of_another_rig_is_refused_by_name(rig, earlier):
    with pytest.raises(InconsistentViewsError, match="the prior contradicts the views") as caught:
        solved(corners(rig, 8, 4), prior=earlier)
    (found,) = caught.value.findings
    assert found.code == "prior-contradicted" and found.figures["difference_sigma"] > 5


def test_wrong_held_intrinsics_are_refused(earlier):
    known = RigPrior.from_calibration(earlier, held=("left", "right"))
    with pytest.raises(InconsistentViewsError, match="the prior contradicts"):
        solved(corners(refocused(1.1), 8, 4), prior=known)


def test_a_rig_that_changed_a_little_is_said_and_its_unchanged_part_is_not(earlier):
    changed = corners(widened(1.002), 8, 3)
    assert "prior-doubtful" in {found.code for found in solved(changed, prior=earlier).findings}
    cameras_only = RigPrior.from_calibration(earlier, parts=("left", "right"))
    assert solved(changed, prior=cameras_only).findings == ()


def test_the_same_rig_differs_by_chance_alone(earlier, monkeypatch):
    seen = []
    measured = prior_check.disagreement
    monkeypatch.setattr(joint, "disagreement", lambda *given: seen.append(measured(*given)) or seen[-1])
    for seed in range(25):
        assert solved(corners(RIG, 8, 100 + seed), prior=solved(corners(RIG, 8, 200 + seed))).findings == ()
    per_parameter = np.mean([found.statistic / found.freedom for found in seen])
    assert len(seen) == 25 and {found.freedom for found in seen} == {22}
    assert 0.8 < per_parameter < 1.25  # 25 x 22 degrees of freedom: 1.00 ± 0.06; measured over 150: 1.02


@pytest.mark.parametrize(
    ("statistic", "code"), [(22.0, None), (55.0, None), (65.0, "prior-doubtful"), (22 * 24.9, "prior-doubtful")]
)
def test_the_limits_are_chance_and_five_sigma(statistic, code):
    found = check_disagreement(Disagreement(statistic, 22))
    assert [f.code for f in found] == ([code] if code else [])
    with pytest.raises(InconsistentViewsError):
        check_disagreement(Disagreement(22 * 25.1, 22))


@pytest.mark.parametrize(
    "spoil",
    [
        lambda a: a * np.nan,
        lambda a: -a,
        lambda a: np.triu(a),
    ],
    ids=["not a number", "negative", "not symmetric"],
)
def test_what_is_no_information_is_refused(spoil, earlier):
    prior = RigPrior.from_calibration(earlier)
    with pytest.raises(ValueError, match="information of a prior"):
        replace(prior, information=spoil(prior.information))


def test_a_single_name_is_not_taken_letter_by_letter(earlier):
    one = RigPrior.from_calibration(earlier, held="left", parts="rotation")
    assert "left.fx" in one.held and all(name.startswith("rotation") for name in one.names)
