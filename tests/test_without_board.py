"""`binocal.recalibrate`, `check` and `check_stream`: what they take, and that they are the command line's own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import TypeCheckError

import binocal
import streets
from binocal.app import natural, pair_matching
from binocal.app.without_board import source_of
from binocal.datasets import Dataset, StereoPair
from binocal.geometry import SE3, so3
from binocal.matching.pairs import PairMatches

TURN = SE3(so3.exp(np.radians([1.0, 0.0, 0.0])), np.zeros(3))
TURNED = replace(streets.RIG, T_right_left=TURN @ streets.RIG.T_right_left)


@pytest.fixture(autouse=True)
def matches(monkeypatch):
    """Those of a street, whatever files are named."""

    def match(pair, cameras):
        rng = np.random.default_rng(int(pair.name))
        found = streets.street(rng, cameras, 200, 0.1, wrong=0.1)
        return PairMatches(replace(found, names=(pair.name,)), (1500, 1500), (1.0, 1.0))

    monkeypatch.setattr(pair_matching, "match_files", match)


def test_a_turned_rig_comes_back_from_pairs_of_paths():
    options = binocal.NaturalOptions(calibrator="lm")
    run = binocal.recalibrate([("left/1.png", "right/1.png")], TURNED, options)
    error = run.calibration.rig.T_right_left.R @ streets.T_RIGHT_LEFT.R.T
    assert np.degrees(so3.angle_rad(error)) < 0.1 and run.has_drifted
    pairs = [StereoPair("1", Path("left/1.png"), Path("right/1.png"), rig=streets.RIG)]
    data = Dataset("folder", "pairs with a rig", Path(), tuple(pairs), None, "a ruler")
    fine = binocal.check(data, options=options)
    assert not fine.has_drifted and fine.calibration.provenance["length_from"] == "a ruler"
    assert binocal.check(data, natural.as_given(TURNED), options).has_drifted


def test_a_stream_of_pairs():
    pairs = [(f"left/{k}.png", f"right/{k}.png") for k in range(4)]
    run = binocal.check_stream(pairs, streets.RIG, binocal.StreamOptions(fps=1.0))
    assert [turn.name for turn in run.turns] == ["0", "1", "2", "3"] and not run.has_drifted


def test_what_lacks_a_rig_or_has_two_is_refused(tmp_path):
    with pytest.raises(binocal.DataError, match="what cameras took them"):
        binocal.check([("left/1.png", "right/1.png")])
    with pytest.raises(binocal.DataError, match="no pairs of images"):
        binocal.check([], streets.RIG)
    with pytest.raises(binocal.DataError, match="no such folder"):
        binocal.check(f"kitti:{tmp_path / 'none'}")
    source = source_of([("left/1.png", "right/1.png")], streets.RIG)
    with pytest.raises((ValueError, TypeCheckError), match="give it alone"):
        binocal.check(source, streets.RIG)
