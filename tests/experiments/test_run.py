"""Cases x methods x seeds to rows: counting, the journal, and going on after a cut."""

from __future__ import annotations

import os

import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.errors import CancelledError, FormatError
from binocal.experiments import run
from binocal.experiments.case import Case, OpenCVThroughout, Result, Sample, results_of
from binocal.experiments.journal import Journal
from binocal.experiments.row import NAN, Measured
from binocal.experiments.run import rows_of, run_cases
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig
from small_cases import Fails, Several, make, measure

CASES = [Case("one", make, measure, (Fails(), Several()), {"length": "9.1", ("several", "share"): 95.0}, "3")]
SEEDS = (0, 1, 2)


def test_rows_count_failures_and_hold_median_and_spread():
    rows = rows_of(CASES, SEEDS, run_cases(CASES, SEEDS))
    assert [(r.table, r.calibrator, r.criterion) for r in rows] == [
        ("3", "fails", "length"), ("figure 6", "fails", "share"), ("3", "several", "length"), ("figure 6", "several", "share"),
    ]  # fmt: skip
    fails, _, several, share = rows
    assert (fails.median, fails.low, fails.high, fails.bound) == (11.0, 10.0, 12.0, 2.0)
    assert fails.failures == 1 and fails.seeds == 3 and several.failures == 0 and several.median == 11.0
    assert fails.paper == "9.1" and share.paper == 95.0
    assert rows_of(CASES, SEEDS, run_cases(CASES, SEEDS))[1].paper is None


def test_a_measure_without_a_number_is_no_number_in_the_row():
    case = Case("one", make, lambda made, sample: [Measured("length", "mm", NAN)], (Several(),))
    (row,) = rows_of([case], SEEDS, run_cases([case], SEEDS))
    assert row.median is None and row.criterion == "length" and row.failures == 0


def test_a_failure_is_told_in_one_line():
    assert results_of(CASES[0], 1)[0] == Result(
        "one", "fails", 1, failure="0 of 1 board poses found: not with this one"
    )


def test_opencv_throughout_works_from_its_own_corners():
    rng, rig, board = np.random.default_rng(0), table2_rig(), parse_board("chessboard:11x8:20mm")
    corners = simulate_detections(StereoScene(rig, board, sample_board_poses(rig, board, 6, rng)), rng, noise_px=0.05)

    def baseline(made, sample):
        return [Measured("baseline", "mm", 1e3 * made.rig.baseline_m)]

    def sample(theirs):
        return lambda seed: Sample(None, rig, board, choices={"model": "brown4"}, opencv_corners=theirs)

    results = [
        results_of(Case("one", sample(theirs), baseline, (OpenCVThroughout(),)), 0)[0] for theirs in (corners, None)
    ]
    assert results[0].measured[0].value == pytest.approx(1e3 * rig.baseline_m, abs=0.3)
    assert results[1].failure == "OpenCV finds the board in no pair." and not results[1].measured


def test_many_processes_find_what_one_does():
    one, two = (run_cases(CASES, SEEDS, workers=n) for n in (1, 2))
    assert {key: repr(one[key]) for key in one} == {key: repr(two[key]) for key in two}  # NaN is not NaN


def test_the_tracker_of_semaphores_is_told_to_say_nothing(monkeypatch):
    seen = []
    monkeypatch.setattr(run.resource_tracker, "ensure_running", lambda: seen.append(os.environ["PYTHONWARNINGS"]))
    monkeypatch.setenv("PYTHONWARNINGS", "default")
    run._quiet_tracker()
    assert seen == ["default,ignore:resource_tracker"] and os.environ["PYTHONWARNINGS"] == "default"
    monkeypatch.delenv("PYTHONWARNINGS")
    run._quiet_tracker()
    assert seen[1:] == ["ignore:resource_tracker"] and "PYTHONWARNINGS" not in os.environ


def test_a_cut_run_goes_on_where_it_was_and_ends_in_the_same(tmp_path):
    whole, cut = tmp_path / "whole.jsonl", tmp_path / "cut.jsonl"
    journal = Journal(whole, {"seeds": 3})
    expected = run_cases(CASES, SEEDS, journal=journal)
    journal.close()
    lines = whole.read_bytes().splitlines(keepends=True)
    assert len(lines) == 1 + 6
    cut.write_bytes(b"".join(lines[:4]) + lines[4][:17])  # killed in the middle of a line
    made = []

    def count(seed):
        made.append(seed)
        return make(seed)

    cases = [Case("one", count, measure, CASES[0].methods, CASES[0].paper, "3")]
    journal = Journal(cut, {"seeds": 3})
    assert run_cases(cases, SEEDS, journal=journal) == expected
    journal.close()
    assert made == [1, 2] and cut.read_bytes() == whole.read_bytes()
    again = Journal(cut, {"seeds": 3})
    again.close()
    assert again.results == expected


def test_the_journal_of_another_experiment_is_refused(tmp_path):
    Journal(tmp_path / "j", {"seeds": 3}).close()
    with pytest.raises(FormatError, match="the journal of another experiment"):
        Journal(tmp_path / "j", {"seeds": 4})
    (tmp_path / "k").write_text('{"experiment": {}}\n{"case": 1}\n')
    with pytest.raises(FormatError, match="line 2 is no result"):
        Journal(tmp_path / "k", {})


def test_stopping_keeps_what_was_done(tmp_path):
    journal, told = Journal(tmp_path / "j", {}), []
    with pytest.raises(CancelledError):
        run_cases(CASES, SEEDS, journal=journal, should_stop=lambda: True, progress=lambda *a: told.append(a))
    journal.close()
    assert told == [("cases", 0, 3), ("cases", 1, 3)] and len(journal.results) == 2
