"""The script that fetches the public image sets: whole or not at all, and nothing that is not what it should be."""

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "fetch_data.py"


@pytest.fixture(scope="module")
def fetch_data():
    specification = importlib.util.spec_from_file_location("fetch_data", SCRIPT)
    module = importlib.util.module_from_spec(specification)
    sys.modules["fetch_data"] = module
    specification.loader.exec_module(module)
    return module


@pytest.fixture
def published(fetch_data, tmp_path):
    """A set of two files on this machine, as an owner would publish it."""
    contents = {"left/01.png": b"left", "right/01.png": b"right"}
    for name, content in contents.items():
        path = tmp_path / "published" / name
        path.parent.mkdir(parents=True)
        path.write_bytes(content)
    url = (tmp_path / "published").as_uri() + "/"
    return fetch_data.ImageSet("pair", "nobody", "CC0", url, tuple(contents), fetch_data.digest_of(contents))


def test_a_set_is_fetched_once(fetch_data, published, tmp_path, capsys):
    folder = tmp_path / "data"
    assert fetch_data.main([str(folder)], (published,)) == 0
    assert (folder / "pair" / "right" / "01.png").read_bytes() == b"right"
    assert "pair: 2 files (nobody, CC0)" in capsys.readouterr().out
    assert fetch_data.main([str(folder)], (published,)) == 0
    assert "is there already" in capsys.readouterr().out


def test_other_files_and_missing_ones_leave_nothing(fetch_data, published, tmp_path, capsys):
    folder = tmp_path / "data"
    wrong = replace(published, digest="0" * 64)
    missing = replace(published, files=("left/02.png",))
    assert fetch_data.main([str(folder)], (wrong, missing)) == 1
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 2 and "not those that the table was made with" in said[0] and "02.png" in said[1]
    assert not folder.exists() or not any(folder.iterdir())


def test_every_set_of_the_readme_is_fetched_or_said_not_to_be(fetch_data):
    readme = (SCRIPT.parents[1] / "README.md").read_text(encoding="utf-8")
    table = readme.partition("| recording, views |")[2].partition("\n\n")[0]
    rows = [line.split("|")[1].split(",")[0].strip() for line in table.splitlines()[2:]]
    known = {images.name for images in fetch_data.SETS} | set(", ".join(fetch_data.NOT_FETCHED).split(", "))
    assert rows and set(rows) <= known


def test_the_digests_are_those_of_the_images_that_the_tests_use(fetch_data, data_dir):
    for images in fetch_data.SETS:
        folder = data_dir / images.name
        if folder.is_dir():
            assert fetch_data.digest_of({n: (folder / n).read_bytes() for n in images.files}) == images.digest
