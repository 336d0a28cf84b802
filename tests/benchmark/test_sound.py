"""The benchmark of sound sets: every kind on a few rigs."""

from __future__ import annotations

import numpy as np
import pytest

from binocal.benchmark import grounds, sound
from binocal.errors import TooFewViewsError


def test_every_kind_is_solved_and_counted(monkeypatch):
    monkeypatch.setattr(sound, "GROUNDS", {})
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


@pytest.mark.parametrize("name", list(grounds.GROUNDS))
def test_boards_on_any_ground_are_found_by_both_cameras(name, monkeypatch):
    monkeypatch.setattr(grounds, "N_PAIRS", 2)
    rig, found = grounds.find_set_on(name, np.random.default_rng(4))
    assert found.n_views == 2 and rig.left.size_wh == grounds.SIZE_WH
    seen = (found.left_is_seen & found.right_is_seen).sum(axis=1)
    assert (seen > 40).all()
    both = np.isfinite(found.left_px[0, :, 0]) & np.isfinite(found.right_px[0, :, 0])
    rays_left, rays_right = (
        camera.unproject(px[0, both]) for camera, px in ((rig.left, found.left_px), (rig.right, found.right_px))
    )
    T = rig.T_right_left
    normals = np.cross(rays_left @ T.R.T, T.t / np.linalg.norm(T.t))  # of the epipolar planes, in the right frame
    assert np.abs((normals * rays_right).sum(axis=1)).max() < 5e-3


@pytest.mark.slow
def test_sets_on_every_ground_are_counted(monkeypatch):
    monkeypatch.setattr(sound, "KINDS", {})
    table = sound.run_sound_benchmark(rigs=3, seed=2)
    assert [row["kind"] for row in table["rows"]] == list(grounds.GROUNDS)
    assert all(row["refused"] == 0 and 0.3 < row["z_rms"] < 2.5 for row in table["rows"])


def test_a_set_that_is_refused_is_counted_as_refused(monkeypatch):
    def refuse(*_, **__):
        raise TooFewViewsError(1, 3)

    monkeypatch.setattr(sound, "GROUNDS", {})
    monkeypatch.setattr(sound, "KINDS", dict(list(sound.KINDS.items())[:1]))
    monkeypatch.setattr(sound, "calibrate", refuse)
    (row,) = sound.run_sound_benchmark(rigs=2)["rows"]
    assert row["refused"] == 2 and "1 usable view" in row["refusals"][0] and np.isnan(row["z_rms"])
