"""Uncalibrated guesses: how they are drawn, and what an agent says of itself."""

from __future__ import annotations

import numpy as np
import pytest

from binocal.experiments import guesses
from binocal.experiments.boards import nominal_rig
from binocal.experiments.run import rows_of, run_cases
from binocal.geometry import so3


def test_guesses_lie_within_their_bounds(monkeypatch):
    monkeypatch.setattr(guesses, "N_GUESSES", 200)
    middle = nominal_rig().T_right_left
    drawn = guesses.draw_guesses(middle, 20.0, 0.3, np.random.default_rng(0))
    turns = [np.degrees(so3.angle_rad(T.R @ middle.R.T)) for T in drawn]
    shifts = [np.linalg.norm(T.t - middle.t) / 0.06 for T in drawn]
    assert 18 < max(turns) <= 20 and 0.27 < max(shifts) <= 0.3 and min(turns) < 2 and min(shifts) < 0.03
    assert guesses.draw_guesses(middle, 0.0, 0.0, np.random.default_rng(0)) == [middle]


def test_the_agent_leads_from_guesses_to_the_right_minimum(monkeypatch):
    monkeypatch.setattr(guesses, "N_GUESSES", 3)
    cases = guesses.guess_cases(nominal_rig())[:2]
    rows = {(r.case, r.calibrator, r.criterion): r.median for r in rows_of(cases, (0,), run_cases(cases, (0,)))}
    for case in ("parallel", "up to 20 deg, 30 % off"):
        for agent in guesses.AGENTS:
            assert rows[case, agent, "ended in the right minimum"] == 100
            assert (rows[case, agent, "steps chosen by the agent"] > 1) == (agent != "lm")
        assert rows[case, "drl", "iterations, all"] < rows[case, "lm", "iterations, all"]
    assert rows["parallel", "drl", "left by the agent where no guard did"] == pytest.approx(0.1, abs=0.1)
