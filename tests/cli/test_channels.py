"""``binocal channels``, ``--channel`` and ``simulate --aberration`` on small images."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from binocal.app.channels import ChannelRow, ChannelStudy
from binocal.cameras import Camera, StereoRig
from binocal.cli import main
from binocal.cli.verbs.calibrate import Channels
from binocal.formats import opencv_yaml
from binocal.geometry import SE3, so3
from binocal.images import CHANNELS

BOARD = "chessboard:6x4:30mm"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Eight pairs of 320 x 240 through lenses with 0.8 px of aberration."""
    place = tmp_path_factory.mktemp("colour")
    cameras = [Camera("brown4", (320, 240), np.array([300.0, 301, 160 + i, 119, 0, 0, 0, 0, 0])) for i in range(2)]
    rig = StereoRig(*cameras, SE3(so3.exp(np.array([0, -0.05, 0])), np.array([-0.06, 0, 0])))
    opencv_yaml.write_opencv(place / "rig.yml", rig)
    made = ["simulate", "--rig", str(place / "rig.yml"), "--board", BOARD, "--pairs", "8", "--aberration", "0.8"]
    assert main([*made, "--output", str(place / "set")]) == 0
    return place / "set"


def images(folder):
    return ["--left", str(folder / "left_*.png"), "--right", str(folder / "right_*.png"), "--board", BOARD]


def test_the_enumeration_is_that_of_the_reader():
    assert tuple(channel.value for channel in Channels) == CHANNELS


def test_the_aberration_is_found_with_its_sigma(folder, capsys):
    assert main(["channels", *images(folder), "--model", "brown4", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [row["channel"] for row in document["channels"]] == list(CHANNELS)
    assert all(
        row["n_views"] == 8 and row["rms_px"] < 0.1 and len(row["halves_px"]) == 8 for row in document["channels"]
    )
    for one in document["aberration"]:
        truth = {"red": 0.8, "blue": -0.8}[one["colour"]]
        assert one["is_seen"] and abs(one["fit"]["at_corner_px"] - truth) < 4 * one["fit"]["at_corner_sigma_px"] + 0.02
    assert json.loads((folder / "truth.json").read_text())["aberration_px"] == 0.8


def test_calibrate_takes_a_channel_and_says_which(folder, tmp_path, capsys):
    rigs = []
    for channel in ("red", "blue"):
        output = tmp_path / f"{channel}.json"
        arguments = ["calibrate", *images(folder), "--model", "brown4", "--channel", channel, "--output", str(output)]
        assert main([*arguments, "--no-checks"]) == 0
        rigs.append(json.loads(output.read_text()))
        assert rigs[-1]["provenance"]["channel"] == channel
    ratio = rigs[0]["left"]["fx"] / rigs[1]["left"]["fx"]
    assert ratio == pytest.approx(1 + 1.6 / 200, abs=0.002)  # 0.8 px to either side at the corner's 200 px


def test_images_without_colours_are_refused_by_name(tmp_path, folder, capsys):
    for i in range(3):
        for side in ("left", "right"):
            grey = cv2.imread(str(folder / f"{side}_0{i}.png"), cv2.IMREAD_GRAYSCALE)
            cv2.imwrite(str(tmp_path / f"{side}_{i}.png"), grey)
    assert main(["channels", *images(tmp_path)]) == 3
    said = capsys.readouterr().err
    assert "images can be used; left_0.png has no colours, so it has no green channel; give colour images" in said
    for path in tmp_path.glob("*.png"):
        cv2.imwrite(str(path), cv2.cvtColor(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), cv2.COLOR_GRAY2BGR))
    assert main(["channels", *images(tmp_path)]) == 3
    assert "hold grey levels" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("halves", "best"),
    [((0.08,) * 8, "red"), ((0.08,) * 6 + (0.2,) * 2, "grey"), ((0.097,) * 8, "grey"), ((), "grey")],
)
def test_a_colour_is_preferred_only_where_it_is_clearly_better(halves, best):
    rows = (ChannelRow("grey", halves_px=(0.1,) * 8), ChannelRow("red", halves_px=halves))
    assert ChannelStudy(rows, {}).best.channel == best


@pytest.mark.parametrize(
    "arguments",
    [
        ["simulate", "--scene", "room", "--pairs", "2", "--aberration", "1", "--output", "x"],
        ["simulate", "--rig", "turning", "--pairs", "2", "--aberration", "1", "--output", "x"],
        ["calibrate", "--corners", "c.npz", "--channel", "red", "--output", "x.json"],
    ],
)
def test_what_has_no_colours_refuses_the_option(arguments, capsys):
    assert main(arguments) == 2
    assert capsys.readouterr().err.count("\n") == 1
