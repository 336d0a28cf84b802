"""Cameras as functions of the zoom setting: the curves, the network, what is said of them, and input that does not suit."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import binocal
from binocal.boards import parse_board
from binocal.cameras.zoom_rig import ZoomRig, by_parameters, curve_names, curve_quantities, rig_of_quantities
from binocal.errors import CalibrationError, DataError, FormatError
from binocal.evidence.zoom_settings import ZoomSettings
from binocal.formats.zoom_csv import read_zoom_settings
from binocal.geometry import SE3, so3
from binocal.metrics import image
from binocal.metrics.held_out import exact_views
from binocal.simulation import StereoScene, random_rig, sample_board_poses, simulate_detections
from binocal.simulation.zoom import zoom_rig_at
from binocal.solvers.zoom_network import _derivatives, fit_network

BOARD = parse_board("chessboard:11x8:20mm")


def evidence(n_settings=7, n_views=4, seed=0, noise_px=0.05):
    rng = np.random.default_rng(seed)
    settings = np.linspace(0, 1, n_settings)
    made = []
    for setting in settings:
        rig = zoom_rig_at(setting)
        scene = StereoScene(rig, BOARD, sample_board_poses(rig, BOARD, n_views, rng))
        made.append(simulate_detections(scene, rng, noise_px=noise_px))
    return ZoomSettings(settings, tuple(made))


def length_error_percent(rig, setting):
    exact, _ = exact_views(zoom_rig_at(setting), BOARD, 10, 0)
    return image.length_error(rig, exact, side_m=BOARD.pitch_m).scale_rms_percent


@pytest.mark.parametrize("model", ["brown4", "brown5", "brown8", "fisheye4"])
def test_quantities_and_back(model):
    rng = np.random.default_rng(0)
    rig, middle = random_rig(rng, model, size_wh=(640, 480)), random_rig(rng, model, size_wh=(640, 480))
    quantities = curve_quantities(rig, middle)
    back = rig_of_quantities(quantities, middle)
    assert np.allclose(back.left.parameters, rig.left.parameters, rtol=1e-12, atol=1e-12)
    assert so3.angle_rad(back.T_right_left.R @ rig.T_right_left.R.T) < 1e-12
    # central differences of step 1e-6, relative for the focal lengths
    J = by_parameters(rig, middle)
    assert J.shape == (len(curve_names(rig)),) * 2
    for i, name in enumerate(curve_names(rig)):
        step = 1e-3 if name.endswith(("fx", "fy")) else 1e-6
        ahead, behind = (curve_quantities(_moved(rig, name, s), middle) for s in (step, -step))
        numeric = (ahead - behind) / (2 * step)
        assert np.abs(numeric - J[:, i]).max() < 1e-6 * max(np.abs(J[:, i]).max(), 1e-3), name


def _moved(rig, name, step):
    part, axis = name.split(".")
    if part in ("rotation", "translation"):
        T, away = rig.T_right_left, step * np.eye(3)["xyz".index(axis)]
        moved = SE3(so3.exp(away) @ T.R, T.t) if part == "rotation" else SE3(T.R, T.t + away)
        return replace(rig, T_right_left=moved)
    camera = getattr(rig, part)
    names = binocal.cameras.camera_model(camera.model).parameter_names
    parameters = camera.parameters + step * np.eye(len(names))[names.index(axis)]
    return replace(rig, **{part: replace(camera, parameters=parameters)})


def test_back_propagation_is_the_derivative():
    rng = np.random.default_rng(0)
    network = fit_network(
        np.array([-1.0, -0.3, 0.4, 1.0]), rng.normal(0, 1, (4, 2)), np.stack([np.eye(2)] * 4), rng, degree=1, n_hidden=3
    ).network
    J, k = _derivatives(network, 0.37), 0
    for name in ("polynomial", "into", "bias", "out"):
        values = getattr(network, name)
        for place in np.ndindex(values.shape):
            moved = []
            for step in (1e-6, -1e-6):
                other = values.copy()
                other[place] += step
                moved.append(replace(network, **{name: other})(0.37))
            assert np.abs((moved[0] - moved[1]) / 2e-6 - J[:, k]).max() < 1e-8, (name, place)
            k += 1
    assert k == J.shape[1]


def test_the_network_follows_what_a_polynomial_cannot():
    x = np.linspace(-1, 1, 11)
    curve = np.stack([np.tanh(3 * x), np.sin(2 * x)], axis=-1)
    roots = np.stack([1e3 * np.eye(2)] * len(x))  # known to a thousandth
    errors = {}
    for n_hidden in (0, 4):
        fit = fit_network(x, curve, roots, np.random.default_rng(0), degree=2, n_hidden=n_hidden)
        between = 0.5 * (x[1:] + x[:-1])
        found = np.stack([fit.network(at) for at in between])
        errors[n_hidden] = np.abs(found - np.stack([np.tanh(3 * between), np.sin(2 * between)], axis=-1)).max()
    assert errors[4] < 0.01 < 0.1 < errors[0]
    sigma = np.sqrt(np.diag(fit.output_covariance(0.1)))
    assert (sigma < 0.01).all() and (sigma > 1e-5).all()


@pytest.fixture(scope="module")
def solved():
    given = evidence(11, 6)
    return given, binocal.calibrate(given, calibrator="zoom", model="brown4", options={"setting": 0.35})


def test_between_settings_it_is_nearly_as_good_as_at_them(solved):
    given, made = solved
    zoom = ZoomRig.from_document(made.extra["zoom"])
    own = [binocal.calibrate(d, calibrator="lm", model="brown4").rig for d in given.detections[1:-1]]
    at = [length_error_percent(rig, s) for rig, s in zip(own, given.settings[1:-1], strict=True)]
    middles = 0.5 * (given.settings[1:] + given.settings[:-1])
    between = [length_error_percent(zoom.rig_at(s), s) for s in middles]
    assert np.sqrt(np.mean(np.square(between))) < 2 * np.sqrt(np.mean(np.square(at)))  # 1.1 measured
    quantities = [curve_quantities(rig, zoom.middle) for rig in own]
    linear = [
        length_error_percent(rig_of_quantities(0.5 * (a + b), zoom.middle), s)
        for a, b, s in zip(quantities, quantities[1:], middles[1:-1], strict=False)
    ]
    assert np.median(linear) > 4 * np.median(between)  # 12 measured


def test_what_it_states(solved):
    given, made = solved
    said = made.provenance["zoom"]
    assert said["setting"] == 0.35 and said["hidden"] > 0
    left_out = said["left_out_error"]
    assert left_out["network"] < left_out["linear_interpolation"] and left_out["network"] < left_out["polynomial"]
    truth = zoom_rig_at(0.35)
    middle = ZoomRig.from_document(made.extra["zoom"]).middle
    away = np.linalg.solve(
        by_parameters(truth, middle), curve_quantities(made.rig, middle) - curve_quantities(truth, middle)
    )
    score = away @ np.linalg.solve(made.covariance.matrix, away) / len(away)
    assert 0.2 < score < 3.0  # 22 standard normals within 3 sigma of chance; 0.7 measured
    assert made.covariance.sigma["left.fx"] < 2e-3 * made.rig.left.parameters[0]
    assert [view.name for view in made.views[:2]] == ["0/0", "0/1"] and len(made.views) == given.n_views


def test_settings_with_anothers_number_are_named(solved):
    _, made = solved
    assert not any(found.code == "zoom-off-curve" for found in made.findings)
    few = evidence(7, 4, seed=1)
    exchanged = [few.detections[i] for i in (0, 1, 4, 3, 2, 5, 6)]
    wrong = few.settings.copy()
    wrong[3] += 0.05
    for settings, detections, said in (
        (few.settings, exchanged, r"between the zoom settings 0\.\d+ and 0\.\d+ the focal length goes back"),
        (wrong, few.detections, r"at zoom setting 0\.55 lies off the curves"),
    ):
        calibration = binocal.calibrate(
            ZoomSettings(settings, tuple(detections)), calibrator="zoom", model="brown4", options={"setting": 0.35}
        )
        (found,) = [found for found in calibration.findings if found.code == "zoom-off-curve"]
        assert re.search(said, found.text)


def test_the_curves_come_back_from_the_file(solved, tmp_path):
    _, made = solved
    binocal.write_calibration(tmp_path / "rig.json", made)
    zoom = ZoomRig.from_document(binocal.read_calibration(tmp_path / "rig.json").extra["zoom"])
    assert np.array_equal(zoom.rig_at(0.35).left.parameters, made.rig.left.parameters)
    with pytest.raises(ValueError, match=r"zoom setting 1.2 is outside of those calibrated, 0 to 1"):
        zoom.rig_at(1.2)


def test_the_pages_example_runs(solved, tmp_path, monkeypatch):
    _, made = solved
    binocal.write_calibration(tmp_path / "rig.json", made)
    monkeypatch.chdir(tmp_path)
    page = (Path(__file__).parents[2] / "docs" / "calibrators.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    scope = {}
    exec(example, scope)
    assert scope["rig"].left.parameters[0] == pytest.approx(zoom_rig_at(0.7).left.parameters[0], rel=2e-3)


def test_input_that_does_not_suit_is_named():
    given = evidence(5, 3, noise_px=0.02)
    few = ZoomSettings(given.settings[:4], given.detections[:4])
    with pytest.raises(DataError, match="4 zoom settings, 5 needed"):
        binocal.calibrate(few, calibrator="zoom", model="brown4")
    with pytest.raises(ValueError, match="outside of those calibrated"):
        binocal.calibrate(given, calibrator="zoom", model="brown4", options={"setting": -1})
    two = replace(given, detections=(given.detections[0].select(np.arange(2)), *given.detections[1:]))
    with pytest.raises(CalibrationError, match="zoom setting 0: 2 usable views, 3 needed"):
        binocal.calibrate(two, calibrator="zoom", model="brown4")
    with pytest.raises(DataError, match=r"zoom setting 0.25 is given twice \(sets 2 and 3\)"):
        ZoomSettings(np.array([0, 0.25, 0.25, 0.5, 1.0]), given.detections)
    turned = ZoomSettings(given.settings[::-1], given.detections[::-1])
    assert np.array_equal(turned.settings, given.settings) and turned.detections == given.detections
    other = replace(given.detections[3], left_size_wh=(640, 480))
    with pytest.raises(DataError, match=r"left image size differs between zoom setting 0 .* and 0.75"):
        ZoomSettings(given.settings, (*given.detections[:3], other, given.detections[4]))
    with pytest.raises(TypeError, match="ZoomSettings"):
        binocal.calibrate(given.detections[0], calibrator="zoom", model="brown4")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "line 1: expected setting,left,right"),
        ("setting,left,right\n", "holds no setting"),
        ("setting,left,right\n1,a\n", "line 2: 2 cells"),
        ("setting,left,right\n1,a,b\nwide,a,b\n", "line 3: the setting 'wide' is not a finite number"),
        ("setting,left,right\nnan,a,b\n", "line 2: the setting 'nan'"),
        ("setting,left,right\n1,,b\n", "line 2: a side has no images"),
        ("setting,left,right\n2,a,b\n1,c,d\n2.0,e,f\n", "line 4: zoom setting 2 stands on line 2 already"),
    ],
)
def test_lists_of_settings_that_are_none(tmp_path, text, said):
    path = tmp_path / "settings.csv"
    path.write_text(text)
    with pytest.raises(FormatError, match=said):
        read_zoom_settings(path)


def test_a_list_of_settings(tmp_path):
    path = tmp_path / "settings.csv"
    path.write_text("setting, left, right\n2,t/l*.png,t/r*.png\n\n1,w/l*.png,w/r*.png\n")
    rows = read_zoom_settings(path)
    assert [row.setting for row in rows] == [1.0, 2.0]
    assert rows[0].left == str(tmp_path / "w/l*.png")
