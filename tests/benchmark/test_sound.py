"""The benchmark of sound sets: every kind on a few rigs."""

from __future__ import annotations

import numpy as np
import pytest

from binocal.benchmark import sound


def test_every_kind_is_solved_and_counted():
    table = sound.run_sound_benchmark(rigs=2, seed=1)
    assert [row["kind"] for row in table["rows"]] == list(sound.KINDS)
    for row in table["rows"]:
        assert row["refused"] == 0 and row["iterations"] <= 30 and 0.3 < row["z_rms"] < 1.8
        assert row["kind"] in table["text"]


def test_noise_is_as_the_kind_says():
    rng = np.random.default_rng(0)
    halves = sound._halves(0.05, 0.5, 0.2)(rng)
    assert halves.shape == (2, sound.N_VIEWS) and (halves[0] == 0.5).sum() == 4
    _, detections = sound._random_set(rng, "random")
    noisy = sound._with_noise(detections, halves, rng, is_known=True)
    left = noisy.left_px - detections.left_px
    assert np.nanstd(left[halves[0] == 0.5]) == pytest.approx(0.5, rel=0.1)
    assert np.allclose(noisy.left_covariance_px2[halves[0] == 0.5], 0.25 * np.eye(2))


def test_long_lenses_are_long_and_bent():
    rig, detections = sound._long_set(np.random.default_rng(3))
    width, _ = rig.left.size_wh
    assert 2.9 < rig.left.parameters[0] / width < 31
    half = np.hypot(*rig.left.size_wh) / 2 / rig.left.parameters[0]
    assert abs(rig.left.parameters[5]) * half**2 < 0.051
    assert np.isfinite(detections.left_px).all() and detections.n_views == sound.N_VIEWS
