from __future__ import annotations

import os
import tempfile
import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import assume, given

from binocal.errors import DataError, DegenerateGeometryError, FormatError, OutputExistsError
from binocal.formats import opencv_yaml
from binocal.formats.opencv_yaml import read_opencv
from binocal.formats.registry import find_format
from binocal.rectification import rectification_map
from rigs import assert_same_rig, make_rig, rigs


@pytest.mark.parametrize("layout", ["rig.yml", "folder"])
@given(rig=rigs())
def test_write_then_read(layout, rig):
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # random rigs are unlikely ones
        try:
            opencv_yaml.write_opencv(Path(folder) / layout, rig)
        except DegenerateGeometryError:
            assume(False)
        assert_same_rig(opencv_yaml.read_opencv(Path(folder) / layout), rig, 1e-12)


def test_opencv_reads_what_is_written(tmp_path):
    cv2 = pytest.importorskip("cv2")
    rig = make_rig("brown8")
    opencv_yaml.write_opencv(tmp_path / "rig.yml", rig)
    storage = cv2.FileStorage(str(tmp_path / "rig.yml"), cv2.FILE_STORAGE_READ)
    np.testing.assert_array_equal(storage.getNode("M1").mat(), rig.left.K)
    np.testing.assert_array_equal(storage.getNode("D2").mat().ravel(), rig.right.distortion)
    np.testing.assert_array_equal(storage.getNode("R").mat(), rig.T_right_left.R)
    np.testing.assert_array_equal(storage.getNode("T").mat().ravel(), rig.T_right_left.t)
    assert [storage.getNode("imageSize").at(i).real() for i in range(2)] == [1280, 960]
    assert storage.getNode("P2").mat().shape == (3, 4) and storage.getNode("Q").mat().shape == (4, 4)


@pytest.mark.parametrize("suffix", [".yml", ".json", ".xml"])
def test_reads_what_opencv_writes(tmp_path, suffix):
    cv2 = pytest.importorskip("cv2")
    rig, path = make_rig("brown5"), tmp_path / f"rig{suffix}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in (
        ("cameraMatrix1", rig.left.K), ("distCoeffs1", rig.left.distortion[None]), ("cameraMatrix2", rig.right.K),
        ("distCoeffs2", rig.right.distortion[:, None]), ("R", rig.T_right_left.R), ("t", rig.T_right_left.t[:, None]),
    ):  # fmt: skip
        storage.write(key, value)
    storage.write("image_width", 1280)
    storage.write("image_height", 960)
    storage.release()
    assert_same_rig(opencv_yaml.read_opencv(path), rig, 1e-12)


def test_converging_cameras_get_a_pinhole_that_shows_what_both_see(tmp_path):
    """By 100 degrees: R1 to Q of before showed not one pixel of either."""
    rig = make_rig(rotation_rad=(0, 1.745, 0), t=(-0.5 * np.cos(0.8725), 0, 0.5 * np.sin(0.8725)))
    opencv_yaml.write_opencv(tmp_path / "rig.yml", rig)
    storage = cv2.FileStorage(str(tmp_path / "rig.yml"), cv2.FILE_STORAGE_READ)
    R1, R2, P1, P2, Q = (storage.getNode(name).mat() for name in ("R1", "R2", "P1", "P2", "Q"))
    for camera, R, P in ((rig.left, R1, P1), (rig.right, R2, P2)):
        assert rectification_map(camera, R, P, rig.left.size_wh)[1].mean() > 0.6  # measured: 0.68
    assert Q[3, 3] != 0  # each image has a centre of its own


def test_the_image_size_is_asked_for(tmp_path):
    opencv_yaml.write_opencv(tmp_path / "rig.yml", make_rig())
    path = tmp_path / "rig.yml"
    path.write_text("\n".join(line for line in path.read_text().splitlines() if "imageSize" not in line))
    with pytest.raises(FormatError, match="no image size"):
        opencv_yaml.read_opencv(path)
    assert opencv_yaml.read_opencv(path, size_wh=(1280, 960)).left.size_wh == (1280, 960)


def test_two_files_are_found_from_either(tmp_path):
    opencv_yaml.write_opencv(tmp_path / "rig", make_rig())
    assert {file.name for file in (tmp_path / "rig").iterdir()} == {"intrinsics.yml", "extrinsics.yml"}
    for name in ("intrinsics.yml", "extrinsics.yml", ""):
        assert_same_rig(opencv_yaml.read_opencv(tmp_path / "rig" / name), make_rig(), 1e-12)
    with pytest.raises(OutputExistsError):
        opencv_yaml.write_opencv(tmp_path / "rig", make_rig())


def test_skew_is_refused_and_fisheye_is_loud(tmp_path):
    with pytest.raises(DataError, match="skew"):
        opencv_yaml.write_opencv(tmp_path / "rig.yml", make_rig(skew=0.5))
    assert not list(tmp_path.iterdir())
    rig = make_rig("fisheye4")
    with pytest.warns(UserWarning, match=r"cv2\.fisheye"):
        opencv_yaml.write_opencv(tmp_path / "rig.yml", rig)
    assert_same_rig(opencv_yaml.read_opencv(tmp_path / "rig.yml"), rig, 1e-12)


def test_a_rig_that_nothing_rectifies_is_written_without_its_rectification(tmp_path):
    rig = make_rig(t=(0.0, 0.01, -0.06))  # one camera behind the other
    with pytest.warns(UserWarning, match="without R1, R2, P1, P2 and Q: the baseline is"):
        opencv_yaml.write_opencv(tmp_path / "rig.yml", rig)
    assert "R1" not in (tmp_path / "rig.yml").read_text()
    assert_same_rig(opencv_yaml.read_opencv(tmp_path / "rig.yml"), rig, 1e-12)


def test_units(tmp_path):
    path = tmp_path / "rig.yml"
    opencv_yaml.write_opencv(path, make_rig(t=(-75.0, 1.0, 1.0)))
    with pytest.warns(UserWarning, match="unit='mm'"):
        opencv_yaml.read_opencv(path)
    assert opencv_yaml.read_opencv(path, unit="mm").T_right_left.t[0] == pytest.approx(-0.075, rel=1e-12)
    assert not opencv_yaml.read_opencv(path, unit="board pitch").is_metric


def test_contradictions_and_unlikely_numbers_are_said():
    rig = make_rig(t=(0.06, 0.0, 0.0))
    sentences = opencv_yaml.suspicions(rig, {"R1": np.eye(3), "R2": np.eye(3), "P1": -np.eye(3, 4)})
    assert [any(word in s for s in sentences) for word in ("contradict", "negative focal", "exchanged")] == [True] * 3
    assert opencv_yaml.suspicions(make_rig(), {}) == []
    wide = make_rig(skew=1.0)
    assert "skew" in opencv_yaml.suspicions(wide, {})[0]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "expected keys"),
        (
            "%YAML:1.0\n---\nM1: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 1., 2. ]\n",
            "3x3 holds 2 numbers",
        ),
        ("%YAML:1.0\n---\nM1: !!opencv-matrix\n   rows: 3\n   dt: d\n   data: [ 1. ]\n", "malformed"),
        ("%YAML:1.0\n---\nM1: !!opencv-matrix\n   rows: 1\n   cols: 1\n   dt: z\n   data: [ 1. ]\n", "matrix type 'z'"),
        ("%YAML:1.0\n---\na: [1\n", "not OpenCV YAML"),
        ("%YAML:1.0\n---\na: 1\n", "matrix M1 is missing"),
        ("{", "not JSON"),
        ("<opencv_storage>", "not XML"),
        ("<!DOCTYPE x [<!ENTITY a 'b'>]><x>&a;</x>", "entities"),
    ],
)
def test_broken_files_are_refused_by_name(tmp_path, text, expected):
    path = tmp_path / "rig.yml"
    path.write_text(text)
    with pytest.raises(FormatError, match=expected) as caught:
        opencv_yaml.read_opencv(path, size_wh=(640, 480))
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_numbers_types_and_headers(tmp_path):
    path = tmp_path / "a.yml"
    path.write_text(
        "%YAML 1.2\n---\nm: !!opencv-matrix\n   rows: 1\n   cols: 6\n   dt: d\n"
        "   data: [ 0, .Nan, -.Inf, 1e5, 1.5e-3, -2. ]\n"
        'p: !!opencv-matrix\n   rows: 2\n   cols: 1\n   dt: "2f"\n   data: [ 1., 2., 3., 4. ]\n'
    )
    content = opencv_yaml.load_storage(path)
    np.testing.assert_array_equal(content["m"], [[0, np.nan, -np.inf, 1e5, 1.5e-3, -2]])
    assert content["p"].shape == (2, 1, 2)


def test_every_written_number_has_a_decimal_point():
    for x in (0.0, -0.0, 1.0, 640.0, 1e15, 1e-300, -0.1, 123456789.0):
        text = opencv_yaml._format_number(x)
        assert "." in text and float(text) == x


@pytest.mark.data
def test_real_files(data_dir):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        swapped = opencv_yaml.read_opencv(data_dir / "barry_swapped", size_wh=(640, 512))
    said = " ".join(str(warning.message) for warning in caught)
    assert swapped.left.model == "brown8" and "exchanged" in said and "unit='mm'" in said and len(caught) == 2
    charuco = opencv_yaml.read_opencv(data_dir / "rursprung_charuco" / "calibration.yml", unit="mm")
    assert charuco.baseline_m == pytest.approx(0.0753, abs=1e-4) and charuco.left.size_wh == (640, 480)
    with pytest.raises(FormatError, match="M1 is missing"):
        opencv_yaml.read_opencv(data_dir / "opencv_bouguet" / "left_intrinsics.yml")
    with pytest.raises(FormatError, match="matrix R is missing"):
        opencv_yaml.read_opencv(data_dir / "opencv_bouguet" / "intrinsics.yml")


GOOD_YAML = """%YAML:1.0
---
imageSize: [ 640, 480 ]
M1: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 500., 0., 320., 0., 500., 240., 0., 0., 1. ]
M2: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 500., 0., 320., 0., 500., 240., 0., 0., 1. ]
R: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 1., 0., 0., 0., 1., 0., 0., 0., 1. ]
T: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ -0.1, 0., 0. ]
"""


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("500.", "1" + "0" * 400),
        ("500.", "9" * 5000),
        ("500.", ".inf"),
        ("-0.1", ".nan"),
        ("[ 640, 480 ]", "[ .inf, 480 ]"),
        ("[ 640, 480 ]", "[ 1" + "0" * 400 + ", 480 ]"),
        ("[ 640, 480 ]", "[ 640, [480, 1] ]"),
        ("rows: 3", "rows: .inf"),
        ("rows: 3", "rows: -3"),
        ("rows: 3", "rows: 3.5"),
        ("   cols: 3", "   sizes: [ " + "1, " * 70 + "9 ]"),
        ("dt: d", "dt: '99999999999999999999d'"),
        ("T: !!opencv-matrix", "D1: { a: 1 }\nT: !!opencv-matrix"),
        ("T: !!opencv-matrix", "R1: nonsense\nT: !!opencv-matrix"),
        ("T: !!opencv-matrix", "unit: " + "x" * 5000 + "\nT: !!opencv-matrix"),
        ("T: !!opencv-matrix", "x: &a [1]\ny: *a\nT: !!opencv-matrix"),
        ("T: !!opencv-matrix", "x: " + "[" * 3000 + "\nT: !!opencv-matrix"),
        ("T: !!opencv-matrix", "x: !!int ''\nT: !!opencv-matrix"),
    ],
)
def test_impossible_values_are_one_line(tmp_path, old, new):
    path = tmp_path / "rig.yml"
    path.write_text(GOOD_YAML)
    assert read_opencv(path).baseline_m == 0.1
    path.write_text(GOOD_YAML.replace(old, new))
    with pytest.raises(FormatError) as caught:
        read_opencv(path)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 500
    find_format(path)


@pytest.mark.parametrize(
    "text",
    [
        '{"M1": ' + "9" * 5000 + "}",
        '{"M1": ' + "[" * 100_000,
        '<?xml version="1.0" encoding="utf-16"?><opencv_storage/>',
        '<?xml version="1.0" encoding="nonsense"?><opencv_storage/>',
        "<a>" * 20_000,
        "<opencv_storage>" + "<a>" * 20_000 + "</a>" * 20_000 + "</opencv_storage>",
    ],
)
def test_impossible_json_and_xml_are_one_line(tmp_path, text):
    path = tmp_path / "rig.xml"
    path.write_text(text)
    with pytest.raises(FormatError) as caught:
        read_opencv(path)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 500


def test_pipes_are_no_files(tmp_path):
    os.mkfifo(tmp_path / "rig.yml")
    with pytest.raises(FormatError, match="is a pipe"):
        read_opencv(tmp_path / "rig.yml")
    assert find_format(tmp_path / "rig.yml") is None
