"""The solver's benchmark: its table, and the batch of rigs."""

import numpy as np
import pytest

from binocal.benchmark import mrcal_peer, solver


def test_the_table_has_every_peer_and_the_batches(monkeypatch):
    monkeypatch.setattr(solver, "BATCH_RIGS", 8)
    monkeypatch.setattr(solver, "find_mrcal", lambda: None)
    result = solver.run_solver_benchmark(pairs=(8,), rounds=2)
    (row,) = result["rows"]
    assert row["opencv_over_binocal"]["median"] > 0 and "mrcal_s" not in row
    assert row["binocal_s"]["min"] <= row["binocal_s"]["median"] <= row["binocal_s"]["max"]
    assert row["opencv_cpu_over_binocal"]["median"] > 0 and row["binocal_cpu_s"]["median"] > 0
    assert 0 <= row["binocal_added_mb"] < 50 and row["opencv_added_mb"] > 0
    assert [batch["intrinsics"] for batch in result["batches"]] == ["held", "free"]
    assert "rig-iterations per second" in result["text"] and "opencv / binocal" in result["text"]


@pytest.mark.skipif(mrcal_peer.find_mrcal() is None, reason="no Python here has mrcal")
def test_mrcal_finds_the_same_rig():
    scene, detections = solver.scene(12, 3)
    elapsed_s, R, t = solver._run_mrcal(detections)
    truth = scene.rig.T_right_left
    assert elapsed_s > 0 and np.abs(R - truth.R).max() < 3e-3 and np.linalg.norm(t - truth.t) < 1e-3
