"""The problem with the board's points and the exposures free: its gradients, what it finds, and what it leaves alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from binocal import calibrate
from binocal.boards import parse_board
from binocal.calibrators import board_and_exposures
from binocal.calibrators.base import CalibrationRequest
from binocal.calibrators.board_and_exposures import solve_real_views
from binocal.calibrators.summary import joint_problem
from binocal.evidence import Detections
from binocal.geometry import so3
from binocal.simulation import StereoScene, random_rig, sample_board_poses
from binocal.solvers.board_shape import describe_shape
from binocal.solvers.board_views import BundleEstimate
from binocal.solvers.exposures import board_centres, compare_with_cameras_alone
from binocal.solvers.jackknife import excess_of_scores, shifts_without, student_factor
from binocal.solvers.joint_system import reduce, solve_symmetric
from binocal.solvers.minimization import minimize
from binocal.solvers.real_views import RealViewsEstimate, RealViewsProblem, RealViewsStep
from binocal.solvers.shape_model import ShapeModel, hidden_directions

BOARD = parse_board("chessboard:9x6:32.5mm")
NOISE_PX = 0.1


def recording(seed, n_views=12, *, points_m=None, moved=(0.0, 0.0), noise_px=NOISE_PX, model="brown4"):
    """A random rig's corners of a board that may be bent, while the board moves between the exposures."""
    rng = np.random.default_rng(seed)
    rig = random_rig(rng, model)
    scene = StereoScene(rig, BOARD, sample_board_poses(rig, BOARD, n_views, rng))
    points = BOARD.object_points_m if points_m is None else points_m
    in_left = scene.T_left_board.apply(points)
    in_right = rig.T_right_left.apply(in_left)
    centre = in_right.mean(axis=1, keepdims=True)
    turn = so3.exp(rng.normal(0, 1, (n_views, 3)) * moved[0])
    shift = rng.normal(0, 1, (n_views, 1, 3)) * moved[1]
    in_right = np.einsum("vij,vnj->vni", turn, in_right - centre) + centre + shift
    pixels = []
    for camera, inside in ((rig.left, in_left), (rig.right, in_right)):
        px = camera.project(inside) + rng.normal(0, noise_px, (n_views, len(points), 2))
        px[((px < 0) | (px > np.array(camera.size_wh) - 1)).any(axis=-1)] = np.nan
        pixels.append(px)
    sizes = {"right_image_size_wh": rig.right.size_wh}
    return scene, Detections.from_arrays(BOARD.object_points_m, *pixels, rig.left.size_wh, **sizes)


def bowed(height_m):
    points = BOARD.object_points_m.copy()
    x = points[:, 0] - points[:, 0].mean()
    points[:, 2] += height_m * (1 - (x / np.abs(x).max()) ** 2)
    return points


def stretched(share):
    points = BOARD.object_points_m.copy()
    points[:, 0] *= 1 + share
    return points


def nominal_of(detections, model="brown4"):
    calibration = calibrate(detections, model=model, calibrator="lm", board_shape="flat", exposure="together")
    problem = joint_problem(calibration.corners.detections, CalibrationRequest(model=model))
    start = BundleEstimate.of_rig(calibration.rig, calibration.corners.T_left_board)
    return problem, minimize(problem, start)


def offset_of(calibration, rig):
    """Parameters less the truth, in the covariance's order."""
    values = [
        *(c.parameters[np.r_[0:4, 5 : len(c.parameters)]] for c in (calibration.rig.left, calibration.rig.right)),
        so3.log(calibration.rig.T_right_left.R @ rig.T_right_left.R.T),
        calibration.rig.T_right_left.t,
    ]
    truth = [
        *(c.parameters[np.r_[0:4, 5 : len(c.parameters)]] for c in (rig.left, rig.right)),
        np.zeros(3),
        rig.T_right_left.t,
    ]
    return np.concatenate(values) - np.concatenate(truth)


def test_the_gradient_is_that_of_the_cost():
    _, detections = recording(1, 6)
    problem, minimum = nominal_of(detections)
    rng = np.random.default_rng(0)
    n_views, m = detections.n_views, 3 * len(BOARD.object_points_m)
    centres = board_centres(RealViewsProblem(problem), RealViewsProblem(problem).start(minimum.estimate))
    real = RealViewsProblem(problem, np.eye(m) * 1e6, (1e-2, 1e-3), centres)
    start = real.start(minimum.estimate)
    deviations = rng.normal(0, 0.02, (n_views, 6)) * [1, 1, 1, 0.1, 0.1, 0.1]
    estimate = RealViewsEstimate(start.bundle, start.points + rng.normal(0, 3e-4, start.points.shape), deviations)
    scale = np.array(0.2)
    system = real.system(estimate, real.linearize(estimate, scale, "squared"))
    gradient = np.concatenate([system.shared_gradient.sum(axis=0), system.points_gradient.sum(axis=0)])
    gradient += system.prior_gradient
    for part in ("shared", "points", "pose", "deviation"):
        shared = rng.normal(size=system.n_shared) * 1e-7 * (part == "shared")
        points = rng.normal(size=m) * 1e-7 * (part == "points")
        own = rng.normal(size=(n_views, 12)) * 1e-7
        own[:, :6] *= part == "pose"
        own[:, 6:] *= part == "deviation"

        def cost(sign, shared=shared, points=points, own=own):
            moved = real.retract(estimate, RealViewsStep(sign * shared, sign * points, sign * own, np.array(0.0)))
            return real.linearize(moved, scale, "squared").cost_px2

        predicted = -(gradient @ np.r_[shared, points] + np.sum(system.own_gradient * own))
        assert (cost(1) - cost(-1)) / 2 == pytest.approx(predicted, rel=1e-5)


@pytest.mark.parametrize("has_points", [False, True])
@pytest.mark.parametrize("deviates", [False, True])
def test_the_compiled_reduction_is_the_plain_one(has_points, deviates):
    _, detections = recording(3, 9)
    problem, minimum = nominal_of(detections)
    rng = np.random.default_rng(0)
    real = RealViewsProblem(problem)
    estimate = real.start(minimum.estimate)
    if has_points:
        real = replace(real, shape_information=np.eye(3 * len(BOARD.object_points_m)) * 1e7)
    if deviates:
        real = replace(real, deviation_sigma=(1e-2, 1e-3), centres=board_centres(real, estimate))
        estimate = replace(estimate, deviations=rng.normal(0, 1e-3, (9, 6)))
    seen = problem.cameras[1].is_seen.copy()
    seen[4] = False  # a view of the left camera alone: its deviation is its prior
    cameras = (problem.cameras[0], replace(problem.cameras[1], is_seen=seen))
    real = replace(real, nominal=replace(problem, cameras=cameras))
    equations = real.linearize(estimate, np.array(0.2), "squared")
    for growth in (1.0, 1.7):
        compiled, plain = real.reduced(estimate, equations, growth), reduce(real.system(estimate, equations), growth)
        size = np.sqrt(np.diagonal(plain.information))
        np.testing.assert_allclose(
            compiled.information / np.outer(size, size), plain.information / np.outer(size, size), atol=1e-9
        )
        for name in ("gradient", "own_gradient", "own_diagonal", "view_scores", "y"):
            ours, theirs = getattr(compiled, name), getattr(plain, name)
            np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=1e-7 * np.abs(theirs).max())
        lost = [np.einsum("ivp,jvp->ij", r.Y, r.Y) / np.outer(size, size) for r in (compiled, plain)]
        np.testing.assert_allclose(*lost, atol=1e-9)
        own = [r.own_step(np.ones(r.n_all) * 1e-3 / size) for r in (compiled, plain)]
        np.testing.assert_allclose(*own, rtol=1e-5, atol=1e-9 * np.abs(own[1]).max())
        k = plain.n_shared
        np.testing.assert_allclose(
            compiled.view_information / np.outer(size[:k], size[:k]),
            plain.view_information / np.outer(size[:k], size[:k]),
            atol=1e-9,
        )


def test_definite_equations_are_solved_and_others_named():
    rng = np.random.default_rng(0)
    for z, r in ((1, 1), (7, 3), (70, 40)):
        A = rng.normal(size=(z, z))
        A = A @ A.T + z * np.eye(z)
        b = rng.normal(size=(z, r))
        np.testing.assert_allclose(solve_symmetric(A, b), np.linalg.solve(A, b), rtol=1e-10, atol=1e-12)
    assert np.isnan(solve_symmetric(np.array([[1.0, 2.0], [2.0, 1.0]]), np.ones(2))).all()
    assert np.isnan(solve_symmetric(np.array([[np.nan, 0.0], [0.0, 1.0]]), np.ones(2))).all()


def test_without_anything_freed_the_shared_equations_are_those_of_the_nominal_problem():
    _, detections = recording(2)
    problem, minimum = nominal_of(detections)
    real = RealViewsProblem(problem)
    estimate = real.start(minimum.estimate)
    equations = real.linearize(estimate, minimum.scale_px, "hampel")
    ours = real.shared_information(estimate, equations)
    theirs = problem.shared_information(minimum.estimate, minimum.equations)
    size = np.sqrt(np.diagonal(theirs))
    np.testing.assert_allclose(ours / np.outer(size, size), theirs / np.outer(size, size), atol=1e-9)
    ours, theirs = (p.solve_step(e, q, np.array(0.5)) for p, e, q in (
        (real, estimate, equations), (problem, minimum.estimate, minimum.equations)
    ))  # fmt: skip
    np.testing.assert_allclose(ours.shared, theirs.shared, rtol=1e-4, atol=1e-12)
    np.testing.assert_allclose(ours.own, theirs.views, rtol=1e-3, atol=1e-12)
    assert float(ours.predicted_px2) == pytest.approx(float(theirs.predicted_px2), rel=1e-4, abs=1e-12)


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_a_flat_board_stays_as_drawn(seed):
    _, detections = recording(seed)
    calibration = calibrate(detections, model="brown4")
    assert calibration.board_shape is None and not calibration.exposure.are_apart
    assert calibration.exposure.ratio == pytest.approx(1, abs=0.03)
    plain = calibrate(detections, model="brown4", board_shape="flat", exposure="together")
    np.testing.assert_array_equal(calibration.rig.T_right_left.t, plain.rig.T_right_left.t)


@pytest.mark.parametrize("n_views", [6, 20])
def test_half_a_millimetre_of_bow_is_measured_and_does_no_harm(n_views):
    distances, held, nearness = [], [], []
    for seed in range(4):
        scene, detections = recording(seed, n_views, points_m=bowed(0.5e-3))
        calibration = calibrate(detections, model="brown4")
        shape = calibration.board_shape
        # the largest height less the smallest is biased upwards by the points' own noise
        assert abs(shape.bow_m - 0.5e-3) < 6 * shape.bow_sigma_m + 0.03e-3
        heights = shape.points_m[:, 2] - bowed(0.5e-3)[:, 2]
        nearness.append(np.sqrt(np.mean((heights - heights.mean()) ** 2)))
        for result, out in (
            (calibration, distances),
            (calibrate(detections, model="brown4", board_shape="flat"), held),
        ):
            away = offset_of(result, scene.rig)
            out.append(away @ np.linalg.solve(calibration.covariance.matrix, away) / len(away))
    assert np.sqrt(np.mean(distances)) < 1.3 < 1.8 < np.sqrt(np.mean(held))
    assert np.max(nearness) < 0.06e-3


def test_a_print_one_percent_wider_is_found():
    _, detections = recording(5, 20, points_m=stretched(0.01))
    shape = calibrate(detections, model="brown4").board_shape
    assert shape.stretch == pytest.approx(0.01, abs=4 * shape.stretch_sigma) and shape.stretch_sigma < 5e-4
    assert shape.scale_sigma > 1e-3  # a print that is off by 1 % one way may be off as much altogether


def test_warp_finds_a_bow_and_moves_no_point_elsewhere():
    _, detections = recording(6, 12, points_m=bowed(1e-3))
    shape = calibrate(detections, model="brown4", board_shape="warp").board_shape
    assert 0 < shape.scale_sigma < 0.01
    assert shape.bow_m == pytest.approx(1e-3, rel=0.1)
    x = BOARD.object_points_m[:, 0]
    for value in np.unique(x):  # a quadratic in x and y: along a column it is one in y alone
        column = shape.points_m[x == value]
        assert np.abs(np.polyfit(column[:, 1], column[:, 2], 2, full=True)[1]).max(initial=0) < 1e-12


@pytest.mark.parametrize("seed", [0, 1])
def test_exposures_apart_are_found_and_the_rig_is_as_good_as_together(seed):
    scene, detections = recording(seed, 20, moved=(1e-3, 0.5e-3))
    calibration = calibrate(detections, model="brown4")
    exposure = calibration.exposure
    assert exposure.are_apart and exposure.ratio > 2
    assert exposure.alone_px == pytest.approx(NOISE_PX, rel=0.1)
    assert exposure.turn_sigma_rad == pytest.approx(1e-3, rel=0.5)
    assert exposure.shift_sigma_m == pytest.approx(0.5e-3, rel=0.5)
    assert calibration.noise_px == pytest.approx(NOISE_PX, rel=0.1)
    together = calibrate(detections, model="brown4", exposure="together")
    truth = scene.rig.T_right_left.R
    angles = [so3.angle_rad(c.rig.T_right_left.R @ truth.T) for c in (calibration, together)]
    away = offset_of(calibration, scene.rig)
    assert angles[0] < angles[1] or angles[0] < 5e-4
    assert np.sqrt(away @ np.linalg.solve(calibration.covariance.matrix, away) / len(away)) < 1.6
    assert calibration.corners.T_right_board is not None


def test_motion_between_the_exposures_alone_does_not_bend_the_board():
    _, detections = recording(3, 12, moved=(2e-3, 1e-3))
    calibration = calibrate(detections, model="brown4")
    assert calibration.exposure.are_apart and calibration.board_shape is None


def test_a_board_that_is_as_drawn_again_is_solved_as_drawn():
    """It was held where the exposures had bent it, and its own corners were then not those of the calibration."""
    _, detections = recording(8, 8, moved=(2e-3, 1e-3))
    problem, minimum = nominal_of(detections)
    solve = solve_real_views(problem, minimum)
    assert solve.problem.shape_information is None and solve.problem.deviation_sigma is not None
    assert np.array_equal(solve.minimum.estimate.points, problem.object_points)
    calibration = calibrate(detections, model="brown4", calibrator="lm")
    assert calibration.board_shape is None
    assert replace(calibration, evidence=None).with_evidence(detections).evidence is not None


def test_leaving_a_view_out_moves_the_rig_as_the_equations_say():
    _, detections = recording(7, 10)
    for shape in ("flat", "free"):
        problem, minimum = nominal_of(detections)
        solve = solve_real_views(problem, minimum, board_shape=shape, exposure="together")
        shifts = shifts_without(solve.reduced, solve.problem.system(solve.minimum.estimate, solve.minimum.equations))
        sigma = 1 / np.sqrt(np.diagonal(solve.reduced.information)[: shifts.shape[1]]) * solve.noise_px
        for view in (0, 4):
            keep = np.arange(10) != view
            cameras = tuple(
                replace(c, pixels=c.pixels[keep], is_seen=c.is_seen[keep]) for c in solve.problem.nominal.cameras
            )
            nominal = replace(solve.problem.nominal, cameras=cameras)
            bundle = solve.minimum.estimate.bundle
            start = replace(
                solve.minimum.estimate,
                bundle=replace(bundle, T_left_board=bundle.T_left_board[keep]),
                deviations=np.zeros((9, 6)),
            )
            again = minimize(replace(solve.problem, nominal=nominal), start, scale_px=solve.minimum.scale_px)
            moved = np.r_[
                again.estimate.bundle.parameters[0][:4] - bundle.parameters[0][:4],
                again.estimate.bundle.parameters[1][:4] - bundle.parameters[1][:4],
            ]
            stated = np.r_[shifts[view, :4], shifts[view, 8:12]]
            error = np.abs(moved - stated) / np.r_[sigma[:4], sigma[8:12]]
            scale = np.abs(moved) / np.r_[sigma[:4], sigma[8:12]]
            assert error.max() < 0.2 * scale.max()


def test_the_series_of_the_jackknife_is_its_solution():
    _, detections = recording(8, 16)
    problem, minimum = nominal_of(detections)
    solve = solve_real_views(problem, minimum, board_shape="free", exposure="together")
    from binocal.solvers.jackknife import _by_series, _directly

    reduced, k = solve.reduced, solve.reduced.n_shared
    system = solve.problem.system(solve.minimum.estimate, solve.minimum.equations)
    series, direct = (-f(reduced, system)[:, :k] for f in (_by_series, _directly))
    assert np.abs(series - direct).max(axis=0) == pytest.approx(0, abs=3e-3 * np.abs(direct).max(axis=0).max())
    np.testing.assert_allclose(series, direct, atol=5e-3 * np.abs(direct).max())


def test_independent_noise_leaves_the_sigmas_and_noise_of_whole_views_widens_them():
    _, detections = recording(9, 20)
    calibration = calibrate(detections, model="brown4")
    common = calibration.provenance["views_in_common"]
    assert common["sigma_factor"] == 1 and abs(common["variance_ratio"] - 1) < 3 * common["variance_ratio_sigma"]
    # a smooth error of each view: the same for all corners of its left image along a random quadratic
    rng = np.random.default_rng(0)
    px = detections.left_px.copy()
    x, y = (px[..., i] / 500 - 1 for i in (0, 1))
    for axis in (0, 1):
        a = rng.normal(0, 0.3, (3, 20, 1))
        px[..., axis] += a[0] * x * x + a[1] * x * y + a[2] * y * y
    spoiled = calibrate(replace(detections, left_px=px), model="brown4")
    common = spoiled.provenance["views_in_common"]
    assert common["sigma_factor"] > 1.5
    assert spoiled.covariance.sigma["left.fx"] > 1.3 * calibration.covariance.sigma["left.fx"]


def test_students_factor():
    # t quantiles at 0.8413447 for 2, 5 and 9 degrees of freedom
    assert [student_factor(n) for n in (2, 5, 9)] == pytest.approx([1.321, 1.111, 1.059], rel=2e-3)


def test_the_prior_of_shapes_leaves_what_no_image_tells():
    points = np.ascontiguousarray(BOARD.object_points_m.T)
    model, hidden = ShapeModel.of_points(points), hidden_directions(points)
    np.testing.assert_allclose(model.basis.T @ hidden, 0, atol=1e-12)
    np.testing.assert_allclose(model.basis.T @ model.basis, np.eye(model.basis.shape[1]), atol=1e-12)
    # the scale about the centre is one of them, a stretch along x alone is not
    centred = points - points.mean(axis=1, keepdims=True)
    scale, stretch = centred.reshape(-1), (centred * [[1], [0], [0]]).reshape(-1)
    assert np.linalg.norm(model.basis.T @ scale) < 1e-12 < 0.3 * np.linalg.norm(stretch)
    assert np.linalg.norm(model.basis.T @ stretch) > 0.3 * np.linalg.norm(stretch)


def test_figures_of_a_shape():
    points = np.ascontiguousarray(BOARD.object_points_m.T)
    covariance = np.eye(points.size) * 1e-10
    bent = np.ascontiguousarray(bowed(1e-3).T)
    bent[0] *= 1.01
    found = describe_shape(points, bent, covariance)
    assert found.bow == pytest.approx(1e-3) and found.stretch == pytest.approx(0.01)
    assert found.bow_sigma == pytest.approx(np.sqrt(2) * 1e-5)


def test_each_camera_alone_and_the_pair_agree_on_a_sound_set():
    _, detections = recording(11, 12)
    problem, minimum = nominal_of(detections)
    real = RealViewsProblem(problem)
    estimate = real.start(minimum.estimate)
    equations = real.linearize(estimate, minimum.scale_px, "hampel")
    pair = compare_with_cameras_alone(real, estimate, equations, NOISE_PX)
    assert pair.pair_px == pytest.approx(NOISE_PX, rel=0.05) and pair.ratio == pytest.approx(1, abs=0.03)
    excess, sigma = excess_of_scores(real.reduced(estimate, equations), pair.pair_px)
    assert abs(excess - 1) < 3 * sigma


@pytest.mark.parametrize(("board_shape", "exposure"), [("free", "together"), ("warp", "together"), ("flat", "apart")])
def test_a_solve_that_tells_no_noise_is_given_up_before_variances_are_sought(monkeypatch, board_shape, exposure):
    """Four blurred views leave nothing of their corners: variances of NaN noise were maximised, with NumPy's warnings."""
    _, detections = recording(11, 12)
    problem, minimum = nominal_of(detections)
    calls = []

    def lost(problem, solve, options, shape):
        calls.append(options)
        return replace(solve, problem=problem, noise_px=np.nan)

    monkeypatch.setattr(board_and_exposures, "_minimized", lost)
    solve = solve_real_views(problem, minimum, board_shape=board_shape, exposure=exposure)
    assert len(calls) == 1 and np.isfinite(solve.noise_px) and solve.shape is None


def test_choices_are_checked(unchecked_types):
    with pytest.raises(ValueError, match="board_shape is 'bent'; it can be auto, flat, warp, free"):
        CalibrationRequest(board_shape="bent")
    with pytest.raises(ValueError, match="exposure is 'late'; it can be auto, together, apart"):
        CalibrationRequest(exposure="late")
