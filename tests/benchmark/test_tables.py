"""Tables of benchmarks in small: what is counted, what is summarised, what is printed."""

import io
import json
import sys

import numpy as np
import pytest

from binocal import benchmark
from binocal.benchmark import agent, corners, precision, training
from binocal.cli import main
from binocal.cli.progress import progress_on_terminal
from binocal.errors import TooFewViewsError
from binocal.rl.agent_kind import AgentKind
from binocal.rl.history import TrainingHistory
from binocal.rl.policy import shipped_policy


def test_precision_counts_errors_coverage_and_failures(monkeypatch):
    monkeypatch.setattr(precision, "VIEW_COUNTS", (8,))
    monkeypatch.setattr(precision, "MISSING_SHARES", (0.0, 0.3))
    table = benchmark.run("precision", n_rigs=12, seed=3)
    for row, missing in zip(table["rows"], (0.0, 0.3), strict=True):
        assert row["n_views"] == 8 and row["missing_share"] == missing and row["failures"] == 0
        assert 0.3 < row["rotation"] < 2 and 0.3 < row["translation"] < 2  # 12 rigs: 1 within a fifth or so
        assert 0.4 < row["within_one_sigma"] < 0.95 and 0.8 < row["within_two_sigma"] <= 1
    assert "8" in table["text"] and "30" in table["text"]


def test_unknown_benchmarks_are_named():
    with pytest.raises(ValueError, match="unknown benchmark 'speed'; known: agent, boards, circles, corners"):
        benchmark.run("speed")


def test_corners_are_scored_against_the_bound(monkeypatch):
    cases = corners._cases
    monkeypatch.setattr(corners, "_cases", lambda *given: cases(*given)[:1])
    (row,) = corners.run_corners_benchmark(blurs_px=(0.8,), noises_dn=(3.0,), images=1, images_a_lens=1)["rows"]
    ours = row["binocal"]
    assert row["case"] == "blur 0.8, noise 3" and 60 < ours["n_corners"] <= 88 and ours["n_failed"] == 0
    assert 0.7 < ours["over_bound"] < 1.3 < row["cornerSubPix"]["over_bound"]


@pytest.mark.parametrize(
    ("found", "expected"),
    [("right", {"right": 3}), ("refused", {"refused": 3}), ("wrong", {"wrong, flagged": 3})],
)
def test_wrong_minima_are_counted(found, expected, monkeypatch):
    from binocal.calibrators import calibrate

    def calibrated(detections, **options):
        if found == "refused":
            raise TooFewViewsError(1, 3)
        return calibrate(detections, **options)

    if found == "wrong":
        monkeypatch.setattr(agent, "WRONG_SIGMA", 0.0)
    monkeypatch.setattr(agent, "calibrate", calibrated)
    counts = agent.count_wrong_minima(3, 1, calibrator="lm")["counts"]
    assert {name: n for name, n in counts.items() if n} == expected


def made_up_history(targets, seed):
    step = np.arange(0, 1000, 10)
    loss, none = np.exp(-step / 100.0), np.zeros(0)
    return TrainingHistory(targets, seed, step, loss, loss, none, none, none.astype(int), none, none)


def test_ways_of_training_are_summarised_over_seeds(monkeypatch, tmp_path):
    class Run:
        """A run that was made before."""

        def __init__(self, options, pools, validation):
            self.options, self.elapsed_s, self.n_steps = options, 2.0, 0
            self.td3 = self

        def history(self):
            return made_up_history(self.options.td3.targets, self.options.seed)

        def policy(self, card):
            return shipped_policy(AgentKind.DRL)

        def target_lag(self):
            return 0.1

    class Imitated:
        def __init__(self, options, pools):
            self.n_steps = 0

        def generation(self):
            self.n_steps += 1000

        def policy(self):
            return shipped_policy(AgentKind.DRL)

    names = len(training.NAMES)
    monkeypatch.setattr(training, "simulated_pools", lambda options: ([], []))
    monkeypatch.setattr(training, "Training", Run)
    monkeypatch.setattr(training, "run_training", lambda run, on_check: None)
    monkeypatch.setattr(training, "Imitation", Imitated)
    monkeypatch.setattr(
        training,
        "_evaluated",
        lambda way, seed, policy, validation: {
            "way": way, "seed": seed, "iterations": [2.0 + seed] * names, "arrived": [1.0] * names,
        },
    )  # fmt: skip
    table = training.run_training_benchmark(n_seeds=3, n_steps=100, figure=tmp_path / "training.svg")
    assert [row["way"] for row in table["rows"]] == ["TD3, soft targets", "TD3, hard targets", "imitation"]
    for row in table["rows"]:
        assert row["median"] == [3.0] * names and row["least"] == [2.0] * names and row["greatest"] == [4.0] * names
    assert table["rows"][0]["converged_update"] > 0 and table["rows"][2]["converged_update"] is None
    assert "3 seeds, 100 steps each" in table["text"] and (tmp_path / "training.svg").stat().st_size > 1000


def test_progress_is_drawn_on_a_terminal_alone(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    with progress_on_terminal() as progress:
        assert progress is None
    monkeypatch.setattr(sys, "stderr", Terminal())
    with progress_on_terminal() as progress:
        progress("images", 1, 4)
        progress("images", 4, 4)
        progress("joint solve", 0, 1)
    assert "images" in sys.stderr.getvalue() and "4/4" in sys.stderr.getvalue()


def test_the_command_line_prints_a_benchmark_or_says_what_there_is(monkeypatch, capsys):
    monkeypatch.setattr(precision, "VIEW_COUNTS", (5,))
    monkeypatch.setattr(precision, "MISSING_SHARES", (0.0,))
    monkeypatch.setattr(precision, "_run_case", lambda n, missing, rigs, rng: row_of(n, missing, rigs))
    assert main(["bench", "precision", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rows"][0]["n_views"] == 5
    assert main(["bench", "speed"]) == 2


def row_of(n_views, missing, n_rigs):
    figures = dict.fromkeys(("rotation", "translation", "focal_length", "within_one_sigma", "within_two_sigma"), 1.0)
    return {"n_views": n_views, "missing_share": missing, "n_rigs": n_rigs, "failures": 0} | figures
