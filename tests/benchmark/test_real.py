"""`binocal bench real` on a simulated recording: halves, peers, failures by name, ratios."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from binocal import benchmark
from binocal.benchmark import mrcal_peer, opencv_peer, real, real_table
from binocal.benchmark.halves import Estimate
from binocal.benchmark.real import ratios_to_peers, run_set, summarise_method
from binocal.benchmark.real_sets import RealSet, SetSource
from binocal.boards import parse_board
from binocal.cli import main
from binocal.errors import DataError, NotConvergedError
from binocal.formats.detections_npz import write_detections
from binocal.geometry import SE3
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig

BOARD = "chessboard:8x6:25mm"


def recorded(n_views=12, *, seed=1, noise_px=0.1, missing_share=0.0):
    """A simulated recording's corners and its rig."""
    rng, rig, board = np.random.default_rng(seed), table2_rig(), parse_board(BOARD)
    scene = StereoScene(rig, board, sample_board_poses(rig, board, n_views, rng))
    return simulate_detections(scene, rng, noise_px=noise_px, missing_share=missing_share), rig


@pytest.fixture
def without_mrcal(monkeypatch):
    monkeypatch.setattr(real, "find_mrcal", lambda: None)


def run_on(detections, path, **options):
    write_detections(path, detections)
    return benchmark.run("real", sets=[str(path)], **options)


def test_a_simulated_recording_repeats_as_its_sigmas_say(tmp_path, without_mrcal):
    table = run_on(recorded(24)[0], tmp_path / "simulated.npz", splits=4, seed=3)
    (row,) = table["rows"]
    assert (row["set"], row["views"], row["views_given"], row["model"]) == ("simulated", 24, 24, "brown5")
    assert set(row["methods"]) == {"binocal", "binocal auto", "OpenCV"}
    assert set(row["not_run"]) == {"OpenCV, own corners", "mrcal"}
    for found in row["methods"].values():
        assert found["n_halves"] == 8 and found["n_failed"] == 0 and len(found["by_split"]["rows_rms_px"]) == 8
        assert found["rotation_deg"] < 0.2 and found["baseline_percent"] < 1
        assert 0.1 < found["rows_rms_px"] < 0.2  # two rows' noise: 0.14
    assert row["methods"]["binocal"]["models"] == {"brown5": 8}
    pooled = table["pooled_z"]["binocal"]["all"]
    assert pooled["n"] == 48 and 0.6 < pooled["rms"] < 1.5 and pooled["within_2"] > 0.8
    assert (
        0.8 < table["ratios"]["binocal"]["OpenCV"]["median"]["rotation_deg"] < 1.25
    )  # the same minimum but for weights
    assert table["failed_sets"] == {}


def test_orders_are_repaired_and_rejected_views_left_out_for_all(without_mrcal):
    detections, _ = recorded(14)
    rng = np.random.default_rng(0)
    turned = detections.reorder("right", {3: np.arange(48)[::-1]})
    px = turned.left_px.copy()
    px[5] = px[5][rng.permutation(48)]  # no order repairs this
    spoiled = real.Detections.from_arrays(turned.object_points_m, px, turned.right_px, turned.left_size_wh)
    row, *_ = run_set(RealSet(SetSource("spoiled", Path()), spoiled, None), 2, 0)
    assert (row["views"], row["views_given"]) == (13, 14)
    assert all(found["rows_rms_px"] < 0.2 for found in row["methods"].values())


def test_failures_of_halves_are_counted_and_named(tmp_path, monkeypatch, without_mrcal):
    fails = iter([False, True, False, False, True, True])  # full set, then halves

    def calibrate(detections, *, model):
        if model == "brown5" and next(fails):
            raise NotConvergedError("no minimum\nin 100 iterations")
        return true_calibrate(detections, model=model)

    def no_peer(detections, model):
        raise ValueError("unsuitable corners" + ", and more of it" * 10)

    true_calibrate = real.calibrate
    monkeypatch.setattr(real, "calibrate", calibrate)
    monkeypatch.setattr(real, "calibrate_rig", no_peer)
    table = run_on(recorded()[0], tmp_path / "hard.npz", splits=2)
    methods = table["rows"][0]["methods"]
    found = methods["binocal"]
    assert (found["n_failed"], found["n_halves"]) == (2, 4)
    assert found["failures"] == {"no minimum in 100 iterations": 2}
    assert np.isnan(found["rotation_deg"]) and found["rows_rms_px"] > 0  # one half of each split is left
    assert methods["OpenCV"]["n_failed"] == 4 and np.isnan(methods["OpenCV"]["rows_rms_px"])
    text = table["text"]
    assert "failed: hard, binocal, 2 of the halves: no minimum in 100 iterations" in text
    assert "failed: hard, OpenCV, 4 of the halves: unsuitable corners, and" in text
    assert max(map(len, text.splitlines())) <= real_table.WIDTH


def test_a_rig_that_is_not_finite_is_a_failure():
    detections, rig = recorded()
    bad = replace(rig, T_right_left=SE3(rig.T_right_left.R, np.full(3, np.nan)))
    estimate = real._by_peer(lambda *_: bad, detections, "brown5")
    assert estimate.rig is None and estimate.failure == "the rig is not finite"
    no_camera = real._by_peer(lambda *_: replace(rig.left, parameters=np.full(9, np.nan)), detections, "brown5")
    assert no_camera.rig is None and no_camera.failure.startswith("camera parameters must be finite")


def test_recordings_that_cannot_be_used_are_named_beside_the_others(tmp_path, without_mrcal):
    write_detections(tmp_path / "good.npz", recorded()[0])
    write_detections(tmp_path / "few.npz", recorded(6)[0])
    paths = [str(tmp_path / f"{name}.npz") for name in ("few", "good")]
    table = benchmark.run("real", sets=paths, splits=1)
    assert [row["set"] for row in table["rows"]] == ["good"]
    assert table["failed_sets"] == {"few": "6 of 6 views can be used; two halves need 8."}
    assert "1 of 2 recordings" in table["text"] and "failed: few: 6 of 6 views" in table["text"]
    with pytest.raises(DataError, match="few: 6 of 6 views"):
        benchmark.run("real", sets=paths[:1])


def made_up(figure_by_method):
    """A row whose methods have these rotations by split and nothing else that is known."""
    methods = {}
    for name, values in figure_by_method.items():
        values = np.array(values)
        by_split = {figure: np.full(len(values), np.nan) for figure in real_table.FIGURES} | {"rotation_deg": values}
        methods[name] = {"by_split": by_split}
    return methods


def test_ratios_are_over_common_splits_and_the_best_peer():
    rows = [
        {"set": "a", "methods": made_up({"binocal": [0.1, 9.0], "OpenCV": [0.2, np.nan], "mrcal": [0.4, 18.0]})},
        {"set": "b", "methods": made_up({"binocal": [0.3, np.nan], "OpenCV": [0.1, 5.0]})},
        {"set": "c", "methods": made_up({"binocal": [0.4, 0.4], "mrcal": [0.5, 0.5]})},
    ]
    found = ratios_to_peers(rows)["binocal"]
    assert {name: x["rotation_deg"] for name, x in found["best peer"]["by_set"].items()} == pytest.approx(
        {"a": 0.5, "b": 3.0, "c": 0.8}
    )
    assert found["best peer"]["median"]["rotation_deg"] == pytest.approx(0.8)
    assert found["OpenCV"]["median"]["rotation_deg"] == pytest.approx(1.75)
    assert found["mrcal"]["by_set"]["b"] == {} and np.isnan(found["best peer"]["median"]["rows_rms_px"])


def test_rows_are_measured_on_the_other_half():
    detections, rig = recorded(8)
    shifted = detections.right_px.copy()
    shifted[4:, :, 1] += 1.0  # the second half's rows are 1 px off
    spoiled = real.Detections.from_arrays(detections.object_points_m, detections.left_px, shifted, rig.left.size_wh)
    halves = [(np.arange(4), np.arange(4, 8))]
    found = summarise_method([(Estimate(rig), Estimate(rig))], halves, spoiled)["by_split"]["rows_rms_px"]
    assert found[0] > 0.9 and found[1] < 0.2  # the first half's rig meets the second half's views


def test_the_command_prints_the_table_or_one_document(tmp_path, capsys, without_mrcal):
    path = str(tmp_path / "simulated.npz")
    write_detections(path, recorded()[0])
    assert main(["bench", "real", path, "--quick"]) == 0
    out = capsys.readouterr().out
    assert "1 of 1 recordings, 3 splits, seed 0" in out and "best peer of each" in out
    assert main(["bench", "real", path, "--quick", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["benchmark"] == "real" and "text" not in document
    assert len(document["rows"][0]["methods"]["binocal"]["by_split"]["rotation_deg"]) == 3


@pytest.mark.parametrize("arguments", [["solver", "recording"], ["precision", "--quick"]])
def test_other_benchmarks_take_no_recordings(arguments, capsys):
    assert main(["bench", *arguments]) == 2
    assert "belong to `bench real`" in capsys.readouterr().err


def test_nothing_to_measure_with_ends_with_what_was_looked_for(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("BINOCAL_DATA", str(tmp_path))
    assert main(["bench", "real"]) == 3
    assert "no recording to measure with" in capsys.readouterr().err


@pytest.mark.parametrize("model", ["brown4", "brown5", "brown8", "fisheye4"])
def test_opencv_gives_the_rig_of_every_model(model):
    detections, rig = recorded(15, noise_px=0.01)
    found = opencv_peer.calibrate_rig(detections, model)
    assert found.left.model == model and found.right.size_wh == rig.right.size_wh
    assert found.baseline_m == pytest.approx(rig.baseline_m, rel=2e-3)  # the fisheye model is not that of the rig
    assert found.left.parameters[:4] == pytest.approx(rig.left.parameters[:4], abs=3 if model == "fisheye4" else 0.5)


def test_opencv_takes_partial_boards_and_knows_what_it_has_not():
    detections, rig = recorded(15, noise_px=0.01, missing_share=0.3)
    assert opencv_peer.calibrate_rig(detections, "brown5").baseline_m == pytest.approx(rig.baseline_m, rel=2e-3)
    with pytest.raises(ValueError, match="no camera model 'brown9'"):
        opencv_peer.calibrate_rig(detections, "brown9")


def test_grids_are_told_from_other_boards():
    assert mrcal_peer.grid_of(parse_board(BOARD).object_points_m) == (6, 8, pytest.approx(0.025))
    points = parse_board(BOARD).object_points_m.copy()
    points[:, 2] = points[:, 0] ** 2
    for other in (points, points[:47], parse_board("aprilgrid:3x2:30mm:0.3").object_points_m):
        with pytest.raises(ValueError, match="square grids alone"):
            mrcal_peer.grid_of(other)


@pytest.mark.skipif(mrcal_peer.find_mrcal() is None, reason="no Python here has mrcal")
def test_mrcal_finds_the_rig_with_its_warp_and_without_some_corners():
    detections, rig = recorded(15, noise_px=0.01, missing_share=0.3)
    found = mrcal_peer.calibrate_rig_with_mrcal(detections, "brown5")
    assert found.baseline_m == pytest.approx(rig.baseline_m, rel=2e-3)
    assert found.left.parameters[:4] == pytest.approx(rig.left.parameters[:4], abs=0.5)


@pytest.mark.data
@pytest.mark.slow
def test_a_real_recording_is_measured_by_every_method(data_dir, monkeypatch):
    monkeypatch.setenv("BINOCAL_DATA", str(data_dir))
    (row,) = benchmark.run("real", sets=["opencv_bouguet"], splits=2)["rows"]
    assert row["views"] == 13 and row["opencv_views"] == 13
    assert {*row["methods"], *row["not_run"]} == {*real.OURS, *real.PEERS}
    for found in row["methods"].values():
        assert found["n_failed"] == 0 and found["rows_rms_px"] < 0.2 and found["rotation_deg"] < 1
