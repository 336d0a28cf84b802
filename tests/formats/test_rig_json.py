from __future__ import annotations

import json
import math
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given

from binocal.boards import parse_board
from binocal.errors import FormatError
from binocal.formats import rig_json
from rigs import assert_same_rig, make_calibration, make_poses, make_rig, rigs


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
    assert back.rejected == calibration.rejected and back.warnings == calibration.warnings
    assert back.rms == calibration.rms and back.noise_px == calibration.noise_px and back.n_iterations == 7
    assert back.evidence is None
    (view,) = json.loads(path.read_text())["views"]
    np.testing.assert_array_equal(view["T"], calibration.evidence.T_left_board.t[0])
    np.testing.assert_array_equal(back.covariance.matrix, calibration.covariance.matrix)


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


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda d: d.pop("schema"), "'schema' is missing"),
        (lambda d: d.update(schema="binocal/9"), "'schema': expected \"binocal/1\""),
        (lambda d: d["left"].pop("fx"), r"'left\.fx' is missing; expected a number"),
        (lambda d: d["right"].update(cx="wide"), r"'right\.cx': expected a number, got \"wide\""),
        (lambda d: d["right"].update(cx=None), r"'right\.cx': expected a number, got null"),
        (lambda d: d["left"].update(model="brown9"), r"'left\.model': expected one of brown4"),
        (lambda d: d["left"].update(fx=-3.0), "fx, fy > 0"),
        (lambda d: d["left"].update(distortion=[1, 2]), r"'left\.distortion': expected 4 numbers"),
        (lambda d: d.update(R=[[1, 0], [0, 1]]), "'R': expected 3x3 numbers"),
        (lambda d: d.update(R=[[2, 0, 0], [0, 1, 0], [0, 0, 1]]), "'R': expected a rotation matrix"),
        (lambda d: d.update(T=[[1], [2, 3]]), "'T': expected 3 numbers"),
        (lambda d: d.update(unit="mm"), "'unit': expected"),
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


@pytest.mark.parametrize("content", [b"", b"{", b"[1]", b"\xff\xfe", b"null"])
def test_what_is_not_json_is_refused(tmp_path, content):
    path = tmp_path / "rig.json"
    path.write_bytes(content)
    with pytest.raises(FormatError):
        rig_json.read_rig(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FormatError, match="no such file"):
        rig_json.read_calibration(tmp_path / "no.json")
