"""What a fresh process loads, and that every public name is there."""

from __future__ import annotations

import ast
import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

import binocal

HEAVY = {"cv2", "scipy", "typer", "click", "rich", "pydantic", "torch", "gymnasium", "matplotlib", "yaml"}


def loaded_by(code: str) -> set[str]:
    """Top-level modules that a fresh interpreter has loaded after the code."""
    show = "\nimport sys; print('\\n' + ' '.join({name.partition('.')[0] for name in sys.modules}))"
    done = subprocess.run([sys.executable, "-c", code + show], capture_output=True, text=True, timeout=60, check=True)
    return set(done.stdout.splitlines()[-1].split())


def test_import_binocal_loads_numpy_at_most():
    assert not loaded_by("import binocal") & HEAVY


def test_the_value_types_load_numpy_and_no_more():
    loaded = loaded_by(
        "import binocal; binocal.Board, binocal.SE3, binocal.StereoRig, binocal.Detections, binocal.read_rig"
    )
    assert "numpy" in loaded and not loaded & HEAVY


def test_help_loads_nothing_heavy():
    loaded = loaded_by("from binocal.cli import main; main(['--help']); main(['calibrate', '--help'])")
    assert "typer" in loaded and not loaded & (HEAVY - {"typer", "click", "pydantic"} | {"numpy"})  # pydantic: by typer


def test_the_verbs_load_no_more_than_they_need():
    assert not loaded_by("import binocal.app") & (HEAVY - {"yaml"})


@pytest.mark.parametrize("name", sorted(set(binocal.__all__) - {"__version__"}))
def test_every_public_name_is_there(name):
    place = binocal._MODULE_OF[name]
    if importlib.util.find_spec(place) is None:
        pytest.skip(f"{place} is not part of this installation")
    assert getattr(binocal, name) is not None and name in dir(binocal)


def test_one_door_leads_to_the_compiled_kernel():
    # import-linter sees Python modules only
    place = Path(binocal.__file__).parent
    outside = [path for path in place.rglob("*.py") if path.parent != place / "kernels"]
    assert len(outside) > 50 and not [path for path in outside if "_kernel" in imported_names(path)]
    assert "_kernel" in imported_names(place / "kernels" / "__init__.py")


def imported_names(path: Path) -> set[str]:
    """Every part of every module name, and every name, that a source file imports."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import | ast.ImportFrom):
            names.update(alias.name for alias in node.names)
            names.update((getattr(node, "module", None) or "").split("."))
    return names


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = binocal.nothing
