"""The benchmark of the related work's calibrators: cases x methods x seeds to rows."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from binocal.benchmark import related as benchmark
from binocal.experiments import related, related_cases
from binocal.experiments.case import Case, by_calibrator
from binocal.experiments.run import rows_of, run_cases


def rows_of_case(case, seeds):
    return [row.document() for row in rows_of([case], seeds, run_cases([case], seeds))]


def test_a_row_is_the_median_over_the_seeds_with_the_refused_ones_counted():
    sample = related_cases.board_corners(0)
    few = related_cases.Sample(
        sample.evidence.select(np.arange(2)), sample.truth, sample.board, sample.bound, sample.choices
    )

    def make(seed):
        return few if seed == 1 else related_cases.board_corners(seed)

    methods = (by_calibrator("lm"), by_calibrator("absolute-orientation", refine=True))
    rows = rows_of_case(Case("boards", make, related_cases.rig_errors, methods, {"rotation error": "1"}), (0, 1, 2))
    assert [row["calibrator"] for row in rows[::5]] == ["lm", "absolute-orientation (refine True)"]
    for row in rows:
        assert row["seeds"] == 3 and row["failures"] == 1 and row["low"] <= row["median"] <= row["high"]
    turn = rows[0]
    assert turn["criterion"] == "rotation error" and turn["unit"] == "deg" and turn["paper"] == "1"
    assert 0.2 < turn["median"] / turn["bound"] < 3.0
    over = {(row["calibrator"], row["criterion"]): row["median"] for row in rows}
    assert over["lm", "errors over the bound, rms"] < 1.5 < over[methods[1].label, "errors over the bound, rms"]


def test_a_method_that_is_always_refused_has_a_row():
    sample = related_cases.board_corners(0)
    few = related_cases.Sample(sample.evidence.select(np.arange(2)), sample.truth, choices=sample.choices)
    case = Case("two views", lambda seed: few, related_cases.rig_errors, (by_calibrator("lm"),))
    (row,) = rows_of_case(case, (0, 1))
    assert row["failures"] == row["seeds"] == 2 and row["median"] is None
    assert "lm" in benchmark._text([row], "m") and "refused with every seed" in benchmark._text([row], "m")


def test_turning_cameras_are_measured_pair_by_pair():
    make = related_cases.Turning(3, 1.0)
    (case,) = (Case("turning", make, related_cases.turning_errors, (by_calibrator("rectangles"),), related.WANG_2019),)
    rows = {row["criterion"]: row for row in rows_of_case(case, (0,))}
    # half of what the cited work reports
    assert rows["attitude, rms"]["median"] < 0.06 and rows["attitude, rms"]["paper"] == "0.12"
    assert rows["translation, rms"]["median"] < 3.6 and rows["coordinates, rms"]["median"] < 0.8


def test_a_cubic_goes_through_the_settings_and_follows_a_cubic():
    x = np.linspace(0, 1, 6)
    y = np.stack([x**3, 1 - x], axis=-1)
    for at in (0.0, 0.33, 0.5, 0.93, 1.0):
        assert np.allclose(related_cases._cubic(x, y, at), [at**3, 1 - at])


def test_unknown_groups_are_named():
    with pytest.raises(ValueError, match="no group 'nothing' of cases; there are boards"):
        benchmark.run_related_benchmark(groups=("nothing",))


def test_every_group_names_its_cases_once_and_other_processes_can_have_them():
    groups = related.related_groups()
    names = [case.name for cases in groups.values() for case in cases]
    assert len(names) == len(set(names)) >= 14
    assert all(case.table == name for name, cases in groups.items() for case in cases)
    assert [case.name for case in pickle.loads(pickle.dumps(related.own_input_cases()))] == names[1:]


def test_the_attitudes_are_as_uncertain_as_the_case_says():
    sample = related_cases.Turning(40, 1.0)(0)
    given, truth = sample.evidence, sample.truth
    said = np.stack([given.left_attitude_rad, given.right_attitude_rad], axis=1)[1:]  # known at rest, before they turn
    assert given.attitude_sigma_rad[1:] == pytest.approx(np.radians(1.0))
    off_deg = np.degrees(said - truth.angles_rad[1:])
    assert np.sqrt(np.mean(off_deg**2)) == pytest.approx(1.0, rel=0.2)  # 156 figures
