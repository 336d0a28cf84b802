from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Iterator
from pathlib import Path

# Before NumPy is imported: with a worker on every processor, BLAS threads that wait for one another make small solves ten times slower.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import jaxtyping
import pytest
from hypothesis import settings

import shape_checks

# A run in the background inherits an ignored interrupt, and so would the commands that the tests interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Before binocal is imported: what it states of types and shapes is checked at every call of the test run.
CHECKED = [
    "geometry",
    "cameras",
    "boards",
    "images",
    "datasets",
    "detection",
    "simulation",
    "printing",
    "metrics",
    "initialization",
    "set_checks",
    "rectification",
    "uncertainty",
    "requirements",
    "planning",
    "validation",
    "acceptance",
    "findings",
    "result",
    "evidence",
    "values",
    "errors",
    "threads",
    "progress",
    "plugins",
    "output",
    "input_file",
    "interruption",
    "yaml_text",
    "solvers",
    "kernels",
    "matching",
    "calibrators",
    "rl",
    "formats",
    "app",
    "benchmark",
    "report",
    "experiments",
    "printing",
]
shape_checks.install([f"binocal.{name}" for name in CHECKED])

settings.register_profile("binocal", deadline=None, max_examples=50, print_blob=True)
settings.load_profile("binocal")


@contextlib.contextmanager
def _without_checks() -> Iterator[None]:
    jaxtyping.config.update("jaxtyping_disable", True)
    try:
        yield
    finally:
        jaxtyping.config.update("jaxtyping_disable", False)


@pytest.fixture
def unchecked_types():
    """Lets wrong types through to a function's own checks, which are what a test of the caller's mistakes is about."""
    with _without_checks():
        yield


@pytest.fixture
def every_call_checked(monkeypatch):
    """No sampling of calls, for tests of the checks themselves."""
    monkeypatch.setattr(shape_checks.Sampling, "is_on", False)


@pytest.fixture(scope="module")
def many_calls():
    """For modules that call small functions so often that checking shapes would take most of the time; others check them."""
    with _without_checks():
        yield


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of the real images: BINOCAL_DATA, else ../shared/data from the project's root."""
    places = [Path(os.environ["BINOCAL_DATA"])] if os.environ.get("BINOCAL_DATA") else []
    places.append(Path(__file__).resolve().parents[2] / "shared" / "data")
    for place in places:
        if place.is_dir():
            return place
    pytest.skip(f"no real images: neither BINOCAL_DATA nor {places[-1]} is a folder")
