"""One suite over every file format in the registry."""

from __future__ import annotations

import pytest

from binocal.errors import FormatError
from binocal.formats.registry import FORMATS, find_format, known_formats, load_format
from binocal.formats.rig_file import load_rig
from contracts import foreign_content_is_not_taken_for_its_own, make_rigs, what_is_written_comes_back_but_for_the_losses
from rigs import assert_same_rig

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")  # OpenCV's files warn of fisheye lenses


@pytest.mark.parametrize("name", FORMATS)
def test_what_is_written_comes_back_but_for_the_losses(name, tmp_path):
    what_is_written_comes_back_but_for_the_losses(name, tmp_path)


@pytest.mark.parametrize("name", FORMATS)
def test_foreign_content_is_not_taken_for_its_own(name, tmp_path):
    foreign_content_is_not_taken_for_its_own(name, tmp_path, tuple(other for other in FORMATS if other != name))


@pytest.mark.parametrize("name", FORMATS)
def test_a_file_is_known_by_its_content_not_its_name(name, tmp_path):
    rig, file_format = make_rigs()[0], load_format(name)
    file_format.write(tmp_path / f"rig{file_format.suffixes[0]}", rig)
    renamed = (tmp_path / f"rig{file_format.suffixes[0]}").rename(tmp_path / "rig.txt")
    assert find_format(renamed).name == name
    assert_same_rig(load_rig(renamed), rig, 1e-12)


def test_names():
    assert known_formats()[: len(FORMATS)] == tuple(FORMATS)
    with pytest.raises(ValueError, match="'kalibr'; known: binocal, opencv"):
        load_format("kalibr")
    assert find_format("no such file") is None
    with pytest.raises(FormatError, match="no such file"):
        load_rig("no-such-file.json")
