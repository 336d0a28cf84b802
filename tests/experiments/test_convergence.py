"""The loss of every solver by iteration: how it is counted over stages, and what real solves show."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from binocal.experiments import convergence
from binocal.experiments.boards import nominal_rig
from binocal.experiments.convergence import END, FALL, LOSS, iterations_until, loss_figures
from binocal.experiments.run import rows_of, run_cases
from binocal.report.curves import Curve, _broken, draw_curves


def test_convergence_is_after_the_last_loss_that_is_too_large():
    assert iterations_until([9.0, 1.0, 5.0, 1.0, 1.0], 2.0) == 3
    assert iterations_until([1.0, 1.0], 2.0) == 0
    figures = loss_figures([101.0, 3.0, 1.2, 1.0])
    assert figures[FALL] == (1.0, "") and figures[END] == (3.0, "")
    assert figures["loss after iteration 2"] == (1.2, "px²") and figures["loss after iteration 80"] == (1.0, "px²")


def test_a_stage_begins_where_the_one_before_ended_and_what_comes_after_is_no_part_of_it():
    losses = convergence._Losses()

    def tell(n_corners, *values):
        for n_done, value in enumerate(values):
            problem = SimpleNamespace(residual_lengths2=lambda _, v=value: (np.full(n_corners, v), np.zeros(3)))
            losses(problem, SimpleNamespace(estimate=None), n_done)

    tell(10, 4.0, 2.0)  # one camera
    tell(20, 50.0, 1.0)  # both
    tell(10, 7.0, 6.0)  # a check afterwards
    assert losses.of_calibration() == pytest.approx([4.0, 50.0, 1.0])


def test_one_after_the_other_takes_longer_than_all_at_once():
    cases = convergence.convergence_cases(nominal_rig())
    rows = rows_of(cases, (0,), run_cases(cases, (0,)))
    ends = {row.calibrator: row.median for row in rows if row.criterion == END}
    assert ends["lm"] == ends["drl"] == 2 and ends["alternating"] > 20  # 38 measured
    assert ends["from-guess"] < ends["lm from the guess"]
    assert next(row.paper for row in rows if (row.calibrator, row.criterion) == ("drl", FALL)) == 30
    curves = {curve.label: curve.values for curve in convergence.loss_curves([r for r in rows if r.table == LOSS])}
    assert curves["lm"][0] > 1e3 * curves["lm"][-1]
    assert curves["lm"][-1] == pytest.approx(2 * 0.05**2, rel=0.1)  # both coordinates' noise, but for what is fitted


def test_a_curve_has_a_gap_where_the_next_stage_begins():
    x, y = _broken(Curve("a", (0, 1, 2, 5), (4.0, 2.0, 60.0, 1.0)))
    assert x[:2] == [0.0, 1.0] and x[3:] == [2.0, 5.0] and np.isnan(x[2]) and np.isnan(y[2])
    assert _broken(Curve("a", (0, 1), (1.0, 2.9))) == ([0.0, 1.0], [1.0, 2.9])


def test_curves_that_lie_on_each_other_are_one_line_of_the_legend():
    curves = [Curve("a", (0, 1), (2.0, 1.0)), Curve("b", (0, 1), (2.001, 1.0)), Curve("c", (0, 1), (3.0, 1.0))]
    drawing = draw_curves(curves, "loss (px²)", "Loss", {"printed": 1.0})
    assert ">a, b<" in drawing and ">c<" in drawing and "printed" in drawing and "loss (px²)" in drawing
    assert drawing == draw_curves(curves, "loss (px²)", "Loss", {"printed": 1.0})
    with pytest.raises(ValueError, match="nothing to draw"):
        draw_curves([], "loss", "Loss")
