from __future__ import annotations

import os
import stat

import pytest

from binocal import output
from binocal.errors import DataError, OutputExistsError


def test_writes_and_leaves_no_second_file(tmp_path):
    target = tmp_path / "new" / "rig.json"
    output.write_aside(target, "{}")
    assert target.read_text() == "{}" and os.listdir(target.parent) == ["rig.json"]
    (tmp_path / "plain").touch()
    assert stat.S_IMODE(target.stat().st_mode) == stat.S_IMODE((tmp_path / "plain").stat().st_mode)


def test_refuses_to_overwrite_without_force(tmp_path):
    target = tmp_path / "rig.json"
    target.write_text("old")
    with pytest.raises(OutputExistsError, match="--force") as caught:
        output.write_aside(target, "new")
    assert isinstance(caught.value, FileExistsError) and target.read_text() == "old"
    output.write_aside(target, "new", force=True)
    assert target.read_text() == "new"


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    target = tmp_path / "rig.json"
    target.write_text("old")

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(DataError, match="No space left"):
        output.write_aside(target, "new", force=True)
    assert target.read_text() == "old" and os.listdir(tmp_path) == ["rig.json"]


def test_a_folder_or_a_file_in_the_way_is_named(tmp_path):
    with pytest.raises(DataError, match="is a folder"):
        output.check_output(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="folder cannot be made"):
        output.check_output(tmp_path / "file" / "rig.json")
