"""``check --stream``: rigs that are turned on the way, pairs that tell nothing, times, and real recordings."""

from __future__ import annotations

import gc
import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

import streets
from binocal.app import natural, pair_matching, stream
from binocal.cameras import Camera, StereoRig
from binocal.cli import main
from binocal.datasets import StereoPair
from binocal.datasets.frames import time_of_name_ns
from binocal.errors import DegenerateGeometryError
from binocal.evidence.point_matches import PointMatches
from binocal.formats import rig_json
from binocal.geometry import SE3, so3
from binocal.matching.pairs import PairMatches

STREET = StereoRig(*streets.cameras(), streets.T_RIGHT_LEFT)


def run(*arguments):
    try:
        return main([str(a) for a in arguments])
    except SystemExit as error:
        return error.code


def matches_of_street(cameras, pair, n=250):
    return streets.street(np.random.default_rng(int(pair.name)), cameras, n, 0.1, wrong=0.1)


def turned_matches(matches, camera, axis, deg):
    """As if the right camera had turned."""
    rays = camera.unproject(matches.right_px) @ so3.exp(np.radians(deg) * np.eye(3)[axis])
    return replace(matches, right_px=camera.project(rays))


def street_source(tmp_path, n_pairs):
    return natural.NaturalSource(
        [StereoPair(str(k), tmp_path / f"{k}.png", tmp_path / f"{k}.png") for k in range(n_pairs)], STREET
    )


def give(monkeypatch, match):
    """The stream's matches are those of a function of cameras and pair."""
    monkeypatch.setattr(
        pair_matching, "match_files", lambda pair, cameras: PairMatches(match(cameras, pair), (1500, 1500), (1.0, 1.0))
    )


def test_a_pair_with_too_few_matches_is_left_out_by_name(tmp_path, monkeypatch):
    give(monkeypatch, lambda cameras, pair: matches_of_street(cameras, pair, 10 if pair.name == "3" else 250))
    source = street_source(tmp_path, 5)
    matches, (left_out,) = pair_matching.matches_of(source.pairs, (STREET.left, STREET.right))
    assert matches.n_pairs == 4
    assert left_out.text.startswith("1 of 5 pairs was left out: 3 (10 points")


def test_a_rig_that_is_turned_on_the_way(tmp_path, monkeypatch):
    """Matches with truth: a pair is skipped by name, the jump is told, and none where the rig stands."""

    def match(cameras, pair, deg):
        found = matches_of_street(cameras, pair, 10 if pair.name == "3" else 250)
        return turned_matches(found, cameras[1], 0, deg if int(pair.name) >= 8 else 0.0)

    source = street_source(tmp_path, 14)
    give(monkeypatch, lambda cameras, pair: match(cameras, pair, 0.1))
    calls, alive = [], []

    def progress(*call):
        calls.append(call)
        alive.append(sum(type(thing) is PointMatches for thing in gc.get_objects()))

    found = stream.check_stream(source, stream.StreamOptions(fps=1.0, progress=progress))
    assert len(calls) == 14 and max(alive) - alive[0] <= 2  # of the pairs before nothing is kept but their turns
    assert [name for name, _ in found.skipped] == ["3"] and "points" in found.skipped[0][1]
    assert len(found.turns) == 13 and found.turns[3].time_s == 4.0 and calls[-1] == ("pairs", 14, 14)
    (jump,) = found.track.jumps
    assert jump.angle == 0 and found.turns[jump.at].name == "8" and abs(jump.size_deg - 0.1) < 3 * jump.sigma_deg
    assert found.has_drifted and {one.code for one in found.findings} == {"stream-jumped", "stream-pairs-skipped"}
    give(monkeypatch, lambda cameras, pair: match(cameras, pair, 0.0))
    still = stream.check_stream(source, stream.StreamOptions(every=2))
    assert not still.has_drifted and len(still.turns) == 7 and not still.skipped
    assert np.abs(still.drift.turn_deg / still.drift.sigma_deg).max() < 3


def test_a_stream_that_tells_nothing_is_refused(tmp_path, monkeypatch):
    give(monkeypatch, lambda cameras, pair: matches_of_street(cameras, pair, 10))
    with pytest.raises(DegenerateGeometryError, match="0 of the stream's pairs") as caught:
        stream.check_stream(street_source(tmp_path, 4))
    assert list(caught.value.rejected) == ["0", "1", "2", "3"]


def test_times_of_names():
    assert time_of_name_ns("1403715273262142976") == 1403715273262142976
    assert time_of_name_ns("1403715273262142") == 1403715273262142000
    assert time_of_name_ns("0000000000000000001") is None and time_of_name_ns("left_17") is None


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Eight pairs of a camera that moves on; from the fifth on the right one is turned by 0.3 deg."""
    path = tmp_path_factory.mktemp("stream")
    camera = Camera("brown4", (320, 240), np.array([220.0, 221, 160, 119, 0, -0.18, 0.04, 5e-4, -4e-4]))
    T = SE3(so3.exp(np.radians([0.4, -0.7, 0.3])), np.array([-0.25, 0.002, -0.004]))
    rig = StereoRig(camera, camera, T)
    for k in range(8):
        T_left_world = SE3(so3.exp(np.radians([0.0, 1.0 * k, 0.0])), np.array([0.05 * k, 0.0, 0.0]))
        turn = SE3(so3.exp(np.radians([0.3 if k >= 4 else 0.0, 0.0, 0.0])), np.zeros(3))
        cv2.imwrite(str(path / f"left_{k}.png"), streets.render(camera, T_left_world))
        cv2.imwrite(str(path / f"right_{k}.png"), streets.render(camera, turn @ T @ T_left_world))
    rig_json.write_rig(path / "rig.json", rig)
    return path


@pytest.mark.slow
def test_the_verb_says_when_and_exits_with_4(folder, capsys):
    source = ["--left", folder / "left_*.png", "--right", folder / "right_*.png", "--rig", folder / "rig.json"]
    assert run("check", *source, "--stream", "--fps", "0.1") == 4
    out = capsys.readouterr().out
    assert out.startswith("drifted: pitch jumped by -0.") and "pitch jumped by -0." in out and "Rate" in out
    assert run("check", *source, "--stream", "--json") == 4
    document = json.loads(capsys.readouterr().out)
    assert document["jumps"][0]["angle"] == "pitch" and document["jumps"][0]["pair"] == document["series"][4]["pair"]
    assert document["rate_deg_per_hour"] == {"pitch": None, "yaw": None, "roll": None}
    still = ["--left", folder / "left_[0-3].png", *source[2:]]
    assert run("check", *still, "--stream") == 0
    assert capsys.readouterr().out.startswith("fine: no jump")


def test_options_of_a_stream_need_one(tmp_path, capsys):
    rig_json.write_rig(tmp_path / "rig.json", STREET)
    source = ("--left", tmp_path / "l*.png", "--right", tmp_path / "r*.png", "--rig", tmp_path / "rig.json")
    assert run("check", *source, "--every", "2") == 2 and "belong to --stream" in capsys.readouterr().err
    assert run("check", *source, "--stream", "--fps", "0") == 2 and "pairs per second" in capsys.readouterr().err
    assert run("check", *source, "--stream") == 3 and len(capsys.readouterr().err.strip().splitlines()) == 1


@pytest.mark.slow
@pytest.mark.parametrize("dataset", ["euroc:euroc_micro", "kitti:kitti_raw/2011_09_26/2011_09_26_drive_0002_sync:gray"])
def test_real_streams(data_dir, monkeypatch, dataset):
    """No alarm as recorded; one where the rig is turned by 0.1 deg of pitch or roll half way."""
    kind, _, path = dataset.partition(":")
    source = natural.source_of_dataset(f"{kind}:{data_dir / path}", None)
    cameras = source.rig.left, source.rig.right
    matched = {pair.name: pair_matching.match_files(pair, cameras).matches for pair in source.pairs}
    middle = len(source.pairs) // 2
    late = {pair.name for pair in source.pairs[middle:]}
    for axis, deg in ((0, 0.0), (0, -0.1), (2, -0.1)):

        def match(cameras, pair, axis=axis, deg=deg):
            found = matched[pair.name]
            return turned_matches(found, cameras[1], axis, deg) if pair.name in late else found

        give(monkeypatch, match)
        jumps = stream.check_stream(source).track.jumps
        assert [(jump.angle, jump.at) for jump in jumps] == ([(axis, middle)] if deg else [])
        assert all(abs(jump.size_deg + 0.1) < 0.03 for jump in jumps)
