"""An earlier calibration as a prior: half and half is the whole, what is held stays, what is tight wins."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

import binocal
from binocal import RigPrior
from binocal.boards import parse_board
from binocal.cameras import CAMERA_MODELS, camera_model
from binocal.errors import DataError
from binocal.geometry import SE3, so3
from binocal.result import Covariance
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig
from binocal.simulation.rigs import random_rig
from binocal.solvers.board_views import BundleEstimate, BundleProblem, CameraObservations

BOARD = parse_board("chessboard:11x8:20mm")


def recording(seed, n_views=20, rig=None, noise_px=0.2):
    rng = np.random.default_rng(seed)
    rig = rig or table2_rig()
    scene = StereoScene(rig, BOARD, sample_board_poses(rig, BOARD, n_views, rng))
    return scene, simulate_detections(scene, rng, noise_px=noise_px)


def solved(detections, **request):
    model = request.pop("model", "brown4")
    return binocal.calibrate(detections, calibrator="lm", model=model, **request)


def offset(a, b):
    """The rig ``a`` less the rig ``b`` in the order and the coordinates of ``a``'s covariance."""
    values = {}
    for side in ("left", "right"):
        one, other = getattr(a.rig, side), getattr(b.rig, side)
        names = CAMERA_MODELS[one.model].parameter_names
        values |= {f"{side}.{n}": d for n, d in zip(names, one.parameters - other.parameters, strict=True)}
    turn = so3.log(a.rig.T_right_left.R @ b.rig.T_right_left.R.T)
    shift = a.rig.T_right_left.t - b.rig.T_right_left.t
    values |= {f"{p}.{x}": v[i] for p, v in (("rotation", turn), ("translation", shift)) for i, x in enumerate("xyz")}
    return np.array([values[name] for name in a.covariance.names])


@pytest.mark.parametrize("model", ["brown4", "brown8"])
def test_half_the_views_with_the_other_half_as_prior_give_what_all_of_them_give(model):
    rig = random_rig(np.random.default_rng(4), model)
    first, second, whole = (recording(0, 30, rig)[1].select(np.arange(*span)) for span in ((15,), (15, 30), (30,)))
    together = solved(whole, model=model)
    apart = solved(second, model=model)
    posterior = solved(second, model=model, prior=solved(first, model=model))
    sigma = np.sqrt(np.diag(together.covariance.matrix))
    away = np.abs(offset(posterior, together)) / sigma
    # measured: 0.08 sigma (brown4) and 0.14 (brown8); half of the views alone lie 1.8 sigma off and more
    assert away.max() < 0.3 and np.abs(offset(apart, together) / sigma).max() > 1
    # measured: 2 %; brown8's coefficients trade against each other along a bent valley, where a Gaussian is a third too narrow
    is_plain = np.array([model == "brown4" or not re.search(r"\.k\d$", name) for name in together.covariance.names])
    ratio = np.sqrt(np.diag(posterior.covariance.matrix)) / sigma
    assert np.abs(ratio - 1)[is_plain].max() < 0.05


def test_held_intrinsics_come_out_as_they_were_and_have_no_covariance():
    earlier = solved(recording(1)[1])
    known = RigPrior.from_calibration(earlier, parts=("left", "right"), held=("left", "right"))
    found = solved(recording(2)[1], prior=known)
    for side in ("left", "right"):
        assert np.array_equal(getattr(found.rig, side).parameters, getattr(earlier.rig, side).parameters)
    assert found.covariance.names == tuple(f"{part}.{axis}" for part in ("rotation", "translation") for axis in "xyz")
    assert not np.array_equal(found.rig.T_right_left.t, earlier.rig.T_right_left.t)
    # the noise of six unknowns is far below that of the whole problem
    assert found.covariance.sigma["rotation.y"] < 0.2 * solved(recording(2)[1]).covariance.sigma["rotation.y"]
    assert found.provenance["options"]["prior"]["held"][0] == "left.fx"


@pytest.mark.parametrize(
    "held", [("rotation",), ("translation",), ("rotation", "translation"), ("left", "translation")]
)
@pytest.mark.parametrize("is_informed", [False, True])
def test_any_part_of_the_rig_is_held_exactly(held, is_informed):
    scene, detections = recording(3)
    earlier = replace(solved(detections), rig=scene.rig)
    known = RigPrior.from_calibration(
        earlier, parts=("right", "rotation", "translation") if is_informed else (), held=held
    )
    found = solved(recording(4)[1], prior=known)
    T, exact = found.rig.T_right_left, scene.rig.T_right_left
    assert np.array_equal(T.R, exact.R) == ("rotation" in held)
    assert np.array_equal(T.t, exact.t) == ("translation" in held)
    assert np.array_equal(found.rig.left.parameters, scene.rig.left.parameters) == ("left" in held)
    assert {name.split(".")[0] for name in found.covariance.names}.isdisjoint(held)
    error = offset(found, earlier) / np.sqrt(np.diag(found.covariance.matrix))
    assert np.abs(error).max() < 4


def test_single_parameters_are_held_by_name():
    earlier = solved(recording(1)[1])
    known = RigPrior.from_calibration(earlier, parts=(), held=("left.fx", "right.k1"))
    found = solved(recording(2)[1], prior=known)
    assert found.rig.left.parameters[0] == earlier.rig.left.parameters[0]
    assert found.rig.left.parameters[1] != earlier.rig.left.parameters[1]
    assert not {"left.fx", "right.k1"} & set(found.covariance.names)


def test_a_tight_prior_wins_and_a_loose_one_says_nothing():
    detections = recording(2)[1]
    alone, earlier = solved(detections), solved(recording(1)[1])
    tight = replace(earlier, covariance=Covariance(earlier.covariance.names, 1e-6 * earlier.covariance.matrix))
    loose = replace(earlier, covariance=Covariance(earlier.covariance.names, 1e6 * earlier.covariance.matrix))
    sigma = np.sqrt(np.diag(alone.covariance.matrix))
    assert np.abs(offset(solved(detections, prior=tight), earlier) / sigma).max() < 1e-3
    assert np.abs(offset(solved(detections, prior=loose), alone) / sigma).max() < 0.02  # the stop rule leaves 0.01
    assert np.abs(offset(alone, earlier) / sigma).max() > 1


def test_what_is_informed_can_be_a_part():
    # a camera on another mount: the intrinsics are known, the rig is new
    earlier = solved(recording(1)[1])
    moved = replace(table2_rig(), T_right_left=SE3(so3.exp(np.array([0.02, 0.03, 0.0])), np.array([-0.1, 0.0, 0.01])))
    _, detections = recording(2, rig=moved)
    found = solved(detections, prior=RigPrior.from_calibration(earlier, parts=("left", "right")))
    error = offset(found, replace(found, rig=moved)) / np.sqrt(np.diag(found.covariance.matrix))
    assert np.abs(error).max() < 4
    alone = solved(detections).covariance.sigma
    assert all(found.covariance.sigma[name] < alone[name] for name in ("left.fx", "right.fy", "rotation.y"))


@pytest.mark.usefixtures("unchecked_types")
def test_errors_are_covered_with_a_prior():
    # 30 recordings, each with the prior of another one: standardised errors of all parameters; measured 0.71 and 0.97
    truth = table2_rig()
    errors = []
    for seed in range(30):
        posterior = solved(recording(100 + seed, 8)[1], prior=solved(recording(200 + seed, 8)[1]))
        errors.append(offset(posterior, replace(posterior, rig=truth)) / np.sqrt(np.diag(posterior.covariance.matrix)))
    # parameters of one recording move together, so 30 recordings know the share to 0.04
    assert np.mean(np.abs(errors) < 1) == pytest.approx(0.683, abs=0.08)
    assert np.mean(np.abs(errors) < 2) == pytest.approx(0.954, abs=0.05)


def test_the_gradient_is_the_slope_of_the_energy():
    # central differences, h = 1e-6 of each shared unknown; the prior is some degrees off so that the turn is curved
    scene, detections = recording(0, 5)
    T = scene.rig.T_right_left
    away = replace(scene.rig, T_right_left=SE3(so3.exp(np.array([0.3, -0.2, 0.1])) @ T.R, T.t + [0.01, 0.02, -0.03]))
    prior = RigPrior.from_rig(away, solved(recording(1)[1]).covariance)
    cameras = [
        CameraObservations.from_corners(CAMERA_MODELS["brown4"], px) for px in (detections.left_px, detections.right_px)
    ]
    problem = prior.applied(BundleProblem(np.ascontiguousarray(detections.object_points_m.T), tuple(cameras)))
    estimate = BundleEstimate.of_rig(scene.rig, scene.T_left_board)
    (term,) = problem.terms
    _, gradient = term.normal_equations(problem, estimate)
    step = problem.solve_step(estimate, problem.linearize(estimate, np.asarray(1.0), "squared"), np.zeros(()))
    for i in range(problem.n_shared):
        shared, h = np.zeros(problem.n_shared), 1e-6
        energies = []
        for sign in (1, -1):
            shared[i] = sign * h
            energies.append(
                term.energy(problem, problem.retract(estimate, replace(step, shared=shared, views=0 * step.views)))
            )
        assert gradient[i] == pytest.approx(
            -(energies[0] - energies[1]) / (2 * h), rel=1e-4, abs=1e-7 * np.abs(gradient).max()
        )


def test_the_information_adds_to_that_of_the_views():
    scene, detections = recording(0, 5)
    prior = RigPrior.from_calibration(solved(recording(1)[1]))
    cameras = [
        CameraObservations.from_corners(CAMERA_MODELS["brown4"], px) for px in (detections.left_px, detections.right_px)
    ]
    plain = BundleProblem(np.ascontiguousarray(detections.object_points_m.T), tuple(cameras))
    problem = prior.applied(plain)
    estimate = BundleEstimate.of_rig(scene.rig, scene.T_left_board)
    scale = np.asarray(0.7)
    equations = problem.linearize(estimate, scale, "squared")
    information, _ = problem.terms[0].normal_equations(problem, estimate)
    expected = plain.shared_information(estimate, equations) + scale**2 * information
    np.testing.assert_allclose(problem.shared_information(estimate, equations), expected, rtol=1e-9)
    assert np.abs(np.triu(information, 1)).max() > 0


def test_a_prior_about_other_cameras_is_refused():
    earlier, detections = solved(recording(1)[1]), recording(2)[1]
    with pytest.raises(DataError, match="brown4, the calibration's brown5"):
        solved(detections, model="brown5", prior=earlier)
    smaller = replace(detections, left_size_wh=(2000, 1500))
    with pytest.raises(DataError, match="left images"):
        solved(smaller, prior=earlier)
    with pytest.raises(DataError, match="metres"):
        solved(replace(detections, is_metric=False), prior=earlier)
    assert solved(detections, model="auto", prior=earlier).rig.left.model == "brown4"


def test_parts_and_names_that_no_rig_has_are_refused():
    earlier = solved(recording(1)[1])
    with pytest.raises(ValueError, match="no part 'baseline'"):
        RigPrior.from_calibration(earlier, parts=("baseline",))
    with pytest.raises(ValueError, match=r"no 'left\.k9' to hold"):
        RigPrior.from_calibration(earlier, held=("left.k9",))
    singular = Covariance(earlier.covariance.names, np.ones(earlier.covariance.matrix.shape))
    with pytest.raises(ValueError, match="singular"):
        RigPrior.from_rig(earlier.rig, singular)


def test_a_models_weak_prior_does_not_count_again():
    rig = random_rig(np.random.default_rng(4), "brown8")
    _, detections = recording(0, 12, rig)
    before = solved(detections, model="brown8")
    problem = BundleProblem(
        np.ascontiguousarray(detections.object_points_m.T),
        tuple(
            CameraObservations.from_corners(camera_model("brown8"), px)
            for px in (detections.left_px, detections.right_px)
        ),
    )
    assert all(camera.prior_precision.any() for camera in problem.cameras)
    left_only = RigPrior.from_calibration(before, parts=("left",)).applied(problem)
    assert not left_only.cameras[0].prior_precision.any() and left_only.cameras[1].prior_precision.any()


@pytest.mark.usefixtures("unchecked_types")
def test_a_prior_that_is_none_is_refused():
    _, detections = recording(0, 6)
    with pytest.raises(TypeError, match="StereoCalibration or a RigPrior"):
        solved(detections, prior="rig.json")
