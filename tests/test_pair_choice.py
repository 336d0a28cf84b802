"""Which pairs of a drive are used: a cheap look at many, and a greedy choice of those that tell a pose best."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import streets
from binocal.app.pair_choice import choose_pairs, looked_at, most_telling
from binocal.app.pair_matching import for_each_pair
from binocal.cameras import Camera, StereoRig
from binocal.datasets import StereoPair
from binocal.errors import CancelledError
from binocal.geometry import SE3, so3
from binocal.matching.glance import glance_at_pair
from binocal.solvers.epipolar import EpipolarProblem
from binocal.solvers.relative_pose import RelativePose
from binocal.threads import set_threads

CAMERAS = streets.cameras()
TURNED = SE3(so3.exp(np.radians([1.0, -1.0, 1.0])) @ streets.T_RIGHT_LEFT.R, streets.T_RIGHT_LEFT.t)


def pairs_called(*names):
    return [StereoPair(name, Path(f"{name}_l.png"), Path(f"{name}_r.png")) for name in names]


def test_pairs_that_show_more_are_chosen_and_they_complete_each_other():
    """From an old rig that has turned by a degree about each axis: two halves of the view are better than one of them twice."""
    rng = np.random.default_rng(0)
    glances = []
    for k, (side, n) in enumerate(
        [("left", 200), ("left", 190), ("right", 150), ("both", 15), ("none", 5), ("left", 180)]
    ):
        found = streets.street(rng, CAMERAS, 800, 1.0, wrong=0.15)
        x = found.left_px[:, 0] - streets.SIZE[0] / 2
        is_there = {"left": x < 0, "right": x > 0, "both": x < np.inf, "none": x < np.inf}[side]
        glances.append(replace(found.select(np.flatnonzero(is_there)[:n]), names=(str(k),)))
    glances.insert(0, glances[0].select(np.zeros(0, dtype=int)))  # nothing was seen at all
    assert most_telling(CAMERAS, TURNED, glances, 2) == [1, 3]
    assert most_telling(CAMERAS, TURNED, glances, 6) == [1, 2, 3, 4, 5, 6]


def test_a_glance_finds_matches_and_their_places():
    camera = Camera("brown4", (800, 300), np.array([450.0, 451, 400, 149, 0, -0.1, 0.02, 5e-4, -4e-4]))
    rig = StereoRig(camera, camera, SE3(so3.exp(np.radians([0.4, -0.7, 0.3])), np.array([-0.25, 0.002, -0.004])))
    images = [streets.render(camera, T) for T in (SE3.identity(), rig.T_right_left)]
    found = glance_at_pair(*images, "0")
    assert found.left_size_wh == (800, 300) and len(found) > 60
    residuals = EpipolarProblem.of_matches((camera, camera), found)[0].residuals_px(RelativePose.of(rig.T_right_left))
    assert (np.abs(residuals) < 2.0).mean() > 0.7 and abs(np.median(residuals)) < 0.5
    assert len(glance_at_pair(np.zeros((300, 800), np.uint8), images[1], "0")) == 0
    assert len(glance_at_pair(*(image.astype(np.uint16) * 200 for image in images), "0")) > 60


def test_few_pairs_are_taken_without_a_look(tmp_path):
    """No file is opened."""
    assert choose_pairs(pairs_called(*"abcdefgh"), CAMERAS, streets.T_RIGHT_LEFT, 8) == list(range(8))
    assert looked_at(1000, 8)[:2] == [0, 11] and len(looked_at(1000, 8)) == 96 and looked_at(1000, 8)[-1] == 999


@pytest.mark.parametrize("n_threads", [1, 2])
def test_pairs_are_looked_at_in_threads_and_told_in_order(n_threads):
    """A pair of images a thread at a time; an end, an error and a stop leave nothing running."""
    lock, counts = threading.Lock(), {"now": 0, "most": 0, "all": 0}

    def look(pair):
        with lock:
            counts["now"] += 1
            counts["all"] += 1
            counts["most"] = max(counts["now"], counts["most"])
        time.sleep(0.002)
        with lock:
            counts["now"] -= 1
        if pair.name == "bad":
            raise ValueError("bad")
        return pair.name

    names, calls = [str(k) for k in range(30)], []
    set_threads(n_threads)
    try:
        told = list(for_each_pair(look, pairs_called(*names), "pairs", lambda *a: calls.append(a)))
        assert told == names and calls == [("pairs", k + 1, 30) for k in range(30)] and counts["most"] <= n_threads
        with pytest.raises(ValueError, match="bad"):
            list(for_each_pair(look, pairs_called("1", "bad", *names), "pairs"))
        with pytest.raises(CancelledError, match="pair 1 of 30"):
            list(for_each_pair(look, pairs_called(*names), "pairs", should_stop=lambda: True))
        assert counts["now"] == 0 and counts["all"] < 60
    finally:
        set_threads(None)
