"""Cameras that turn before a rectangle: the angles, what is said of them, and pairs that do not fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import TypeCheckError

import binocal
from binocal.errors import (
    DataError,
    DegenerateGeometryError,
    FormatError,
    InconsistentViewsError,
    NotConvergedError,
    OutputExistsError,
)
from binocal.evidence.rectangles import RectanglePairs
from binocal.formats.rectangles_npz import read_rectangles, write_rectangles
from binocal.geometry import so3
from binocal.simulation.turning import TurningOptions, simulate_turning, turning_rig
from binocal.solvers.prior import RigPrior
from binocal.solvers.turning_cameras import rig_at, rig_by_angles, solve_pair
from contracts import choices_for, solve

RIG = turning_rig()
EXACT = RigPrior(RIG, (), np.zeros((0, 0)), ())


def scene(n=6, seed=0, **options):
    return simulate_turning(RIG, n, np.random.default_rng(seed), TurningOptions(**options))


def calibrate(pairs, **choices):
    return binocal.calibrate(pairs, calibrator="rectangles", **{"prior": EXACT, **choices})


def errors(made, truth, pair=-1):
    T = made.rig.T_right_left
    return np.r_[so3.log(T.R @ truth.T_right_left.R[pair].T), T.t - truth.T_right_left.t[pair]]


def test_the_derivative_by_the_angles():
    # central differences of step 1e-6 rad: truncation 1e-12, rounding 1e-10; 2e-10 measured
    angles = np.array([[0.1, -0.05], [-0.07, 0.03]])
    J = rig_by_angles(RIG, angles)
    for k in range(4):
        step = np.eye(4)[k].reshape(2, 2) * 1e-6
        ahead, behind = rig_at(RIG, angles + step), rig_at(RIG, angles - step)
        numeric = np.r_[so3.log(ahead.R @ behind.R.T), ahead.t - behind.t] / 2e-6
        assert np.abs(numeric - J[:, k]).max() < 1e-8


def test_exact_corners_give_the_exact_rig():
    truth = scene(4, noise_px=0.0, attitude_sigma_deg=2.0)
    made = calibrate(truth.pairs, options={"noise_px": 0.01})
    e = errors(made, truth)
    # the attitude of 2 degrees still pulls: by its weight, 1e-9 of the corners'
    assert np.degrees(np.linalg.norm(e[:3])) < 1e-4 and np.linalg.norm(e[3:]) < 1e-6
    assert [row["name"] for row in made.provenance["rectangles"]["pairs"]] == list(truth.pairs.names)


@pytest.mark.parametrize("is_always_another", [False, True])
def test_errors_are_as_large_as_stated(is_always_another):
    scores = []
    for seed in range(12):
        truth = scene(3, seed, attitude_sigma_deg=0.5, is_always_another=is_always_another)
        pairs = truth.pairs.in_one_turn()
        known = None
        for i in range(3):
            px = np.stack([pairs.left_px[i], pairs.right_px[i]])
            attitude = np.stack([pairs.left_attitude_rad[i], pairs.right_attitude_rad[i]])
            known = None if is_always_another else known
            made = solve_pair(RIG, px, attitude, float(pairs.attitude_sigma_rad[i]), 0.3, known)
            known = made.rectangle
        e = (made.angles_rad - truth.angles_rad[2]).ravel()
        scores.append(e @ np.linalg.solve(made.covariance[:4, :4], e) / 4)
    # 12 x 4 standard normals: the mean square scatters by 0.2; 1.0 to 1.3 over 200 pairs, measured
    assert 0.4 < np.mean(scores) < 1.7


def test_the_priors_uncertainty_is_passed_on():
    truth = scene(3)
    plain, wide = calibrate(truth.pairs), calibrate(truth.pairs, **choices_for("rectangles"))
    assert wide.covariance.names[:2] == ("left.fx", "right.cy") and len(plain.covariance.names) == 6
    assert wide.covariance.sigma["left.fx"] == pytest.approx(0.3)
    for name in ("rotation.x", "translation.x"):
        assert wide.covariance.sigma[name] > plain.covariance.sigma[name]
    # a metre of baseline more by 0.2 mm is a translation longer by as much, nothing else tells its length
    assert wide.baseline_sigma_m == pytest.approx(2e-4, rel=0.15)


def test_any_corner_first_and_either_turn():
    truth = scene(3)
    left, right = truth.pairs.left_px.copy(), truth.pairs.right_px.copy()
    left[1], right[1] = np.roll(left[1], 1, axis=0), right[1][::-1]
    right[2] = np.roll(right[2], 2, axis=0)
    other = calibrate(replace(truth.pairs, left_px=left, right_px=right))
    made = calibrate(truth.pairs)
    assert np.array_equal(made.rig.T_right_left.R, other.rig.T_right_left.R)


def test_a_pair_of_another_rectangle_is_left_out_by_name():
    truth, other = scene(6, 3), scene(6, 4)
    left, right = truth.pairs.left_px.copy(), truth.pairs.right_px.copy()
    left[2], right[2] = other.pairs.left_px[2], other.pairs.right_px[2]
    made = calibrate(replace(truth.pairs, left_px=left, right_px=right))
    assert [view.name for view in made.rejected] == ["2"] and "another rectangle" in made.rejected[0].reason
    assert len(made.views) == 5 and np.degrees(np.linalg.norm(errors(made, truth)[:3])) < 0.1


def test_what_is_left_of_nothing_is_an_error():
    truth, other = scene(1, 3), scene(1, 4)
    mixed = replace(truth.pairs, right_px=other.pairs.right_px[:, [0, 1, 3, 2]][:, [0, 1, 3, 2]] + [0, 300.0])
    with pytest.raises(NotConvergedError, match="none of the 1 pairs fits a rectangle"):
        calibrate(mixed, options={"noise_px": 0.3})


def test_a_far_small_rectangle_and_a_rough_attitude_are_refused():
    truth = scene(
        1, size_m=(0.1, 0.15), distance_m=(7, 8), attitude_sigma_deg=3.0, starts_at_rest=False, is_always_another=True
    )
    with pytest.raises(DegenerateGeometryError, match="keep the rectangle in view"):
        calibrate(truth.pairs, options={"noise_px": 0.3})


def wrongly(change):
    """Five pairs, whose angles are 6 degrees and their stated standard deviation 1 degree, with something exchanged."""
    pairs = scene(5, 5).pairs
    swapped = {
        "nothing": {},
        "sigma of zero": {"attitude_sigma_rad": np.zeros(5)},
        "sigma of a tenth": {"attitude_sigma_rad": pairs.attitude_sigma_rad / 10},
        "radians": {f"{s}_attitude_rad": np.radians(getattr(pairs, f"{s}_attitude_rad")) for s in ("left", "right")},
        "signs": {f"{s}_attitude_rad": -getattr(pairs, f"{s}_attitude_rad") for s in ("left", "right")},
        "yaw and pitch": {f"{s}_attitude_rad": getattr(pairs, f"{s}_attitude_rad")[:, ::-1] for s in ("left", "right")},
        "attitudes": {"left_attitude_rad": pairs.right_attitude_rad, "right_attitude_rad": pairs.left_attitude_rad},
        "corners": {"left_px": pairs.right_px, "right_px": pairs.left_px},
        "shuffled": {"right_px": np.roll(pairs.right_px, 2, axis=0)},
        "rows first": {"left_px": pairs.left_px[..., ::-1], "right_px": pairs.right_px[..., ::-1]},
        "offset": {"left_px": pairs.left_px + [400.0, 0.0]},
    }
    return replace(pairs, **swapped[change])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            "sigma of zero",
            r"are stated to 0 deg \(5 of 5 pairs would fit\); state the sensor's true standard deviation",
        ),
        ("sigma of a tenth", r"are stated to 0.1 deg .*state the sensor's true standard deviation"),
        ("radians", "look like radians"),
        ("signs", "of the opposite sign"),
        ("yaw and pitch", "yaw and pitch look exchanged"),
        ("attitudes", "those of left and right look exchanged"),
        ("shuffled", r"attitudes lie .* deg from the angles"),
        (
            "corners",
            r"better than .* px, and to 0.\d+ px when read another way: those of left and right look exchanged",
        ),
    ],
)
def test_numbers_that_contradict_each_other_are_refused(change, said):
    assert not calibrate(wrongly("nothing")).findings
    with pytest.raises(InconsistentViewsError, match=said):
        calibrate(wrongly(change))


def test_corners_outside_their_image_are_refused():
    with pytest.raises(DataError, match=r"left corner \d at .* outside the 1280x1024 image .*check that the prior"):
        calibrate(wrongly("offset"))
    pairs = wrongly("rows first")
    moved = pairs.left_px[0].copy()
    moved[:, 1] += 1030 - moved[:, 1].max()  # beyond the image's height, not its width
    with pytest.raises(DataError, match="x and y look exchanged: give columns before rows"):
        calibrate(replace(pairs, left_px=np.concatenate([moved[None], pairs.left_px[1:]])))


def test_attitudes_half_as_good_as_stated_count_less():
    truth = scene(12, attitude_sigma_deg=2.0)
    stated = replace(truth.pairs, attitude_sigma_rad=truth.pairs.attitude_sigma_rad / 2)
    made = calibrate(stated)
    (found,) = made.findings
    assert found.code == "attitudes-less-certain" and 1.5 < found.figures["off_deg"] < 2.6
    right = calibrate(replace(stated, attitude_sigma_rad=np.where(stated.attitude_sigma_rad > 0, np.radians(2.0), 0.0)))
    assert made.covariance.sigma["rotation.y"] == pytest.approx(right.covariance.sigma["rotation.y"], rel=0.1)


def test_pairs_of_different_rectangles_under_one_number_are_refused():
    pairs, others = scene(4, 3).pairs, [scene(4, seed).pairs for seed in (4, 6, 7)]
    left, right = pairs.left_px.copy(), pairs.right_px.copy()
    for i, other in enumerate(others, start=1):
        left[i], right[i] = other.left_px[i], other.right_px[i]
    with pytest.raises(InconsistentViewsError, match="each pair looks as if it shows a rectangle of its own"):
        calibrate(replace(pairs, left_px=left, right_px=right))


def test_corners_on_a_line_are_named():
    truth = scene(2)
    left = truth.pairs.left_px.copy()
    left[1] = left[1][[0, 2, 1, 3]]  # crosses itself
    with pytest.raises(DataError, match="pair 1: the left corners lie on a line or cross"):
        replace(truth.pairs, left_px=left)


def test_the_file_comes_back_and_bad_ones_are_named(tmp_path):
    pairs, path = scene(3).pairs, tmp_path / "corners.npz"
    write_rectangles(path, pairs)
    read = read_rectangles(path)
    for name in ("left_px", "right_px", "rectangle"):
        assert np.array_equal(getattr(read, name), getattr(pairs, name))
    assert np.abs(read.attitude_sigma_rad - pairs.attitude_sigma_rad).max() < 1e-15
    with pytest.raises(OutputExistsError):
        write_rectangles(path, pairs)
    np.savez(path, left_px=pairs.left_px)
    with pytest.raises(FormatError, match="no array 'right_px'"):
        read_rectangles(path)
    one = {name: np.asarray(value) for name, value in np.load(_written(tmp_path, pairs)).items()}
    np.savez(path, **one | {"attitude_sigma_deg": np.array(0.5)})
    assert np.allclose(read_rectangles(path).attitude_sigma_rad, np.radians(0.5))
    np.savez(path, **one | {"rectangle": np.array([0, 0.5, 1])})
    with pytest.raises(FormatError, match="whole numbers"):
        read_rectangles(path)
    for name, value in (("left_px", np.ones(3)), ("left_attitude_deg", np.full((3, 2), np.nan))):
        np.savez(path, **one | {name: value})
        with pytest.raises((FormatError, TypeCheckError), match=r"usable rectangles|type"):
            read_rectangles(path)
    np.savez(path, **one | {"attitude_sigma_deg": np.array(-1.0)})
    with pytest.raises(FormatError, match=r"attitude_sigma_deg must be 0 or more; write it .* several\.$"):
        read_rectangles(path)
    np.savez(path, **one | {"left_px": one["left_px"][:, [0, 2, 1, 3]]})
    with pytest.raises(FormatError, match=r"in turn around the rectangle\.$"):
        read_rectangles(path)
    path.write_bytes(b"PK\x03\x04 nonsense")
    with pytest.raises(FormatError, match="not a whole NumPy archive"):
        read_rectangles(path)


def _written(folder, pairs):
    write_rectangles(folder / "good.npz", pairs)
    return folder / "good.npz"


def test_other_kinds_of_evidence_are_named():
    with pytest.raises(ValueError, match="needs a prior"):
        binocal.calibrate(scene(2).pairs, calibrator="rectangles")
    with pytest.raises(ValueError, match="cameras of the prior, not fisheye4"):
        calibrate(scene(2).pairs, model="fisheye4")
    with pytest.raises(TypeError, match="Detections of a board; got RectanglePairs"):
        solve("lm", scene(2).pairs, model="auto")
    assert isinstance(scene(2).pairs, RectanglePairs)
