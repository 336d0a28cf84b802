"""Table 4 with everything that takes long replaced, and the real recordings of boards."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from binocal.app import experiment_times
from binocal.app.natural import NaturalRun
from binocal.benchmark.real_sets import sets_in
from binocal.boards import parse_board
from binocal.cli import main
from binocal.datasets import StereoPair
from binocal.errors import DataError, SceneError
from binocal.experiments import sets
from binocal.experiments.options import ExperimentOptions
from binocal.experiments.paper_page import paper_page, times_text
from binocal.experiments.real_boards import real_board_cases
from binocal.experiments.run import rows_of, run_cases
from binocal.geometry import SE3, so3
from binocal.result import Covariance
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig

OPTIONS = ExperimentOptions(48, 3)


def some_corners(n_views):
    rng, rig, board = np.random.default_rng(0), table2_rig(), parse_board("chessboard:11x8:20mm")
    scene = StereoScene(rig, board, sample_board_poses(rig, board, n_views, rng))
    return simulate_detections(scene, rng, noise_px=0.1)


@pytest.fixture
def fast(monkeypatch):
    """What was rendered, and how many pairs each recalibration had."""
    rendered, asked = [], []

    def recalibrate(source, options):
        asked.append((len(source.pairs), options.max_pairs, options.calibrator))
        T = SE3(so3.exp(np.radians([0.0, 0.1, 0.0])), source.rig.T_right_left.t)
        names = tuple(f"rotation.{axis}" for axis in "xyz")
        sigma = 1e-4 / np.sqrt(options.max_pairs)
        calibration = SimpleNamespace(
            rig=SimpleNamespace(T_right_left=T),
            covariance=Covariance(names, sigma**2 * np.eye(3)),
            views=("a",) * options.max_pairs,
        )
        run = object.__new__(NaturalRun)  # of which no more than this is looked at
        object.__setattr__(run, "calibration", calibration)
        object.__setattr__(run, "elapsed_s", {"matching": 2.0, "solve": 0.5})
        return run

    def calibrate(corners, *, calibrator, model):
        if calibrator == "opencv":
            raise SceneError("not this", 0, 1)

    monkeypatch.setattr(sets, "render_boards", lambda board, n, seed, folder: rendered.append(n))
    monkeypatch.setattr(
        sets, "render_street", lambda street, n, seed, folder: [StereoPair("0", Path("l.png"), Path("r.png"))] * n
    )
    monkeypatch.setattr(experiment_times, "detect_corners", lambda left, right, board: some_corners(3))
    monkeypatch.setattr(experiment_times, "calibrate", calibrate)
    monkeypatch.setattr(experiment_times, "recalibrate", recalibrate)
    return rendered, asked


def test_every_method_is_timed_and_what_the_journal_has_is_not_done_again(fast):
    rendered, asked = fast
    results = {(r.case, r.calibrator, r.seed): r for r in experiment_times.timed_results(OPTIONS, lambda *key: False)}
    assert len(results) == experiment_times.MOST_TIMED and rendered == [24]
    assert asked[:2] == [(16, 8, "drl"), (16, 16, "drl")]
    rows = experiment_times.rows_of_timed(OPTIONS, results)
    of_drl = {row.criterion: row for row in rows if (row.case, row.calibrator) == ("KITTI", "drl")}
    assert of_drl["seconds from images"].median == 2.5 and of_drl["seconds from images"].paper == 5.2
    assert of_drl["rotation from the set's own"].median == pytest.approx(0.1)
    assert of_drl["sigma of the rotation over that of twice the pairs"].median == pytest.approx(np.sqrt(2))
    (refused,) = [row for row in rows if row.calibrator == "opencv"]
    assert refused.failures == 1 and refused.median is None
    text = times_text(rows)
    assert "| opencv | 1 of 1 refused |" in text and "Seconds from images, s" in text and "rotation" not in text
    assert {row.table for row in paper_page(OPTIONS, rows).rows} == {"streets"}
    rendered.clear(), asked.clear()
    assert not list(experiment_times.timed_results(OPTIONS, lambda *key: True)) and not rendered and not asked


def test_a_quick_run_looks_at_few_pairs_of_one_street(fast):
    options = ExperimentOptions(48, 3, is_quick=True)
    cases = [result.case for result in experiment_times.timed_results(options, lambda *key: False)]
    assert cases.count("KITTI") == 1 and "Cityscapes" not in cases and fast[1] == [(4, 2, "drl"), (4, 4, "drl")]


def test_real_recordings_are_halved_and_lengths_measured_on_the_other_half():
    views = some_corners(12)
    cases = real_board_cases([("mine", views, "brown4"), ("short", views.select(np.arange(5)), "brown4")])
    assert [case.name for case in cases] == ["mine, 12 pairs"]
    case = cases[0]
    halves = case.make(0), case.make(1)
    assert {half.evidence.n_views for half in halves} == {6} and halves[0].evidence.names != halves[1].evidence.names
    assert not set(halves[0].evidence.names) & set(halves[0].held_out.names)
    some = [type(case)(case.name, case.make, case.measure, case.methods[:2], table=case.table)]
    rows = {(r.calibrator, r.criterion): r for r in rows_of(some, (0, 1), run_cases(some, (0, 1)))}
    assert rows["drl", "held-out length error"].median < 0.05 < rows["lm", "held-out error of a single side"].median
    assert rows["drl", "held-out row error"].median == pytest.approx(0.14, abs=0.05)  # of two corners


def test_folders_without_recordings_are_refused(tmp_path, capsys):
    with pytest.raises(DataError, match="holds no recording"):
        sets_in(tmp_path)
    assert main(["experiment", "--quick", "--measured", str(tmp_path), "--output", str(tmp_path / "out")]) == 3
    assert "holds no recording" in capsys.readouterr().err and not (tmp_path / "out" / "rows.jsonl").exists()
    assert main(["experiment", "--kitti", str(tmp_path / "none")]) == 2
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "set.json").write_text('{"board": "chessboard:9x6:30mm"}')
    assert [source.name for source in sets_in(tmp_path)] == ["mine"] == [s.name for s in sets_in(tmp_path / "mine")]
