"""Stated types are true: every annotation resolves, and a wrong shape is noticed wherever the tests go."""

import importlib
import inspect
import pkgutil
import typing

import jaxtyping
import numpy as np
import pytest

import binocal
from binocal.cameras import Camera
from binocal.evidence import Detections
from binocal.geometry import SE3, so3
from binocal.solvers import robust

OPTIONAL = {
    "EnvSpec": "gymnasium resolves it in its own modules only",
    "Axes": "needs the report extra",
    "TrainingRun": "needs the train extra",
}


def modules():
    for found in pkgutil.walk_packages(binocal.__path__, "binocal."):
        if not found.name.endswith("__main__"):
            yield importlib.import_module(found.name)


def public_callables():
    """Every public function, class and method that the package defines."""
    for module in modules():
        for name, value in vars(module).items():
            if name.startswith("_") or getattr(value, "__module__", None) != module.__name__:
                continue
            if inspect.isfunction(value):
                yield f"{module.__name__}.{name}", value
            elif inspect.isclass(value):
                yield f"{module.__name__}.{name}", value
                for method, member in vars(value).items():
                    function = getattr(member, "__func__", getattr(member, "fget", member))
                    if inspect.isfunction(function) and (not method.startswith("_") or method == "__init__"):
                        yield f"{module.__name__}.{name}.{method}", function


def test_every_annotation_resolves():
    failures, count = [], 0
    for name, value in public_callables():
        count += 1
        try:
            typing.get_type_hints(value)
        except NameError as error:
            if error.name not in OPTIONAL:
                failures.append(f"{name}: {error}")
        except Exception as error:  # whatever it is, a user's type checker would meet it
            failures.append(f"{name}: {error!r}")
    assert not failures
    assert count > 600  # the walk found the package


def test_users_see_arrays_with_shapes():
    hints = typing.get_type_hints(Detections)
    assert hints["left_px"].dim_str == "views n 2" and hints["left_px"].array_type is np.ndarray
    assert typing.get_type_hints(SE3)["t"].dim_str == "*batch 3"


@pytest.mark.usefixtures("every_call_checked")
@pytest.mark.parametrize(
    "call",
    [
        lambda: so3.hat(np.zeros((2, 4))),
        lambda: so3.hat(np.zeros(3, dtype=int)),
        lambda: SE3(np.eye(3), np.zeros((5, 3))),
        lambda: robust.weights(np.zeros((4, 3)), np.zeros((2, 1)), "hampel"),
        lambda: robust.weights(np.zeros((4, 3)), np.zeros((4, 3)), "median"),
        lambda: Camera("brown4", (640, 480), np.array([500.0, 500, 320, 240, 0, 0, 0, 0, 0])).project(np.zeros((7, 2))),
        lambda: binocal.read_calibration(7),
    ],
    ids=["last axis", "dtype", "batch", "two arrays", "literal", "method", "path"],
)
def test_what_is_stated_is_checked_while_the_tests_run(call):
    with pytest.raises(jaxtyping.TypeCheckError):
        call()


def test_every_package_is_checked():
    """The import hook of conftest.py reaches all of the package but the command line, whose options typer fills in."""
    unchecked = set()
    for module in modules():
        functions = [f for f in vars(module).values() if inspect.isfunction(f) and f.__module__ == module.__name__]
        annotated = [f for f in functions if f.__annotations__]
        if annotated and not any(hasattr(f, "__wrapped__") for f in annotated):
            unchecked.add(module.__name__)
    assert {name for name in unchecked if not name.startswith("binocal.cli")} == set()
