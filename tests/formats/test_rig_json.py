from __future__ import annotations

import json
import math
import os
import tempfile
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from binocal.boards import parse_board
from binocal.errors import FormatError
from binocal.formats import rig_json
from rigs import assert_same_rig, calibrations, make_calibration, make_poses, make_rig, rigs


@given(rigs())
def test_write_then_read_gives_the_same_bits(rig):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.json"
        rig_json.write_calibration(path, make_calibration(rig))
        assert_same_rig(rig_json.read_rig(path), rig)


def test_the_document_has_the_keys_of_the_contract(tmp_path):
    path = tmp_path / "rig.json"
    rig_json.write_calibration(path, make_calibration())
    text = path.read_text()
    document = json.loads(text, parse_constant=lambda word: pytest.fail(f"{word} in rig.json"))
    assert document["schema"] == "binocal/1" and document["unit"] == "m"
    assert set(document["left"]) == {"model", "image_size", "fx", "fy", "cx", "cy", "skew", "distortion"}
    assert np.array(document["R"]).shape == (3, 3) and len(document["T"]) == 3
    assert set(document["euler_deg"]) == {"gamma", "lambda", "mu"} and set(document["rms_px"]) == {
        "left",
        "right",
        "all",
    }
    assert document["sigma"] == {"left.fx": 0.5, "rotation.x": 1e-4, "translation.x": None}
    assert document["rejected"] == [{"name": "02", "reason": "no board found in the left image"}]
    assert document["provenance"] == {"seed": 0, "cost": None, "version": "x", "shape": [1, 2], "n": 3}


def test_a_calibration_comes_back_whole(tmp_path):
    path, calibration = tmp_path / "rig.json", make_calibration()
    rig_json.write_calibration(path, calibration)
    back = rig_json.read_calibration(path)
    assert (
        back.views[0].name == "01"
        and math.isnan(back.views[0].right_rms_px)
        and back.views[0].note == "turned by 180 deg"
    )
    assert back.views[0].outliers == calibration.views[0].outliers and back.views[0].n_outliers == 1
    assert back.rejected == calibration.rejected and back.findings == calibration.findings
    assert back.rms == calibration.rms and back.noise_px == calibration.noise_px and back.n_iterations == 7
    assert back.evidence is None
    np.testing.assert_array_equal(back.T_left_board.t, calibration.evidence.T_left_board.t)
    np.testing.assert_array_equal(back.T_left_board.R, calibration.evidence.T_left_board.R)
    np.testing.assert_array_equal(back.covariance.matrix, calibration.covariance.matrix)


@settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow])
@given(calibrations(), st.randoms(use_true_random=False))
def test_reading_and_writing_loses_no_key_and_no_digit(calibration, random):
    with tempfile.TemporaryDirectory() as folder, np.errstate(invalid="ignore"):
        path, again = Path(folder) / "rig.json", Path(folder) / "again.json"
        rig_json.write_calibration(path, calibration)
        back = rig_json.read_calibration(path)
        rig_json.write_calibration(again, back)
        assert again.read_bytes() == path.read_bytes()
        assert_same_rig(back.rig, calibration.rig)
        assert back.extra == calibration.extra and back.provenance == calibration.provenance
        np.testing.assert_equal([asdict(view) for view in back.views], [asdict(view) for view in calibration.views])
        np.testing.assert_array_equal(back.covariance.matrix, calibration.covariance.matrix)
        np.testing.assert_equal(back.misfit_px, calibration.misfit_px)
        assert (back.T_left_board is None) == (calibration.T_left_board is None)
        document = json.loads(path.read_text())
        add_keys(document, random)  # a later version's, or another program's, at any depth
        path.write_text(json.dumps(document))
        rig_json.write_calibration(again, rig_json.read_calibration(path), force=True)
        assert json.loads(again.read_text()) == document


def add_keys(value, random):
    """A key of its own in some of the document's objects. What provenance and extra keys hold is free text anyway."""
    if isinstance(value, dict):
        for item in value.values():
            add_keys(item, random)
        if random.random() < 0.5:
            value["of-another"] = [1.5, {"name": "x"}]
    elif isinstance(value, list):
        for item in value:
            add_keys(item, random)


def test_keys_of_another_follow_their_view(tmp_path):
    document = rig_json.calibration_document(make_calibration(n_views=3))
    document["views"][2]["camera_temperature_c"] = 31.5
    document["left"]["serial"] = "A1"
    (tmp_path / "rig.json").write_text(json.dumps(document))
    calibration = rig_json.read_calibration(tmp_path / "rig.json")
    shorter = replace(calibration, views=calibration.views[1:], T_left_board=calibration.T_left_board[1:])
    written = rig_json.calibration_document(shorter)
    assert [view.get("camera_temperature_c") for view in written["views"]] == [None, 31.5]
    assert written["left"]["serial"] == "A1"


def test_truth_comes_back_whole(tmp_path):
    poses = make_poses(3, np.random.default_rng(0))
    truth = rig_json.Truth(make_rig(), parse_board("charuco:11x8:30mm:22mm:DICT_5X5_50"), ("0", "1", "2"), poses, 3.0)
    rig_json.write_truth(tmp_path / "truth.json", truth)
    back = rig_json.read_truth(tmp_path / "truth.json")
    assert_same_rig(back.rig, truth.rig)
    assert back.board == truth.board and back.names == truth.names and back.noise_dn == 3.0 and math.isnan(back.blur_px)
    np.testing.assert_array_equal(back.T_left_board.t, poses.t)
    np.testing.assert_array_equal(back.T_left_board.R, poses.R)
    assert_same_rig(rig_json.read_rig(tmp_path / "truth.json"), truth.rig)


def test_the_truth_of_a_scene_comes_back_whole(tmp_path):
    poses = make_poses(2, np.random.default_rng(0))
    truth = rig_json.Truth(make_rig(), None, ("00", "01"), poses, 3.0, 0.8, "street", 0.02)
    rig_json.write_truth(tmp_path / "truth.json", truth)
    back = rig_json.read_truth(tmp_path / "truth.json")
    assert back.board is None and back.scene == "street" and back.gap_s == 0.02 and back.names == truth.names
    assert_same_rig(rig_json.read_rig(tmp_path / "truth.json"), truth.rig)
    document = json.loads((tmp_path / "truth.json").read_text())
    for key, wrong in (("scene", 3), ("scene", ""), ("gap_s", "long")):
        (tmp_path / "truth.json").write_text(json.dumps(document | {key: wrong}))
        with pytest.raises(FormatError, match=f"'{key}'"):
            rig_json.read_truth(tmp_path / "truth.json")
    with pytest.raises(ValueError, match="of a board or of a scene"):
        rig_json.Truth(make_rig(), None, ("00", "01"), poses)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda d: d.pop("schema"), "'schema' is missing"),
        (lambda d: d.update(schema="binocal/9"), "'schema': expected \"binocal/1\""),
        (lambda d: d["left"].pop("fx"), r"'left\.fx' is missing; expected a number"),
        (lambda d: d["right"].update(cx="wide"), r"'right\.cx': expected a number, got \"wide\""),
        (lambda d: d["right"].update(cx=None), r"'right\.cx': expected a number, got null"),
        (lambda d: d["left"].update(model="brown9"), r"'left\.model': unknown camera model 'brown9'; known: brown4"),
        (lambda d: d["left"].update(fx=-3.0), "fx, fy > 0"),
        (lambda d: d["left"].update(distortion=[1, 2]), r"'left\.distortion': expected 4 numbers"),
        (lambda d: d.update(R=[[1, 0], [0, 1]]), "'R': expected 3x3 numbers"),
        (lambda d: d.update(R=[[2, 0, 0], [0, 1, 0], [0, 0, 1]]), "'R': expected a rotation matrix"),
        (lambda d: d.update(T=[[1], [2, 3]]), "'T': expected 3 numbers"),
        (lambda d: d.update(unit="mm"), "'unit': expected"),
        (lambda d: d["left"].update(fx=10**400), r"'left\.fx': expected a number"),
        (lambda d: d["left"].update(fx=math.inf), "holds Infinity"),
        (lambda d: d["left"].update(fx=int("9" * 4000)), "whole number of 4000 digits"),
        (lambda d: d["left"].update(image_size=[10**400, 480]), r"'left\.image_size': expected 2 numbers"),
        (lambda d: d["left"].update(image_size=[1e300, 480]), r"'left\.image_size': expected two whole numbers"),
        (lambda d: d["left"].update(image_size=[640.5, 480]), r"'left\.image_size': expected two whole numbers"),
        (lambda d: d.update(T=[10**400, 0, 0]), "'T': expected 3 numbers"),
    ],
)
def test_a_broken_file_is_named_with_its_key(tmp_path, change, expected):
    document = rig_json.calibration_document(make_calibration())
    change(document)
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(document))
    with pytest.raises(FormatError, match=expected) as caught:
        rig_json.read_rig(path)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda d: d["views"][0].pop("R"), r"'views\[0\]\.R' is missing"),
        (lambda d: d["views"][1].pop("R"), r"'views\[1\]\.R' is missing"),
        (
            lambda d: d["views"][0].update(left_order=[0, 0]),
            r"'views\[0\]\.left_order': expected each of 0 to n - 1 once",
        ),
        (lambda d: d["views"][0].update(right_order=[0.5]), r"'views\[0\]\.right_order': expected a list of whole"),
        (lambda d: d.update(misfit_px="none"), "'misfit_px': expected a number or null"),
        (lambda d: d.update(n_iterations=10**300), "'n_iterations': expected a whole number"),
    ],
)
def test_a_broken_view_is_named_with_its_key(tmp_path, change, expected):
    document = rig_json.calibration_document(make_calibration(n_views=2))
    change(document)
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(document))
    with pytest.raises(FormatError, match=expected):
        rig_json.read_calibration(path)


@pytest.mark.parametrize("content", [b"", b"{", b"[1]", b"\xff\xfe", b"null", b"[" * 100_000, b"9" * 5000])
def test_what_is_not_json_is_refused(tmp_path, content):
    path = tmp_path / "rig.json"
    path.write_bytes(content)
    with pytest.raises(FormatError):
        rig_json.read_rig(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FormatError, match="no such file"):
        rig_json.read_calibration(tmp_path / "no.json")


def test_a_pipe_is_no_file(tmp_path):
    os.mkfifo(tmp_path / "rig.json")
    with pytest.raises(FormatError, match="is a pipe"):
        rig_json.read_rig(tmp_path / "rig.json")
    assert not rig_json.is_rig_file(tmp_path / "rig.json")
