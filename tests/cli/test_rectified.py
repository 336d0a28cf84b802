"""``binocal rectify`` and ``binocal depth``, from files to files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from binocal.cameras.epipolar_projection import PROJECTIONS
from binocal.cli import main
from binocal.cli.verbs.rectified import Projections
from binocal.formats.rig_json import write_calibration, write_rig
from binocal.geometry import SE3, so3
from binocal.images.png import encode_png
from binocal.result import Covariance
from rigs import make_calibration
from textured_planes import render_plane, small_rig

COVARIANCE = Covariance(("left.fx", "rotation.y", "translation.x"), np.diag([0.04, 1e-9, 1e-10]))


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A rig with its covariance, and two pairs of a plane 0.8 m away."""
    path = tmp_path_factory.mktemp("plane")
    write_calibration(path / "rig.json", replace(make_calibration(small_rig()), covariance=COVARIANCE))
    for view in (0, 1):
        for side, image in zip(("left", "right"), render_plane(small_rig(), 0.8, seed=view), strict=True):
            (path / f"{side}{view}.png").write_bytes(encode_png(image))
    return path


def run(verb: str, folder: Path, *options: str, rig: str = "rig.json") -> int:
    sources = ["--left", str(folder / "left*.png"), "--right", str(folder / "right*.png")]
    return main([verb, str(folder / rig), *sources, *options])


def test_rectify_writes_pairs_whose_rows_match(folder, tmp_path, capsys):
    out = tmp_path / "out"
    assert run("rectify", folder, "--output", str(out), "--rows", "--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert document["projection"] == "pinhole" and document["pairs"] == ["0", "1"] and document["kept"] > 0.95
    names = {path.name for path in out.iterdir()}
    sides = {f"{what}_{view}.png" for what in ("left", "right", "rows") for view in (0, 1)}
    assert names == sides | {"rectification.json"}
    saved = json.loads((out / "rectification.json").read_text())
    assert saved["Q"][3][2] == pytest.approx(1 / saved["baseline"]) and saved["image_size"] == [320, 240]
    left, right = (cv2.imread(str(out / f"{side}_0.png"), cv2.IMREAD_GRAYSCALE) for side in ("left", "right"))
    disparity_px = saved["P1"][0][0] * saved["baseline"] / 0.8
    shift = round(disparity_px)
    by_row = [
        np.abs(left[60:180, 120:280].astype(int) - right[60 + dy : 180 + dy, 120 - shift : 280 - shift]).mean()
        for dy in range(-3, 4)
    ]
    assert int(np.argmin(by_row)) == 3


def test_depth_measures_the_plane_and_says_how_well(folder, tmp_path, capsys):
    out = tmp_path / "out"
    assert run("depth", folder, "--output", str(out), "--range", "0.4-3m", "--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert document["unit"] == "m" and document["range"] == [0.4, 3.0] and document["knows_calibration_sigma"]
    pair = document["pairs"][0]
    assert pair["measured"] > 0.6 and pair["median"] == pytest.approx(0.8, rel=0.05)
    assert pair["median_sigma"] == pytest.approx(
        np.hypot(pair["median_sigma_matching"], pair["median_sigma_calibration"]), rel=0.1
    )
    steps = cv2.imread(str(out / "depth_0.png"), cv2.IMREAD_UNCHANGED)
    metres = cv2.imread(str(out / "depth_0.tiff"), cv2.IMREAD_UNCHANGED)
    assert steps.dtype == np.uint16 and np.array_equal(steps == 0, np.isnan(metres))
    np.testing.assert_allclose(steps[steps > 0] / 1000, metres[steps > 0], atol=5.1e-4)
    sigma = cv2.imread(str(out / "sigma_0.tiff"), cv2.IMREAD_UNCHANGED)
    f, b = document["rectification"]["left"]["focal_px"][0], document["rectification"]["baseline"]
    matching = metres**2 / (f * b) * 0.3
    assert np.all(sigma[steps > 0] >= 0.999 * matching[steps > 0])
    cloud = (out / "cloud_0.ply").read_bytes()
    assert cloud.startswith(b"ply\n") and f"element vertex {np.count_nonzero(steps)}".encode() in cloud[:400]


def test_depth_of_a_rig_without_sigmas_says_so(folder, tmp_path, capsys):
    write_rig(folder / "bare.json", replace(small_rig(), is_metric=False), force=True)
    out = tmp_path / "out"
    assert run("depth", folder, "--output", str(out), "--png-units", "100000", rig="bare.json") == 0
    text = capsys.readouterr().out
    assert "leaves uncertain is unknown" in text and "squares" in text and "too far for the 16-bit PNG" in text
    assert "no --range given" in text and json.loads((out / "depth.json").read_text())["range"][1] is None


@pytest.mark.parametrize(
    ("options", "code", "text"),
    [
        (["--range", "0.5-5"], 2, "needs a unit"),
        (["--range", "5-0.5m"], 2, "from near to far"),
        (["--range", "far"], 2, "'far' is no range"),
        (["--range", "300-400m"], 3, "from 300 to 400 m the disparity does not change by a pixel"),
        (["--range", "1-2mm"], 3, "give a range of farther distances"),
        (["--size", "0x5"], 2, "--size is '0x5'"),
        (["--alpha", "2"], 2, "alpha"),
    ],
)
def test_wrong_options_are_one_line(folder, tmp_path, capsys, options, code, text):
    assert run("depth", folder, "--output", str(tmp_path / "out"), *options) == code
    said = capsys.readouterr().err
    assert text in said and said.count("\n") <= 1 + 2 * (code == 2) and not (tmp_path / "out").exists()


def test_images_of_another_size_are_refused_by_name(folder, tmp_path, capsys):
    other = tmp_path / "other"
    other.mkdir()
    for side in ("left", "right"):
        (other / f"{side}0.png").write_bytes(encode_png(np.full((100, 160), len(side), np.uint8)))
    (other / "rig.json").write_bytes((folder / "rig.json").read_bytes())
    for verb in ("rectify", "depth"):
        assert run(verb, other, "--output", str(tmp_path / "out")) == 3
        said = capsys.readouterr().err
        assert "left0.png: is 160 x 100, the rig's left camera 320 x 240" in said and said.count("\n") == 1
        assert not (tmp_path / "out").exists()


def test_a_rig_without_a_common_field_is_refused(folder, tmp_path, capsys):
    rig = small_rig()
    away = replace(rig, T_right_left=SE3(so3.exp(np.array([0.0, -1.5, 0.0])), np.array([-0.05, 0, -0.03])))
    write_rig(folder / "away.json", away, force=True)
    assert run("rectify", folder, "--output", str(tmp_path / "out"), rig="away.json") == 3
    assert "no field in common" in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_what_is_there_is_kept(folder, tmp_path, capsys):
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.txt").write_text("mine")
    assert run("rectify", folder, "--output", str(out)) == 3 and "exists already" in capsys.readouterr().err
    assert run("rectify", folder, "--output", str(out), "--force") == 0
    assert (out / "mine.txt").read_text() == "mine" and (out / "left_0.png").exists()


def test_a_projection_that_there_is_not_is_named_in_one_sentence(capsys):
    assert main(["rectify", "rig.json", "--left", "l", "--right", "r", "--output", "out", "--projection", "weird"]) == 2
    said = capsys.readouterr().err
    assert "'--projection': 'weird' is not one of 'auto', 'pinhole'" in said and "Value error" not in said


def test_the_command_line_knows_every_projection():
    assert list(Projections) == ["auto", *PROJECTIONS]
