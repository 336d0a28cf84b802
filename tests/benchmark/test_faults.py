"""The benchmark of set-level faults: its figures on a few rigs, and what it calls damage."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from binocal.benchmark import faults
from binocal.geometry import SE3, so3


def test_faults_are_counted_and_clean_sets_pass(monkeypatch):
    kept = ("none", "right camera knocked 0.2 deg", "board bowed 5 % of a square")
    monkeypatch.setattr(faults, "FAULTS", {name: faults.FAULTS[name] for name in kept})
    table = faults.run_faults_benchmark(rigs=3, seed=2)
    rows = {row["fault"]: row for row in table["rows"]}
    assert (rows["none"]["warned"], rows["none"]["refused"], rows["none"]["damaged"]) == (0, 0, 0)
    for name in kept[1:]:
        assert rows[name]["named"] == 3 and rows[name]["silent"] == 0
    assert all(name in table["text"] for name in kept)


def test_the_depth_error_is_that_of_triangulated_points():
    views = faults._random_set(0, 0)
    rig = views.rig
    assert faults._depth_error(rig, rig) == pytest.approx(0, abs=1e-8)
    longer = replace(rig, T_right_left=SE3(rig.T_right_left.R, 1.01 * rig.T_right_left.t))
    assert faults._depth_error(longer, rig) == pytest.approx(0.01, rel=1e-3)
    # a yaw of d moves the depth of a point 20 baselines away by 20 d, to first order
    turned = replace(rig, T_right_left=SE3(so3.exp(np.array([0, 1e-4, 0])) @ rig.T_right_left.R, rig.T_right_left.t))
    assert faults._depth_error(turned, rig) == pytest.approx(20e-4, rel=0.2)
