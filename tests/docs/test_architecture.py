"""The drawing of ARCHITECTURE.md is that of the code."""

import importlib.util
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "docs" / "make_architecture.py"


@pytest.fixture(scope="module")
def script():
    specification = importlib.util.spec_from_file_location("make_architecture", SCRIPT)
    module = importlib.util.module_from_spec(specification)
    sys.modules["make_architecture"] = module
    specification.loader.exec_module(module)
    return module


def test_the_drawing_is_up_to_date(script):
    assert script.PAGE.read_text(encoding="utf-8") == script.page(), "run: python docs/make_architecture.py"


def test_every_package_is_drawn_and_none_reaches_itself(script):
    packages = {p.parent.name for p in script.PACKAGE.glob("*/__init__.py")}
    assert packages <= set(script.LABELS)
    graph = script.imports()
    assert all(name not in script.reachable(graph, name) for name in graph)


def test_fewer_arrows_say_the_same(script):
    graph = {"a": {"b", "c"}, "b": {"c"}, "c": set()}
    assert script.reduced(graph) == {"a": {"b"}, "b": {"c"}, "c": set()}
    real = script.imports()
    fewer = script.reduced(real)
    assert all(script.reachable(real, name) == script.reachable(fewer, name) for name in real)
