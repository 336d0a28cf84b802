"""The agent's benchmark: rows of every controller on every set, counted alike."""

import numpy as np
import pytest

from binocal.benchmark.agent import CLASSICAL
from binocal.rl.agent_kind import AgentKind
from binocal.rl.evaluation import (
    CORRECTED,
    MEAN_ACTION,
    compare_on,
    format_rows,
    held_out_rigs,
    simulated_evaluation_set,
    solve_rigs,
    tolerance_of,
)
from binocal.rl.policy import LearnedController, shipped_policy
from binocal.rl.registration import MAX_STEPS
from binocal.rl.rig_batches import RIG_SETS
from binocal.solvers.controllers import Marquardt

pytestmark = pytest.mark.usefixtures("many_calls")


@pytest.mark.slow
def test_all_controllers_have_a_row_and_the_text_shows_them():
    rows = compare_on(simulated_evaluation_set("weak", 24, seed=0), {"drl": shipped_policy(AgentKind.DRL)})
    assert {row.controller for row in rows} == {*CLASSICAL, CORRECTED, MEAN_ACTION, "drl"}
    assert all(row.n_rigs == 24 and 1 <= row.mean <= MAX_STEPS and 0 <= row.arrived <= 1 for row in rows)
    text = format_rows(rows)
    assert all(row.controller in text for row in rows)


def test_rigs_that_do_not_arrive_count_in_full():
    rigs, start = held_out_rigs("weak", 6, 0)
    outcome = solve_rigs(rigs, start, Marquardt(), tolerance_of("weak"), max_steps=1)
    assert not outcome.has_arrived.any() and np.all(outcome.n_iterations == MAX_STEPS)


def test_packing_the_batch_changes_no_rig():
    rigs, start = held_out_rigs("stress", 12, 1)
    controller = LearnedController(shipped_policy(AgentKind.DRL))
    together = solve_rigs(rigs, start, controller, 0.3).n_iterations
    from binocal.solvers.arrays import take_rigs

    alone = [
        int(solve_rigs(rigs.select(i), take_rigs(start, i), controller, 0.3).n_iterations[0])
        for i in (np.array([k]) for k in range(12))
    ]
    assert together.tolist() == alone


def test_sets_are_held_out_by_name_and_seed():
    starts = [held_out_rigs(name, 2, seed)[1].T_right_left.R for name in ("standard", "weak") for seed in (0, 1)]
    assert all(not np.allclose(a, b) for i, a in enumerate(starts) for b in starts[i + 1 :])
    assert set(RIG_SETS) == {"standard", "weak", "stress", "good start", "unseen"}
