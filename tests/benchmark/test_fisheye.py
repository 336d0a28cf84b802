"""The benchmark of fisheye lenses: what is compared, and on one small rig a field, the order of the ways."""

from __future__ import annotations

import numpy as np
import pytest

from binocal.benchmark import fisheye, mrcal_peer
from binocal.geometry import so3


def test_a_lens_may_turn_its_camera():
    rng = np.random.default_rng(0)
    rays = rng.normal(size=(40, 3))
    R = so3.exp(np.array([0.3, -1.0, 2.0]))
    scaled = rays * rng.uniform(0.5, 2, (40, 1))  # length is ignored
    assert np.allclose(fisheye._turn(scaled, rays @ R.T), R, atol=1e-12)
    scaled[3], scaled[5] = np.nan, 0  # no ray
    assert np.allclose(fisheye._turn(scaled, rays @ R.T), R, atol=1e-12)


def test_ratios_are_of_the_rigs_where_both_succeeded():
    own = np.array([[0.1, 0.01, 20], [0.1, 0.01, 20], [0.2, 0.01, 20]])
    other = np.array([[-1.0, 0.1, 12], [np.nan, np.nan, 0], [2.0, 0.1, 14]])
    row = fisheye._row(150, "other", other, own)
    assert row["failed"] == 1 and row["views"] == 13
    assert row["binocal_over_baseline_error_mm"] == pytest.approx(0.1)
    assert row["binocal_over_rotation_error_deg"] == pytest.approx(0.1)
    none = fisheye._row(150, "none", np.full((2, 3), np.nan), own[:2])
    assert none["failed"] == 2 and np.isnan(none["baseline_error_mm"]["rms"])
    assert "150  other" in fisheye._format([row, none], 20, 3, "here")


@pytest.mark.slow
def test_fisheye_rigs_are_compared_with_peers(monkeypatch):
    monkeypatch.setattr(fisheye, "FIELDS_DEG", (180,))
    rows = {row["way"]: row for row in fisheye.run_fisheye_benchmark(pairs=10, rigs=1)["rows"]}
    ours = rows["binocal"]
    assert ours["failed"] == 0 and ours["views"] == 10
    assert ours["baseline_error_mm"]["rms"] < 0.004 and ours["rotation_error_deg"]["rms"] < 0.004
    helped = rows["cv2.fisheye from it, binocal's corners"]
    assert helped["failed"] == 0 and helped["baseline_error_mm"]["rms"] < 0.01
    if mrcal_peer.find_mrcal() is None:
        pytest.skip("no Python here has mrcal")
    assert rows["mrcal, splined"]["failed"] == 0 and rows["mrcal, splined"]["baseline_error_mm"]["rms"] < 0.1
    assert rows["mrcal, stereographic, binocal's corners"]["baseline_error_mm"]["rms"] > 0.2  # the lens is none
