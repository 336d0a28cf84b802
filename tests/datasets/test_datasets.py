"""Data sets in their original layouts: what is read, against the numbers written; what is broken, by its finding."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from tests.datasets import trees

from binocal.datasets import list_pairs, open_dataset
from binocal.datasets.frames import match_by_time
from binocal.datasets.kitti import read_raw_rig
from binocal.errors import DataError


def code_of(text) -> str:
    with pytest.raises(DataError) as caught:
        open_dataset(text)
    (found,) = caught.value.findings
    assert found.text == str(caught.value)
    return found.code


def replace_in(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


# --- what is read


def test_kitti_raw_rectified(tmp_path):
    drive = trees.kitti_raw(tmp_path)
    dataset = open_dataset(f"kitti:{drive}")
    assert dataset.is_rectified and len(dataset) == 3 and "gray" in dataset.layout
    assert "99.5 mm" in dataset.scale_source
    left, right = dataset.cameras
    np.testing.assert_allclose(left.K, [[50, 0, 30], [0, 50, 9], [0, 0, 1]])
    assert left.size_wh == right.size_wh == trees.SIZE and not left.distortion.any()
    np.testing.assert_allclose(dataset.rig.T_right_left.t, [-0.5, 0.001, 0], atol=1e-9)
    pair = list(dataset.pairs())[2]
    assert pair.name == "0000000003" and pair.left_path.parts[-3] == "image_00"
    assert pair.right_time_ns - pair.left_time_ns == 1 and pair.left_time_ns == 1317042163334126590
    assert [image.shape for image in pair.read_grey()] == [(20, 62), (20, 62)]
    colour = open_dataset(f"kitti:{drive}:colour")
    assert next(colour.pairs()).left_path.parts[-3] == "image_02"
    assert len(open_dataset(f"kitti:{tmp_path}")) == 3  # the only drive


def test_kitti_raw_unrectified(tmp_path):
    dataset = open_dataset(f"kitti:{trees.kitti_raw(tmp_path, is_rectified=False)}")
    assert dataset.is_rectified is False
    left, right = dataset.cameras
    assert (left.model, left.size_wh) == ("brown5", trees.RAW_SIZE)
    assert right.K[0, 0] == 61
    np.testing.assert_allclose(left.distortion, [-0.3, 0.2, 0.001, 0.002, -0.07])
    np.testing.assert_allclose(dataset.rig.T_right_left.R, trees.R_1, atol=1e-8)
    np.testing.assert_allclose(dataset.rig.T_right_left.t, trees.T_1, atol=1e-8)


@pytest.mark.parametrize(
    ("form", "n_rigs", "folder"),
    [("stereo2012", 2, "image_0"), ("stereo2015", 1, "image_2"), ("object", 2, "image_2"), ("odometry", 1, "image_0")],
)
def test_kitti_listed_layouts(tmp_path, form, n_rigs, folder):
    dataset = open_dataset(f"kitti:{trees.kitti_listed(tmp_path / 'training', form)}")
    assert form.replace("stereo", "stereo ") in dataset.layout and len(dataset) == 3 and dataset.is_rectified
    assert len(dataset.rigs) == n_rigs and next(dataset.pairs()).left_path.parent.name == folder
    parts = dataset.by_rig()
    assert len(parts) == n_rigs and len(parts[0]) >= len(parts[-1])
    assert parts[0].rig.baseline_m == pytest.approx(0.5, abs=1e-5)
    if form == "odometry":
        assert [pair.left_time_ns for pair in dataset.pairs()] == [0, 103735900, 2000000000]


def test_several_rigs_are_not_pooled(tmp_path):
    dataset = open_dataset(f"kitti:{trees.kitti_listed(tmp_path, 'object')}")
    with pytest.raises(DataError, match=r"3 pairs .* 2 different rigs") as caught:
        _ = dataset.cameras
    assert caught.value.findings[0].code == "dataset-has-several-rigs"
    assert [len(part) for part in dataset.by_rig()] == [2, 1]


def test_one_of_several_rigs_is_chosen_and_the_others_are_said(tmp_path):
    """Three cities of two pairs: two with the same calibration, one with another."""
    dataset = open_dataset(f"cityscapes:{trees.cityscapes(tmp_path)}")
    most = dataset.of_one_rig()
    assert len(most) == 4 and most.rig.baseline_m == pytest.approx(0.2)
    (said,) = most.findings
    assert said.code == "dataset-rigs-left-out" and "2 of 6 pairs are of 1 other" in said.text
    assert "lindau_000000_000019" in said.text and "most pairs" in said.text
    for choice in ({"frame": "lindau"}, {"frame": "lindau_000001_000019"}):
        other = dataset.of_one_rig(**choice)
        assert len(other) == 2 and other.rig.baseline_m == pytest.approx(0.3)
        assert "4 of 6 pairs" in other.findings[0].text and choice["frame"] in other.findings[0].text
    assert not open_dataset(f"cityscapes:{tmp_path}:val").of_one_rig().findings
    with pytest.raises(DataError, match="no pair is called berlin") as caught:
        dataset.of_one_rig(frame="berlin")
    assert caught.value.findings[0].code == "dataset-frame-unknown"
    object_set = open_dataset(f"kitti:{trees.kitti_listed(tmp_path / 'object', 'object')}")
    rigs = {rig.left.K[0, 0]: rig for rig in object_set.rigs}
    for focal_px, n_pairs in ((50.0, 2), (51.0, 1)):
        part = object_set.of_one_rig(like=rigs[focal_px])
        assert len(part) == n_pairs and part.rig is rigs[focal_px] and "cameras are" in part.findings[0].text


def test_cityscapes(tmp_path):
    root = trees.cityscapes(tmp_path)
    whole = open_dataset(f"cityscapes:{root}")
    assert len(whole) == 6 and [len(part) for part in whole.by_rig()] == [4, 2]
    for text in (f"{root}:train", f"{root}/leftImg8bit/train"):
        train = open_dataset(f"cityscapes:{text}")
        assert len(train) == 4
        np.testing.assert_allclose(train.rig.T_right_left.t, [-0.2, 0, 0])
        np.testing.assert_array_equal(train.cameras[0].K, [[50, 0, 30], [0, 51, 9], [0, 0, 1]])
    assert [p.name for p in open_dataset(f"cityscapes:{root}:val/lindau").pairs()] == [
        "lindau_000000_000019",
        "lindau_000001_000019",
    ]


def test_euroc(tmp_path):
    root = trees.euroc(tmp_path)
    for path in (root, root / "mav0"):
        dataset = open_dataset(f"euroc:{path}")
        assert len(dataset) == 4 and dataset.is_rectified is False and not dataset.findings
        np.testing.assert_allclose(dataset.rig.T_right_left.t, trees.T_1, atol=1e-10)
        np.testing.assert_allclose(dataset.rig.T_right_left.R, trees.R_1, atol=1e-10)
        np.testing.assert_allclose(dataset.cameras[1].distortion, [-0.28, 0.07, 0.0002, 1.8e-05])
    assert next(dataset.pairs()).left_time_ns == 1403715273262142976


def test_euroc_images_are_paired_by_the_nearest_time_and_the_others_named(tmp_path):
    root = trees.euroc(tmp_path, offset_ns=1_000_000)
    gone = root / "mav0" / "cam1" / "data" / "1403715273313142976.png"
    gone.unlink()
    dataset = open_dataset(f"euroc:{root}")
    assert [p.right_time_ns - p.left_time_ns for p in dataset.pairs()] == [1_000_000] * 3
    (found,) = dataset.findings
    assert found.code == "dataset-frames-left-out" and found.figures["n_out"] == 1
    assert "cam0/1403715273312142976.png" in found.text
    assert [path.name for path, _ in dataset.ignored] == ["1403715273312142976.png"]


def test_times_match_when_each_is_the_others_nearest():
    assert match_by_time([0, 10, 20], [4, 21], 5) == [(0, 0), (2, 1)]
    assert match_by_time([0, 10, 20], [5, 26], 5) == [(0, 0)]
    assert match_by_time([0, 3], [2], 5) == [(1, 0)]


def test_middlebury(tmp_path):
    root = trees.middlebury(tmp_path)
    for text in (f"{root}", f"{root}/curule", f"{root}:curule"):
        dataset = open_dataset(f"middlebury:{text}")
        left, right = dataset.cameras
        assert right.K[0, 2] - left.K[0, 2] == pytest.approx(1.75) and dataset.is_rectified
        np.testing.assert_allclose(dataset.rig.T_right_left.t, [-0.193001, 0, 0])
        assert [pair.name for pair in dataset.pairs()] == ["curule"]


@pytest.mark.parametrize("names", [("left/1.png", "right/1.png"), ("a_left.png", "a_right.png"), ("L1.png", "R1.png")])
def test_plain_folder(tmp_path, names):
    for grey, name in enumerate(names):
        trees.write_image(tmp_path / name, grey=50 + grey)
    dataset = open_dataset(f"folder:{tmp_path}")
    assert dataset.rig is None and dataset.cameras is None and dataset.is_rectified is None
    assert dataset.scale_source == "unknown"
    (pair,) = dataset.pairs()
    assert [path.name for path in (pair.left_path, pair.right_path)] == [name.rpartition("/")[2] for name in names]


def test_files_that_are_no_images_lack_no_partner(tmp_path):
    for name in ("left_1.png", "left_2.png", "right_1.png", "right_3.png"):
        trees.write_image(tmp_path / name, grey=50 + len(name) + int(name[-5]) + 10 * (name[0] == "r"))
    (tmp_path / "rig.json").write_text("{}")
    pairing = list_pairs(tmp_path, tmp_path)
    assert [pair.name for pair in pairing.pairs] == ["1"] and len(pairing.ignored) == 3
    assert [path.name for path in pairing.left_out] == ["left_2.png", "right_3.png"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("kitti:{}:red", r"gray or colour, not 'red'; write kitti:.*:gray or kitti:.*:colour"),
        ("euroc:{}:x", r"'x' means nothing here; leave it out"),
        ("folder:{}:x", r"'x' means nothing here; leave it out"),
    ],
)
def test_a_choice_that_there_is_not_is_named(tmp_path, text, message):
    with pytest.raises(DataError, match=message):
        open_dataset(text.format(tmp_path))


def test_a_path_may_hold_colons(tmp_path):
    root = trees.euroc(tmp_path / "at 12:30")
    assert len(open_dataset(f"euroc:{root}")) == 4
    assert code_of(f"euroc:{root}:gray") == "dataset-layout-unknown"


# --- what is broken


@pytest.mark.parametrize("text", ["/data", "vkitti:/data", "kitti", "kitti:", ""])
def test_a_kind_must_be_named(text):
    assert code_of(text) == "dataset-kind-unknown"


@pytest.mark.parametrize("kind", ["kitti", "cityscapes", "euroc", "middlebury", "folder"])
def test_a_folder_of_something_else_is_refused(tmp_path, kind):
    assert code_of(f"{kind}:{tmp_path}") == "dataset-layout-unknown"
    assert code_of(f"{kind}:{tmp_path / 'gone'}") == "dataset-layout-unknown"


@pytest.mark.parametrize(
    ("kind", "tree", "gone"),
    [
        ("kitti", trees.kitti_raw, "2011_09_26/2011_09_26_drive_0001_sync/image_01"),
        ("kitti", lambda root: trees.kitti_listed(root, "object"), "image_3"),
        ("cityscapes", trees.cityscapes, "rightImg8bit"),
        ("cityscapes", trees.cityscapes, "leftImg8bit/train/aachen"),
        ("euroc", trees.euroc, "mav0/cam1/data"),
        ("middlebury", trees.middlebury, "curule/im1.png"),
    ],
)
def test_a_missing_side_is_named(tmp_path, kind, tree, gone):
    tree(tmp_path)
    path = tmp_path / gone
    path.unlink() if path.is_file() else shutil.rmtree(path)
    assert code_of(f"{kind}:{tmp_path}") == "dataset-side-missing"


@pytest.mark.parametrize(
    ("kind", "tree", "gone"),
    [
        ("kitti", trees.kitti_raw, "2011_09_26/calib_cam_to_cam.txt"),
        ("kitti", lambda root: trees.kitti_listed(root, "object"), "calib/000002.txt"),
        ("kitti", lambda root: trees.kitti_listed(root, "odometry"), "calib.txt"),
        ("cityscapes", trees.cityscapes, "camera/train/bochum/bochum_000001_000019_camera.json"),
        ("euroc", trees.euroc, "mav0/cam0/sensor.yaml"),
        ("middlebury", trees.middlebury, "curule/calib.txt"),
    ],
)
def test_a_missing_calibration_is_named(tmp_path, kind, tree, gone):
    tree(tmp_path)
    (tmp_path / gone).unlink()
    with pytest.raises(DataError, match=gone.rpartition("/")[2]) as caught:
        open_dataset(f"{kind}:{tmp_path}")
    assert caught.value.findings[0].code == "dataset-calibration-missing"


@pytest.mark.parametrize(
    ("kind", "tree", "gone"),
    [
        ("kitti", trees.kitti_raw, "2011_09_26/2011_09_26_drive_0001_sync/image_00/data/0000000001.png"),
        ("kitti", lambda root: trees.kitti_listed(root, "stereo2015"), "image_3/000000_11.png"),
        ("cityscapes", trees.cityscapes, "rightImg8bit/val/lindau/lindau_000001_000019_rightImg8bit.png"),
    ],
)
def test_an_image_without_a_partner_is_named(tmp_path, kind, tree, gone):
    tree(tmp_path)
    (tmp_path / gone).unlink()
    assert code_of(f"{kind}:{tmp_path}") == "dataset-frames-unmatched"


def test_times_that_do_not_match_at_all_are_refused(tmp_path):
    assert code_of(f"euroc:{trees.euroc(tmp_path, offset_ns=10**12)}") == "dataset-frames-unmatched"


@pytest.mark.parametrize(
    ("kind", "tree", "image"),
    [
        ("kitti", trees.kitti_raw, "2011_09_26/2011_09_26_drive_0001_sync/image_00/data/0000000000.png"),
        ("euroc", trees.euroc, "mav0/cam1/data/1403715273262142976.png"),
        ("middlebury", trees.middlebury, "curule/im1.png"),
    ],
)
def test_a_size_that_is_not_the_calibrations_is_refused(tmp_path, kind, tree, image):
    tree(tmp_path)
    trees.write_image(tmp_path / image, (31, 10))
    assert code_of(f"{kind}:{tmp_path}") == "dataset-image-size-differs"


@pytest.mark.parametrize("resized", ["image_3", "image_[23]"])
@pytest.mark.parametrize("form", ["object", "odometry", "stereo2015"])
def test_resized_images_are_named_where_the_calibration_has_no_size(tmp_path, form, resized):
    for folder in trees.kitti_listed(tmp_path, form).glob(resized):
        for image in folder.iterdir():
            trees.write_image(image, (42, 13))
    with pytest.raises(DataError, match=r"has 42x13 pixels, .* is for (62x20|about 60x18)") as caught:
        open_dataset(f"kitti:{tmp_path}:colour")
    assert caught.value.findings[0].code == "dataset-image-size-differs"


def test_resized_images_of_a_city_are_named(tmp_path):
    for image in trees.cityscapes(tmp_path).glob("*Img8bit/train/aachen/*"):
        trees.write_image(image, (42, 13))
    with pytest.raises(DataError, match=r"has 42x13 pixels, .*camera\.json is for about 60x18") as caught:
        open_dataset(f"cityscapes:{tmp_path}")
    assert caught.value.findings[0].code == "dataset-image-size-differs"


def test_a_camera_model_that_is_not_read_is_named_with_what_to_do(tmp_path):
    replace_in(trees.euroc(tmp_path) / "mav0/cam0/sensor.yaml", "camera_model: pinhole", "camera_model: omni")
    with pytest.raises(DataError, match=r"'omni', only pinhole can be read; give the images with --left"):
        open_dataset(f"euroc:{tmp_path}")


def test_one_side_rectified_and_the_other_not_is_refused(tmp_path):
    drive = trees.kitti_raw(tmp_path)
    trees.write_image(drive / "image_01" / "data" / "0000000000.png", trees.RAW_SIZE)
    assert code_of(f"kitti:{drive}") == "dataset-image-size-differs"


def test_a_later_image_of_another_size_is_refused_when_read(tmp_path):
    drive = trees.kitti_raw(tmp_path)
    trees.write_image(drive / "image_01" / "data" / "0000000003.png", (31, 10))
    pairs = list(open_dataset(f"kitti:{drive}").pairs())
    pairs[0].read()
    with pytest.raises(DataError, match=r"0000000003\.png has 31x10") as caught:
        pairs[2].read()
    assert caught.value.findings[0].code == "dataset-image-size-differs"


KITTI_FILE = "2011_09_26/calib_cam_to_cam.txt"


@pytest.mark.parametrize(
    ("kind", "tree", "file", "old", "new", "message"),
    [
        ("kitti", trees.kitti_raw, KITTI_FILE, "P_rect_01: 5", "P_rect_01: x5", r"line 17: P_rect_01 holds .* number"),
        ("kitti", trees.kitti_raw, KITTI_FILE, "P_rect_01: 5", "P_rect_01: 1 5", r"line 17: P_rect_01 has 13 numbers, 12"),
        ("kitti", trees.kitti_raw, KITTI_FILE, "P_rect_01: 5", "P_rect_01: nan 5", r"line 17: P_rect_01 has"),
        ("kitti", trees.kitti_raw, KITTI_FILE, "P_rect_01:", "P_rect_09:", r"has neither P1 nor P_rect_01"),
        ("kitti", trees.kitti_raw, KITTI_FILE, "T_01:", "T_00:", r"line 14: T_00 stands twice"),
        ("kitti", trees.kitti_raw, KITTI_FILE, "T_01:", "T_01 ", r"line 14: has no ':'"),
        ("euroc", trees.euroc, "mav0/cam0/sensor.yaml", "data: [", "data: [0.5, ", r"line 3: T_BS has 17 numbers"),
        ("euroc", trees.euroc, "mav0/cam0/sensor.yaml", "[50.0, 51.0", "[50.0, 5x", r"line 10: intrinsics holds"),
        ("euroc", trees.euroc, "mav0/cam0/sensor.yaml", "[62, 20]", "[62, 20", r"line \d+: is not YAML"),
        ("euroc", trees.euroc, "mav0/cam0/sensor.yaml", "[50.0, 51.0", "[5.0, 5.1", r"focal length 5, 5\.1"),
        ("middlebury", trees.middlebury, "curule/calib.txt", "doffs=1.75", "doffs=17.5", r"line 3: doffs is not"),
        ("middlebury", trees.middlebury, "curule/calib.txt", "0 0 1]", "0 0 1", r"line 1: cam0 is not a matrix"),
        ("middlebury", trees.middlebury, "curule/calib.txt", "=193.001", "=0.193", r"baseline comes out as 0\.000193 m"),
        ("cityscapes", trees.cityscapes, "camera/train/aachen/aachen_000000_000019_camera.json", "}}", "}", r"is not JSON"),
        ("cityscapes", trees.cityscapes, "camera/train/aachen/aachen_000000_000019_camera.json", '"fx"', '"f"', r"intrinsic\.fx"),
    ],
)  # fmt: skip
def test_a_broken_calibration_is_refused_by_file_and_line(tmp_path, kind, tree, file, old, new, message):
    tree(tmp_path)
    replace_in(tmp_path / file, old, new)
    with pytest.raises(DataError, match=message) as caught:
        open_dataset(f"{kind}:{tmp_path}")
    assert caught.value.findings[0].code == "dataset-calibration-broken"
    assert str(tmp_path / file) in str(caught.value)


def test_rotations_that_contradict_the_rectification_are_refused(tmp_path):
    trees.kitti_raw(tmp_path, is_rectified=False)
    file = tmp_path / KITTI_FILE
    file.write_text(
        file.read_text().replace(f"R_01: {trees.numbers(trees.R_1)}", f"R_01: {trees.numbers(trees.R_1.T)}")
    )
    with pytest.raises(DataError, match="R_01 and R_rect_01 contradict"):
        open_dataset(f"kitti:{tmp_path}")


def test_several_drives_are_not_chosen_from(tmp_path):
    drive = trees.kitti_raw(tmp_path)
    shutil.copytree(drive, drive.with_name("2011_09_26_drive_0002_sync"))
    assert code_of(f"kitti:{drive.parent}") == "dataset-part-not-chosen"
    assert code_of(f"kitti:{drive}:red") == "dataset-layout-unknown"


def test_the_pages_example_runs(tmp_path, capsys):
    trees.kitti_raw(tmp_path)
    page = (Path(__file__).parents[2] / "docs" / "how-to" / "datasets.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    exec(compile(example.replace("/data/", f"{tmp_path}/"), "datasets.md", "exec"), {})
    assert capsys.readouterr().out.splitlines()[0] == "0000000000 1317042160334126590"


# --- published numbers


def test_the_published_kitti_calibration(data_dir):
    """Conventions against the file's own redundancy: R_rect_j R_j = R_rect_i R_i, and P_rect's baseline is the raw one."""
    drive = f"kitti:{data_dir / 'kitti_raw' / '2011_09_26' / '2011_09_26_drive_0002_sync'}"
    colour = open_dataset(f"{drive}:colour")
    assert len(colour) == 5 and colour.is_rectified
    np.testing.assert_allclose(colour.rig.T_right_left.t, [-0.53272, 0.00275, -0.00002], atol=1e-5)
    next(colour.pairs()).read()
    raw = read_raw_rig(data_dir / "kitti_raw" / "2011_09_26" / "calib_cam_to_cam.txt", (2, 3))
    np.testing.assert_allclose(raw.T_right_left.t, [-0.5326, 0.0066, -0.0090], atol=5e-5)
    assert raw.baseline_m == pytest.approx(colour.rig.baseline_m, abs=1e-4)
    gray = open_dataset(drive)
    assert gray.rig.baseline_m == pytest.approx(0.53715, abs=1e-5)


def test_the_published_kitti_calibration_room(data_dir):
    rig = read_raw_rig(data_dir / "kitti_calib_room" / "calib_cam_to_cam.txt")
    assert rig.left.size_wh == (1392, 512) and 0.5 < rig.baseline_m < 0.6 and not rig.is_swapped


def test_the_published_euroc_calibration(data_dir):
    dataset = open_dataset(f"euroc:{data_dir / 'euroc_micro'}")
    assert len(dataset) == 16 and not dataset.ignored
    np.testing.assert_allclose(dataset.rig.T_right_left.t, [-0.11007, 0.00040, -0.00085], atol=5e-6)
    next(dataset.pairs()).read_grey()


def test_the_published_middlebury_calibration(data_dir):
    dataset = open_dataset(f"middlebury:{data_dir / 'middlebury2021'}")
    assert dataset.rig.baseline_m == pytest.approx(0.08839) and dataset.cameras[0].K[0, 0] == 1758.23
