"""Training histories: convergence by hand, files, and what is refused."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from binocal.errors import FormatError
from binocal.rl.history import converged_step, load_history, smoothed, write_history
from rl.training_runs import made_up_run


def test_convergence_is_the_first_step_from_which_the_loss_stays_near_its_end():
    # a fall of 100, so within 5 of the end; at 40 it leaves once more (too few points to be smoothed)
    loss = np.array([110, 60, 12, 40, 14, 11, 9, 10.0])
    assert converged_step(np.arange(10, 90, 10), loss) == 50


def test_a_loss_that_never_fell_did_not_converge():
    assert converged_step(np.arange(3), np.array([1.0, 2.0, 3.0])) is None
    assert converged_step(np.arange(0), np.zeros(0)) is None


def test_scatter_of_single_updates_does_not_put_convergence_off():
    run = made_up_run(0)
    assert 200 < run.converged_step < 700  # exp(-step / 100) is 0.05 at 300


def test_smoothing_is_the_mean_of_the_last_two_percent():
    loss = np.arange(200.0)
    np.testing.assert_allclose(smoothed(loss)[[0, 1, 3, 199]], [0, 0.5, 1.5, 197.5])


def test_a_file_returns_what_was_written(tmp_path):
    run = made_up_run(3, "hard")
    write_history(run, tmp_path / "run.npz")
    again = load_history(tmp_path / "run.npz")
    for f in fields(run):
        np.testing.assert_array_equal(getattr(again, f.name), getattr(run, f.name))
    assert [p.name for p in tmp_path.iterdir()] == ["run.npz"]


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK\x03\x04 torn"])
def test_another_file_is_refused(tmp_path, content):
    path = tmp_path / "run.npz"
    path.write_bytes(content)
    with pytest.raises(FormatError, match=r"run\.npz: not a training history"):
        load_history(path)


def test_an_archive_of_other_arrays_is_refused(tmp_path):
    np.savez(tmp_path / "run.npz", step=np.arange(3))
    with pytest.raises(FormatError, match="not a training history"):
        load_history(tmp_path / "run.npz")


@pytest.mark.usefixtures("unchecked_types")
def test_what_does_not_fit_is_refused():
    run = made_up_run(0)
    with pytest.raises(ValueError, match="soft or hard"):
        replace(run, targets="firm")
    with pytest.raises(ValueError, match="differ in length"):
        replace(run, critic_loss=run.critic_loss[:-1])
    with pytest.raises(ValueError, match="one axis"):
        replace(run, target_lag=np.zeros((1000, 1)))
    with pytest.raises(ValueError, match="read-only"):
        run.critic_loss[0] = 0
