"""The table of streets: every row is there, and says what was counted."""

from __future__ import annotations

import numpy as np
import pytest

from binocal.benchmark.streets import compare_on_streets
from binocal.rl import street_evaluation
from binocal.rl.agent_kind import AgentKind
from binocal.rl.evaluation import format_rows
from binocal.rl.match_batches import MATCH_SETS
from binocal.rl.policy import shipped_policy
from binocal.rl.street_evaluation import (
    AGENT,
    ALL,
    BOTH,
    ITS_MEAN,
    ITS_STEPS,
    MAGSAC,
    MANY,
    OTHERS,
    SCHEDULES,
    TRUTH,
    TUNED,
    WITHOUT_AGENT,
    found_row,
    replayed,
    schedules,
    solved_by,
    street_case,
)


def test_differences_are_paired():
    by_agent, other = np.array([1, 1, 0, 0], dtype=bool), np.array([1, 0, 1, 1], dtype=bool)
    row = found_row("set", "other", "", other, by_agent)
    assert row.found == 0.75 and row.more == pytest.approx(0.25)
    assert row.more_standard_error == pytest.approx(np.std([0, -1, 1, 1]) / 2)
    assert np.isnan(found_row("set", AGENT, "", by_agent, by_agent).more)


def test_actions_replayed_lead_where_they_led(monkeypatch):
    monkeypatch.setattr(street_evaluation, "TUNING_PROBLEMS", 2)
    case = street_case("drift_hard", 6, 0)
    end, actions = solved_by(shipped_policy(AgentKind.DRL_STREETS), case.matches.problem, case.start)
    assert np.array_equal(replayed(case.matches.problem, case.start, actions).R, end.R)
    assert not np.array_equal(replayed(case.matches.problem, case.start, np.roll(actions, 1, axis=1)).R, end.R)


def test_schedules_end_at_a_pixel_or_two():
    tried = list(schedules())
    assert len(set(tried)) == len(tried) == 36
    assert all(scales[-1] in (1.0, 2.0) and sorted(scales, reverse=True) == list(scales) for scales in tried)


@pytest.mark.slow
def test_all_controllers_have_a_row(monkeypatch):
    monkeypatch.setattr(street_evaluation, "TUNING_PROBLEMS", 4)
    rows, ms = compare_on_streets(n_problems=8, seed=0)
    names = {AGENT, ITS_MEAN, ITS_STEPS, OTHERS, TUNED, SCHEDULES, BOTH, MANY, MAGSAC, WITHOUT_AGENT, ALL, TRUTH}
    for name in MATCH_SETS:
        of_set = {row.controller: row for row in rows if row.set_name == name}
        assert set(of_set) == names and all(row.n_rigs == 8 for row in of_set.values())
        assert of_set[TRUTH].found >= of_set[TUNED].found - 0.25
    assert ms[AGENT] > 0 and all(row.controller in format_rows(rows) for row in rows)
