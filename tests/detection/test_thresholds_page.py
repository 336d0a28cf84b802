"""The page's table of thresholds has every constant of the search for chessboards, with the value that the code has."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import numpy as np
import pytest

from binocal.detection.finding.search import level_settings

PAGE = Path(__file__).parents[2] / "docs" / "how-a-chessboard-is-found.md"
MODULES = (
    "finding.search", "finding.xcorners", "finding.groups", "finding.completion", "finding.lattice", "finding.growth",
    "finding.regularity", "finding.planes", "chessboard.rivals", "chessboard.sightings", "chessboard.decision",
    "chessboard.verification", "chessboard.appearance",
)  # fmt: skip


def rows():
    """Name, value and unit of every row."""
    text = PAGE.read_text(encoding="utf-8").split("## Every threshold")[1]
    return re.findall(r"^\| `([\w.()]+)` \| ([^|]*) \| ([^|]*) \|", text, re.MULTILINE)


def numbers(text):
    return [float(number) for number in re.findall(r"-?[\d.]+", text)]


def flat(value):
    return [float(number) for part in value for number in flat(part)] if isinstance(value, tuple | list) else [value]


def constant(name):
    module, attribute = name.rsplit(".", 1)
    return getattr(importlib.import_module(f"binocal.detection.{module}"), attribute)


@pytest.mark.parametrize(("name", "value", "unit"), rows(), ids=[row[0] for row in rows()])
def test_the_page_states_the_codes_value(name, value, unit):
    if name.startswith("kernels."):  # compiled: the function's description states its limits
        module, function = name.rsplit(".", 1)
        text = getattr(importlib.import_module(f"binocal.{module}"), function).__doc__
        assert set(numbers(value)) <= {float(n) for n in re.findall(r"\d+(?:\.\d+)?", text)}
        return
    if name.startswith("finding.search.level_settings"):
        assert numbers(value) == pytest.approx(flat(level_settings(int(name[-2]))))
        return
    expected = flat(constant(name))
    if unit == "degrees":
        expected = list(np.degrees(expected))
    assert numbers(value) == pytest.approx(expected)


def test_no_threshold_is_missing_and_none_stands_twice():
    names = [name for name, _, _ in rows()]
    assert len(names) == len(set(names))
    for module_name in MODULES:
        module = importlib.import_module(f"binocal.detection.{module_name}")
        source = Path(module.__file__).read_text(encoding="utf-8")
        own = re.findall(r"^([A-Z][A-Z_0-9]*(?:, [A-Z][A-Z_0-9]*)*) = ", source, re.MULTILINE)
        missing = {f"{module_name}.{name}" for line in own for name in line.split(", ")} - set(names)
        assert not missing


@pytest.mark.parametrize("name", ["chessboard-search.svg", "chessboard-growth.svg"])
def test_the_pages_drawings_exist(name):
    assert f"]({name})" in PAGE.read_text(encoding="utf-8")
    assert (PAGE.parent / name).read_text(encoding="utf-8").startswith("<svg")
