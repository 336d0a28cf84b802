"""An agent that the first half of the views trains: the same weights for the same seed, and its history for the figure."""

from __future__ import annotations

import numpy as np
import pytest

from binocal.experiments import guesses, trained
from binocal.experiments.boards import nominal_rig
from binocal.experiments.case import results_of
from binocal.report.training import training_drawing

pytest.importorskip("torch")


@pytest.mark.slow
def test_the_first_half_trains_and_the_second_is_solved(monkeypatch, tmp_path):
    monkeypatch.setattr(guesses, "N_GUESSES", 3)
    monkeypatch.setattr(trained, "N_RIGS", 16)
    (case,) = trained.trained_cases(nominal_rig(), tmp_path)
    sample = case.make(0)
    assert not set(sample.training.names) & set(sample.evidence[0].names) and sample.training.n_views == 20
    method = trained.TrainsFirst("drl, hard targets, trained here", "hard", str(tmp_path), n_steps=2000)
    short = type(case)(case.name, lambda seed: sample, case.measure, (method,))
    (result,) = results_of(short, 0)
    figures = {m.criterion: m.value for m in result.measured}
    assert figures["ended in the right minimum"] == 100 and figures["held-out iterations at the end"] >= 1
    (history,) = trained.histories_in(tmp_path, (0, 1))
    assert history.targets == "hard" and b"Critic loss" in training_drawing([history])
    off = history.value_predicted - history.value_monte_carlo
    assert figures["its value less the return, RMS"] == pytest.approx(np.sqrt(np.mean(off**2)))
