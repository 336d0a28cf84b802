"""Table 4 with everything that takes long replaced, and the real recordings of boards."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from binocal.app import experiment_times
from binocal.app.corners import detect_corners
from binocal.app.experiment import experiment
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
from binocal.images import read_grey_image
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
        n_used = min(options.max_pairs, len(source.pairs))
        asked.append((len(source.pairs), n_used, options.calibrator))
        T = SE3(so3.exp(np.radians([0.0, 0.1, 0.0])), source.rig.T_right_left.t)
        names = tuple(f"rotation.{axis}" for axis in "xyz")
        sigma = 1e-4 / np.sqrt(n_used)
        calibration = SimpleNamespace(
            rig=SimpleNamespace(T_right_left=T),
            covariance=Covariance(names, sigma**2 * np.eye(3)),
            views=[SimpleNamespace(name=pair.name) for pair in source.pairs[:n_used]],
        )
        run = object.__new__(NaturalRun)  # of which no more than this is looked at
        object.__setattr__(run, "calibration", calibration)
        object.__setattr__(run, "elapsed_s", {"matching": 2.0, "solve": 0.5})
        return run

    def calibrate(corners, *, calibrator, model):
        assert model == ("fisheye4" if calibrator == "wide-field" else "brown4")
        if calibrator == "opencv":
            raise SceneError("not this", 0, 1)

    def render_measured(n_pairs, seed, folder):
        rendered.append(n_pairs)
        return {spec: folder / spec for spec in sets.MEASURED_BOARDS}

    def render_streets(name, n_pairs, seed, folder):
        return [StereoPair(f"{i}", Path("l.png"), Path("r.png")) for i in range(n_pairs)]

    monkeypatch.setattr(sets, "render_measured", render_measured)
    monkeypatch.setattr(sets, "render_streets", render_streets)
    monkeypatch.setattr(experiment_times, "detect_corners", lambda left, right, board: some_corners(3))
    monkeypatch.setattr(experiment_times, "_by_opencv", lambda left, right, board: some_corners(3))
    monkeypatch.setattr(experiment_times, "calibrate", calibrate)
    monkeypatch.setattr(experiment_times, "recalibrate", recalibrate)
    return rendered, asked


def test_every_method_is_timed_and_what_the_journal_has_is_not_done_again(fast):
    rendered, asked = fast
    results = {(r.case, r.calibrator, r.seed): r for r in experiment_times.timed_results(OPTIONS, lambda *key: False)}
    assert len(results) == experiment_times.MOST_TIMED and rendered == [24]
    # the set's own pairs, then what the choice is measured against, then as many as the set has images for
    assert asked[:4] == [(16, 8, "drl"), (16, 16, "drl"), (8, 8, "drl"), (24, 8, "drl")]
    assert (24, 4, "portfolio") in asked  # of larger images fewer are used
    rows = experiment_times.rows_of_timed(OPTIONS, results)
    of_drl = {row.criterion: row for row in rows if (row.case, row.calibrator) == ("KITTI", "drl")}
    assert of_drl["seconds from images"].median == 2.5 and of_drl["seconds from images"].paper == 5.2
    assert of_drl["rotation from the set's own"].median == pytest.approx(0.1)
    assert of_drl["sigma of the rotation over that of twice the pairs"].median == pytest.approx(np.sqrt(2))
    assert of_drl["place in the drive of pair 8 of those used"].median == 7 and of_drl["pairs"].median == 24
    ratios = {
        row.calibrator: row
        for row in rows
        if row.case == "measured" and row.criterion == "seconds from images, over drl's"
    }
    assert ratios["drl"].median == 1 and ratios["lm"].median > 0
    printed = {
        row.calibrator: row.paper for row in rows if (row.case, row.criterion) == ("measured", "seconds from images")
    }
    assert printed["wide-field"] == 15.4 and printed["lm"] is None
    (refused,) = [row for row in rows if row.calibrator == "opencv, its own corners"]
    assert refused.failures == 1 and refused.median is None
    text = times_text(rows)
    assert (
        "| opencv, its own corners | 1 of 1 refused |" in text
        and "Seconds from images, s" in text
        and "rotation" not in text
    )
    assert {row.table for row in paper_page(OPTIONS, rows).rows} == {"streets"}
    rendered.clear(), asked.clear()
    assert not list(experiment_times.timed_results(OPTIONS, lambda *key: True)) and not rendered and not asked


def test_both_boards_stand_before_a_street_and_opencv_finds_them_too(tmp_path, monkeypatch):
    def slope(camera, T, patches, grain, blur_px):  # light from left to right: a street takes 5 s
        assert len(patches) > 20
        return np.broadcast_to(np.linspace(20, 200, camera.size_wh[0]), camera.size_wh[::-1])

    monkeypatch.setattr(sets, "render_scene_light", slope)
    folders = sets.render_measured(2, 0, tmp_path)
    assert list(folders) == list(sets.MEASURED_BOARDS)
    corner = read_grey_image(tmp_path / "10mm" / "left_0000.png").astype(float)[:20]
    assert np.median(corner[:, :20]) == pytest.approx(21, abs=2)  # no board reaches there
    for spec, folder in folders.items():
        board = parse_board(spec)
        found = experiment_times._by_opencv(str(folder / "left_*.png"), str(folder / "right_*.png"), board)
        ours = detect_corners(str(folder / "left_*.png"), str(folder / "right_*.png"), board)
        assert found.n_views == ours.n_views == 1
        apart_px = [
            np.abs(o[0] - np.stack([f[0], f[0][::-1]])).max(axis=(1, 2)).min()
            for o, f in zip((ours.left_px, ours.right_px), (found.left_px, found.right_px), strict=True)
        ]
        assert max(apart_px) < 0.5  # both finders see the same corners


def test_folders_of_streets_are_looked_at_before_anything_runs(tmp_path):
    for option in ("kitti", "cityscapes"):
        (tmp_path / option).mkdir()
        options = ExperimentOptions(48, 3, **{option: str(tmp_path / option)})
        with pytest.raises(DataError, match=option):
            experiment(tmp_path / "page", options)
    assert not (tmp_path / "page").exists()


def test_few_pairs_repeat_under_names_of_their_own():
    pairs = [StereoPair(name, Path(f"{name}.png"), Path("r.png")) for name in ("a", "b")]
    assert [p.name for p in sets.repeated(pairs, 5)] == ["a", "b", "a.1", "b.1", "a.2"]
    assert [p.left_path.name for p in sets.repeated(pairs, 3)] == ["a.png", "b.png", "a.png"]
    assert [p.name for p in sets.repeated(pairs, 1)] == ["a", "b"]


def test_a_quick_run_looks_at_few_pairs_of_one_street(fast):
    options = ExperimentOptions(48, 3, is_quick=True)
    cases = [result.case for result in experiment_times.timed_results(options, lambda *key: False)]
    assert cases.count("KITTI") == 1 and "Cityscapes" not in cases and "measured, streets" not in cases
    assert fast[1] == [(4, 2, "drl"), (4, 4, "drl"), (2, 2, "drl"), (24, 2, "drl")]


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
