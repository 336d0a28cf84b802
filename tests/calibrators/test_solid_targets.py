"""Targets that are no plane: points known or roughly known, the rig within its sigmas, and wrong input by name."""

from __future__ import annotations

import numpy as np
import pytest
from jaxtyping import TypeCheckError

from binocal import Detections, calibrate, read_detections, write_detections
from binocal.errors import CalibrationError, DataError
from binocal.geometry import SE3, so3
from binocal.initialization.solid_targets import estimate_solid_camera, is_solid, solid_poses
from binocal.simulation import table2_rig

RIG = table2_rig()
STEPS = np.linspace(0.0, 0.1, 4)
FACE = np.stack(np.meshgrid(STEPS, STEPS), axis=-1).reshape(-1, 2)
CUBE = np.unique(np.concatenate([np.insert(FACE, axis, 0.0, axis=1) for axis in range(3)]).round(9), axis=0)
SIZE = (1280, 960)


def look(points, n_views, rng, noise_px=0.1):
    """Corners of both cameras, NaN outside the image, and T_left_board."""
    turns = so3.exp(rng.normal(0, 0.25, (n_views, 3))) @ so3.exp(np.array([0.6, -0.7, 0.1]))
    z = rng.uniform(0.45, 0.6, n_views)
    centres = np.column_stack([rng.uniform(-0.06, 0.1, n_views), rng.uniform(-0.05, 0.05, n_views), z])
    poses = SE3(turns, centres - turns @ points.mean(axis=0))
    sides = []
    for camera, T in ((RIG.left, poses), (RIG.right, RIG.T_right_left @ poses)):
        px = camera.project(T.apply(points))
        px += noise_px * rng.standard_normal(px.shape)
        px[((px < 0) | (px > [1279, 959])).any(axis=-1)] = np.nan
        sides.append(px)
    return *sides, poses


def errors_in_sigmas(calibration):
    sigma, rig = calibration.covariance.sigma, calibration.rig
    turn = so3.log(rig.T_right_left.R @ RIG.T_right_left.R.T)
    errors = {f"rotation.{axis}": turn[i] for i, axis in enumerate("xyz")}
    errors |= {f"translation.{axis}": rig.T_right_left.t[i] - RIG.T_right_left.t[i] for i, axis in enumerate("xyz")}
    for side in ("left", "right"):
        for i, name in enumerate(("fx", "fy", "cx", "cy")):
            errors[f"{side}.{name}"] = getattr(rig, side).parameters[i] - getattr(RIG, side).parameters[i]
    return np.array([error / sigma[name] for name, error in errors.items()])


def test_what_is_solid():
    assert is_solid(CUBE) and not is_solid(CUBE[:5])
    assert not is_solid(CUBE[CUBE[:, 2] == 0]) and not is_solid(CUBE * [1, 1, 0.01])


def test_one_view_determines_a_camera_and_the_face_of_another_view_its_pose():
    rng = np.random.default_rng(1)
    left, _, poses = look(CUBE, 2, rng, noise_px=0.0)
    left[1, CUBE[:, 2] > 0] = np.nan  # one face
    known = solid_poses("brown4", RIG.left.parameters, CUBE, left)
    assert known.is_usable.all()
    assert np.degrees(so3.angle_rad(known.R @ poses.R.swapaxes(1, 2))).max() < 0.2  # 0.03: by homography and lens
    camera = estimate_solid_camera(CUBE, left, SIZE, "brown4")
    assert camera is not None and camera.n_solid == 1
    assert camera.parameters[0] == pytest.approx(RIG.left.parameters[0], rel=0.02)
    assert estimate_solid_camera(CUBE, left[1:], SIZE, "brown4") is None


def test_a_cube_calibrates_the_rig_within_its_sigmas():
    z = []
    for seed in range(2):
        left, right, _ = look(CUBE, 10, np.random.default_rng(seed))
        calibration = calibrate(Detections.from_arrays(CUBE, left, right, SIZE), model="brown4")
        assert len(calibration.views) == 10 and calibration.board_shape is None
        z.append(errors_in_sigmas(calibration))
    assert np.sqrt(np.mean(np.square(z))) < 1.6  # 1.1 over these seeds
    assert calibration.covariance.sigma["translation.x"] < 1e-4


def test_exact_corners_give_the_exact_rig():
    left, right, _ = look(CUBE, 8, np.random.default_rng(3), noise_px=0.0)
    calibration = calibrate(Detections.from_arrays(CUBE, left, right, SIZE), model="brown4", calibrator="lm")
    assert calibration.rig.T_right_left.t == pytest.approx(RIG.T_right_left.t, abs=1e-8)
    assert calibration.rig.left.parameters[:4] == pytest.approx(RIG.left.parameters[:4], abs=1e-4)


def test_roughly_known_points_are_moved_and_the_scale_is_as_uncertain_as_they_are(tmp_path):
    rng = np.random.default_rng(4)
    left, right, _ = look(CUBE, 10, rng)
    given = CUBE + 1e-3 * rng.standard_normal(CUBE.shape)
    detections = Detections.from_arrays(given, left, right, SIZE, object_sigma_m=1e-3)
    write_detections(tmp_path / "corners.npz", detections)
    again = read_detections(tmp_path / "corners.npz")
    assert np.array_equal(again.object_sigma_m, np.full(len(CUBE), 1e-3))
    calibration = calibrate(again, model="brown4")
    assert np.abs(errors_in_sigmas(calibration)).max() < 4
    spread2 = np.square(CUBE - CUBE.mean(axis=0)).sum()
    scale_sigma = 1e-3 / np.sqrt(spread2)  # relative
    assert calibration.covariance.sigma["translation.x"] == pytest.approx(scale_sigma * RIG.baseline_m, rel=0.2)
    moved, truth = calibration.board_shape.points_m, CUBE
    shapes = [np.linalg.norm(p[:, None] - p, axis=-1) for p in (moved, truth)]
    ratio = np.median(shapes[0][shapes[1] > 0] / shapes[1][shapes[1] > 0])
    assert np.abs(shapes[0] / ratio - shapes[1]).max() < 3e-4 < np.linalg.norm(given - CUBE, axis=1).max()
    assert not any(found.code.startswith(("board-not", "points-")) for found in calibration.findings)


def test_points_that_are_worse_than_stated_are_said():
    rng = np.random.default_rng(5)
    left, right, _ = look(CUBE, 8, rng)
    given = CUBE + 2e-3 * rng.standard_normal(CUBE.shape)
    calibration = calibrate(Detections.from_arrays(given, left, right, SIZE, object_sigma_m=5e-4), model="brown4")
    assert "points-beyond-their-sigma" in [found.code for found in calibration.findings]


@pytest.mark.parametrize(
    ("change", "error", "told"),
    [
        (lambda p, rng: p[rng.permutation(len(p))], CalibrationError, "points' places, their units or their order"),
        (lambda p, rng: p * [1, 1, -1], CalibrationError, "points' places, their units or their order"),
        (lambda p, rng: np.column_stack([p[:, 0], p[:, 0], p[:, 1]]), DataError, "with z = 0"),
    ],
)
def test_wrong_points_are_refused_by_name(change, error, told):
    rng = np.random.default_rng(6)
    left, right, _ = look(CUBE, 6, rng)
    with pytest.raises(error, match=told):
        calibrate(Detections.from_arrays(change(CUBE, rng), left, right, SIZE), model="brown4")


def test_a_pair_of_another_moment_and_a_target_seen_flat_are_named():
    rng = np.random.default_rng(7)
    left, right, _ = look(CUBE, 8, rng)
    right[2] = right[5]
    calibration = calibrate(Detections.from_arrays(CUBE, left, right, SIZE), model="brown4")
    assert [(view.name, view.code) for view in calibration.rejected] == [("2", "view-mismatched")]
    flat = left.copy()
    flat[:, CUBE[:, 2] > 0] = np.nan
    with pytest.raises(CalibrationError, match="six points or more that do not lie in one plane"):
        calibrate(Detections.from_arrays(CUBE, flat, right, SIZE), model="brown4")


def test_a_shape_of_a_flat_board_is_refused_and_so_are_sigmas_that_are_none():
    left, right, _ = look(CUBE, 6, np.random.default_rng(8))
    with pytest.raises(DataError, match="auto or flat"):
        calibrate(Detections.from_arrays(CUBE, left, right, SIZE), model="brown4", board_shape="warp")
    with pytest.raises(ValueError, match="object_sigma_m"):
        Detections.from_arrays(CUBE, left, right, SIZE, object_sigma_m=-1.0)


def test_five_points_beside_any_plane_have_a_pose_before_a_known_camera():
    points = np.array([[0, 0, 0], [0.2, 0, 0], [0, 0.2, 0], [0.2, 0.2, 0.1], [0.1, 0.05, 0.15]])
    turns = so3.exp(np.random.default_rng(0).normal(0, 1.5, (8, 3)))
    poses = SE3(turns, np.array([0.02, -0.01, 1.0]) - turns @ points.mean(axis=0))
    known = solid_poses("brown4", RIG.left.parameters, points, RIG.left.project(poses.apply(points)))
    assert known.is_usable.all() and known.rms_px.max() < 1e-3
    assert np.degrees(so3.angle_rad(known.R @ poses.R.swapaxes(1, 2))).max() < 1e-3
    few = solid_poses(
        "brown4", RIG.left.parameters, points[[0, 1, 2, 4]], RIG.left.project(poses.apply(points[[0, 1, 2, 4]]))
    )
    assert not few.is_usable.any()  # four leave two poses that are nearly alike


def test_points_that_are_not_where_they_were_given_are_named():
    left, right, _ = look(CUBE, 8, np.random.default_rng(5))
    longer = calibrate(Detections.from_arrays(CUBE * [1, 1, 1.03], left, right, SIZE), model="brown4", calibrator="lm")
    (found,) = (found for found in longer.findings if found.code == "points-not-as-given")
    assert found.figures["free_px"] < 0.15 and found.figures["given_px"] > 0.4
    assert 0.5 < found.figures["rms"] < 3  # mm; the face is 3 mm too long, shared among all points
    exact = calibrate(Detections.from_arrays(CUBE, left, right, SIZE), model="brown4", calibrator="lm")
    assert "points-not-as-given" not in [found.code for found in exact.findings]


def test_standard_deviations_of_points_are_one_for_each():
    left, right, _ = look(CUBE, 3, np.random.default_rng(5))
    for sigma, told in ((np.ones(5), "one for each of the"), (-0.1, "that of point 0 is -0.1")):
        with pytest.raises((ValueError, TypeCheckError), match=told if np.ndim(sigma) == 0 else None):
            Detections.from_arrays(CUBE, left, right, SIZE, object_sigma_m=sigma)
