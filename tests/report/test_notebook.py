"""A calibration in a notebook: what it shows of itself, its plots, and the example, whose cells are run."""

from __future__ import annotations

import ast
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="Matplotlib is an extra: pip install binocal[report]")

import matplotlib

from binocal.errors import DataError, MissingExtraError
from binocal.result import Covariance

NOTEBOOK = Path(__file__).parents[2] / "examples" / "calibration.ipynb"


@pytest.fixture(scope="module")
def shown():
    """The example's namespace, and what each cell showed."""
    matplotlib.use("agg")
    names, results = {}, []
    for cell in json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]:
        if cell["cell_type"] != "code":
            continue
        assert cell["outputs"] == [] and cell["execution_count"] is None
        body = ast.parse("".join(cell["source"])).body
        last = body.pop() if isinstance(body[-1], ast.Expr) else None
        exec(compile(ast.Module(body, []), str(NOTEBOOK), "exec"), names)
        results.append(
            None if last is None else eval(compile(ast.Expression(last.value), str(NOTEBOOK), "eval"), names)
        )
    yield names, results
    from matplotlib import pyplot

    pyplot.close("all")


def test_the_example_runs(shown):
    names, results = shown
    assert results[1] is names["calibration"]
    assert [len(result) for result in (results[2], results[3])] == [2, 2]
    assert results[2][0].get_title() == "left camera" and results[3][1].get_title().startswith(
        "right camera: residuals x "
    )
    assert results[5].get_xlim()[1] > 4 and results[6].startswith("2 m ± ")


def test_a_calibration_shows_its_verdict(shown):
    calibration = shown[0]["calibration"]
    text = calibration._repr_html_()
    assert "<b>No fault found.</b>" in text and text.count("<svg ") == 2 and "var(--" not in text
    assert "baseline" in text and "in the middle of the common view" in text
    bare = replace(calibration, evidence=None, T_left_board=None, covariance=Covariance((), np.zeros((0, 0))))
    assert bare._repr_html_().count("<svg ") == 1


def test_plots_use_the_axes_that_they_are_given_and_say_what_is_missing(shown, monkeypatch):
    from matplotlib.figure import Figure

    calibration = shown[0]["calibration"]
    axes = Figure().subplots()
    assert calibration.plot.rig(axes) is axes and len(axes.lines) > 12
    with pytest.raises(ValueError, match="nearest, farthest"):
        calibration.plot.depth(axes, ranges_m=(5.0, 1.0))
    with pytest.raises(DataError, match=r"nothing in common from 0\.001 to 0\.002 m"):
        calibration.plot.depth(axes, ranges_m=(1e-3, 2e-3))
    bare = replace(calibration, evidence=None, T_left_board=None)
    for draw, words in (
        (bare.plot.coverage, "no corners"),
        (bare.plot.residuals, "no corners"),
        (bare.plot.depth, "ranges_m"),
    ):
        with pytest.raises(DataError, match=words):
            draw()
    for name in ("matplotlib", "matplotlib.pyplot", "matplotlib.figure"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(MissingExtraError, match=r"binocal\[report\]"):
        calibration.plot.rig()
    assert "<svg" not in calibration._repr_html_() and "No fault found" in calibration._repr_html_()
