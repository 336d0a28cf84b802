"""Corners in a file: they come back to the last bit, and nothing but detections is taken for them."""

from __future__ import annotations

import json
import tempfile
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import binocal
from binocal.errors import FormatError, OutputExistsError
from binocal.evidence import Detections
from binocal.formats.detections_npz import is_detections_file, read_detections, write_detections
from rigs import assert_same_detections, detections, make_detections, make_poses, make_rig


def make(n_views=3):
    return make_detections(
        make_rig(), make_poses(n_views, np.random.default_rng(0)), noise_px=0.1, rng=np.random.default_rng(1)
    )


@settings(max_examples=60)
@given(detections())
def test_write_then_read_gives_the_same_bits(given_detections):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "corners.npz"
        write_detections(path, given_detections)
        back = read_detections(path)
        assert_same_detections(back, given_detections)
        write_detections(Path(folder) / "again.npz", back)
        assert (Path(folder) / "again.npz").read_bytes() == path.read_bytes()


def test_numpy_reads_it_without_pickle(tmp_path):
    write_detections(tmp_path / "corners.npz", make())
    with np.load(tmp_path / "corners.npz", allow_pickle=False) as content:
        np.testing.assert_array_equal(content["left_px"], make().left_px)
        header = json.loads(bytes(content["header"]))
    assert header["schema"] == "binocal/detections" and header["version"] == 1 and header["names"] == ["0", "1", "2"]


def test_nothing_is_overwritten_unasked(tmp_path):
    path = tmp_path / "corners.npz"
    binocal.write_detections(path, make())
    with pytest.raises(OutputExistsError):
        binocal.write_detections(path, make(2))
    assert binocal.read_detections(path).n_views == 3
    binocal.write_detections(path, make(2), force=True)
    assert binocal.read_detections(path).n_views == 2


def damaged(content: bytes):
    """The file cut short everywhere it can hurt, and single bytes of it changed."""
    rng = np.random.default_rng(0)
    for end in (0, 1, 10, 100, len(content) // 2, len(content) - 30, len(content) - 1):
        yield content[:end]
    for place in rng.integers(0, len(content), 150).tolist() + list(range(len(content) - 200, len(content), 3)):
        yield content[:place] + bytes([content[place] ^ (1 << int(rng.integers(8)))]) + content[place + 1 :]


def test_whatever_is_damaged_is_refused_by_name_or_reads_the_same(tmp_path):
    path = tmp_path / "corners.npz"
    write_detections(path, make())
    whole = read_detections(path)
    n_refused = 0
    for content in damaged(path.read_bytes()):
        path.write_bytes(content)
        try:
            back = read_detections(path)
        except FormatError as error:
            n_refused += 1
            assert str(error).startswith(str(path)) and "\n" not in str(error)
            assert "binocal.write_detections" in str(error)
        else:  # a byte that no reader looks at: a date, a flag
            assert_same_detections(back, whole)
    assert n_refused > 150


def rewritten(path, change):
    """The file with its arrays and header changed."""
    with np.load(path) as content:
        arrays = dict(content)
    header = json.loads(bytes(arrays["header"]))
    change(arrays, header)
    if "header" in arrays:
        arrays["header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    np.savez(path, **arrays)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda a, h: a.pop("header"), "'header' is missing"),
        (lambda a, h: h.update(schema="other/1"), 'expected the schema "binocal/detections"'),
        (lambda a, h: h.update(version=2), "version is 2, this binocal reads 1"),
        (lambda a, h: h.update(names="abc"), "key 'names': expected a list of texts"),
        (lambda a, h: h.update(names=["0"]), "1 names for 3 views"),
        (lambda a, h: h.update(left_size_wh=[0, 3]), "an image size"),
        (lambda a, h: h.update(right_size_wh=[640.5, 480]), "key 'right_size_wh': expected two whole numbers"),
        (lambda a, h: h.update(is_metric=1), "key 'is_metric': expected true or false"),
        (lambda a, h: h.pop("board"), "key 'board': expected a text or null"),
        (lambda a, h: a.pop("left_px"), "'left_px' is missing"),
        (lambda a, h: a.update(left_px=a["left_px"].astype(np.float32)), "'left_px': expected float64"),
        (lambda a, h: a.update(left_px=np.asfortranarray(a["left_px"])), "in C order"),
        (lambda a, h: a.update(left_px=a["left_px"][:, :5]), "corners must be"),
        (lambda a, h: a.update(right_px=a["right_px"] * np.inf), "infinite"),
        (lambda a, h: a.update(right_covariance_px2=-np.ones((3, 88, 2, 2))), "not a covariance"),
    ],
)
@pytest.mark.usefixtures("unchecked_types")
def test_what_is_wrong_is_named_with_its_place(tmp_path, change, expected):
    path = tmp_path / "corners.npz"
    write_detections(path, make())
    rewritten(path, change)
    with pytest.raises(FormatError, match=expected) as caught:
        read_detections(path)
    assert str(caught.value).startswith(str(path))


def test_foreign_files_are_refused(tmp_path):
    path = tmp_path / "corners.npz"
    with pytest.raises(FormatError, match="no such file"):
        read_detections(path)
    np.savez(path, x=np.array([{"pickled": 1}], dtype=object))
    with pytest.raises(FormatError, match="'header' is missing"):
        read_detections(path)
    write_detections(path, make(), force=True)
    rewritten(path, lambda a, h: a.update(left_px=np.array([{"pickled": 1}], dtype=object)))
    with pytest.raises(FormatError, match="'left_px': expected float64"):
        read_detections(path)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("header.npy", b"no array")
    with pytest.raises(FormatError, match="'header' is not a NumPy array"):
        read_detections(path)
    assert not is_detections_file(path) and not is_detections_file(tmp_path / "none.npz")


def test_an_array_larger_than_its_bytes_is_not_allocated(tmp_path):
    path = tmp_path / "corners.npz"
    write_detections(path, make())
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    old, new = b"(3, 88, 2), }" + b" " * 13, b"(99999999999999, 88, 2), }"
    assert old in members["left_px.npy"]
    members["left_px.npy"] = members["left_px.npy"].replace(old, new)
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    with pytest.raises(FormatError, match=r"fills its shape \(99999999999999, 88, 2\)"):
        read_detections(path)


names = st.lists(st.text(max_size=5), min_size=2, max_size=2, unique=True)


@given(names)
def test_any_name_comes_back(view_names):
    two = make(2)
    named = Detections.from_arrays(
        two.object_points_m, two.left_px, two.right_px, two.left_size_wh, names=tuple(view_names)
    )
    with tempfile.TemporaryDirectory() as folder:
        write_detections(Path(folder) / "c.npz", named)
        assert read_detections(Path(folder) / "c.npz").names == tuple(view_names)


def test_an_archive_that_fills_more_than_its_file_is_refused_unread(tmp_path):
    path = tmp_path / "corners.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("header.npy", bytes(64 << 20))
    assert path.stat().st_size < 100_000
    for read in (read_detections, is_detections_file):
        tracemalloc.start()
        try:
            assert read(path) is False
        except FormatError as error:
            assert "times the file" in str(error)
        _, most_bytes = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert most_bytes < 40 << 20
