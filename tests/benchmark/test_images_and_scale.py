from __future__ import annotations

import numpy as np
import pytest

from binocal.benchmark import BENCHMARKS, run

pytestmark = pytest.mark.slow


def test_the_pipeline_is_timed_against_its_peer_and_against_decoding():
    table = run("pipeline", pairs=8, rounds=1, seed=1)
    rows = {row["way"]: row for row in table["rows"]}
    assert set(rows) == {"decode", "binocal", "opencv", "binocal process"}
    assert rows["decode"]["over_decode"]["median"] == 1
    assert all(row["s"]["min"] > 0 for row in rows.values())
    assert rows["binocal"]["rotation_error_deg"] == pytest.approx(
        rows["binocal process"]["rotation_error_deg"], rel=1e-6
    )
    assert rows["binocal"]["rotation_error_deg"] < 0.05 and rows["binocal"]["translation_error_mm"] < 0.5
    assert "8 PNG pairs" in table["text"] and all(name in table["text"] for name in rows)


def test_scale_reports_time_memory_and_what_the_choice_costs():
    table = run("scale", image_pairs=(6,), corner_pairs=(60, 120), seed=1)
    images, *corners = table["rows"]
    assert images["stage"] == "images" and images["n_views"] == 6 and images["peak_mb"] > 10
    for row in corners:
        assert row["n_views"] == 50 and row["depth_sigma_percent"] >= row["all_depth_sigma_percent"] > 0
        assert row["translation_error_mm"] < 0.5
    assert "opencv_s" in corners[0] and "opencv_s" not in corners[1]
    assert table["text"].count("\n") == 3


def test_rigs_from_images_are_compared_with_both_of_opencvs_calibrations():
    table = run("rig", pairs=8, sets=2, seed=1)
    rows = {row["way"]: row for row in table["rows"]}
    assert set(rows) == {"binocal", "binocal, brown5", "OpenCV, joint", "OpenCV, tutorial"}
    assert rows["binocal"]["binocal_over_rotation_error_deg"] == 1
    assert 0 < rows["binocal"]["rotation_error_deg"]["rms"] < rows["OpenCV, joint"]["rotation_error_deg"]["rms"]
    assert "2 sets of 8 rendered pairs" in table["text"] and all(name in table["text"] for name in rows)


def test_stated_deviations_hold_from_small_squares_and_compressed_images():
    table = run("coverage", pairs=6, rigs=6, seed=1)
    assert [row["case"] for row in table["rows"]] == ["as it is", "gamma 2.2", "JPEG 90", "JPEG 75"]
    # 24 rigs of 22 parameters together: 1.00 within 6 %; 1.5 with independent corners
    assert np.mean([row["squared_over_covariance"] for row in table["rows"]]) == pytest.approx(1, abs=0.25)
    assert np.mean([row["within_1_sigma"] for row in table["rows"]]) == pytest.approx(0.683, abs=0.06)
    assert all(row["n_failed"] == 0 for row in table["rows"]) and "6 rigs of 6 pairs a row" in table["text"]


def test_unknown_benchmarks_are_named():
    assert {"agent", "pipeline", "scale", "solver", "training"} <= set(BENCHMARKS)
    with pytest.raises(ValueError, match="known: agent, boards, circles, corners, coverage, detection, drift, faults"):
        run("nothing")
