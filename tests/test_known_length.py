"""Known lengths in the scene: ends found in the right image, the baseline they give, and how well they give it."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
import typer

import streets
from binocal.app.known_lengths import KnownLength, measure_known_lengths
from binocal.app.natural import NaturalSource, as_given, length_unlike_file
from binocal.calibrators.known_length import POINTED_SIGMA_PX, SeenLength, with_known_lengths
from binocal.cameras import Camera, StereoRig
from binocal.cli import main
from binocal.cli.arguments import parse_known_length
from binocal.datasets import StereoPair
from binocal.errors import DataError
from binocal.formats import rig_json
from binocal.geometry import SE3, so3
from binocal.matching.along_epipolar import NotMatchedError, match_along_epipolar
from binocal.result import Covariance

CAMERA = Camera("brown4", (480, 360), np.array([330.0, 331, 240, 179, 0, -0.18, 0.04, 5e-4, -4e-4]))
RIG = StereoRig(CAMERA, CAMERA, SE3(so3.exp(np.radians([0.4, -0.7, 0.3])), np.array([-0.25, 0.002, -0.004])))
ENDS_M = np.array([[-1.95, -0.3, 4.0], [-1.1, 0.6, 4.0]])  # on the front of the nearest box
LENGTH_M = float(np.linalg.norm(ENDS_M[1] - ENDS_M[0]))


def seen(rig, ends_m, length_m, sigma_m=0.0):
    T = rig.T_right_left
    covariance, warps = np.tile(0.01 * np.eye(2), (2, 1, 1)), np.tile(np.eye(2), (2, 1, 1))
    return SeenLength(
        rig.left.project(ends_m), rig.right.project(T.apply(ends_m)), covariance, warps, length_m, sigma_m, "0"
    )


def calibration(rig, sigma):
    names = ("left.fx", *(f"rotation.{a}" for a in "xyz"), *(f"translation.{a}" for a in "xyz"))
    return replace(as_given(rig), covariance=Covariance(names, np.diag(np.square(sigma))))


@pytest.fixture(scope="module")
def images():
    return [streets.render(CAMERA, T) for T in (SE3.identity(), RIG.T_right_left)]


def test_exact_ends_give_the_exact_baseline():
    double = replace(RIG, T_right_left=SE3(RIG.T_right_left.R, 2 * RIG.T_right_left.t), is_metric=False)
    start = calibration(double, [0.1, *[1e-4] * 3, *[1e-3] * 3])
    found = with_known_lengths(start, [seen(RIG, ENDS_M, LENGTH_M)])
    assert found.rig.is_metric and found.rig.baseline_m == pytest.approx(RIG.baseline_m, rel=1e-9)
    np.testing.assert_allclose(found.rig.T_right_left.t, RIG.T_right_left.t, rtol=1e-9)
    assert found.provenance["length_from"] == "a known length in the scene"


def test_the_stated_deviation_is_that_of_many_draws():
    """Ends at different depths, so that turn and focal length matter; pointing, matching and the length itself err, too."""
    rng, ends = np.random.default_rng(0), np.array([[-1.0, 0.2, 3.0], [1.2, -0.4, 6.0]])
    length_m, sigma_m = float(np.linalg.norm(ends[1] - ends[0])), 0.01
    sigma = np.array([1.0, 3e-4, 6e-4, 3e-4, 1e-3, 1e-3, 1e-3])
    true = seen(RIG, ends, length_m, sigma_m)
    stated = with_known_lengths(calibration(RIG, sigma), [true])
    drawn = []
    for _ in range(120):
        d = sigma * rng.normal(size=7)
        left = replace(RIG.left, parameters=RIG.left.parameters + [d[0], *[0] * 8])
        T = SE3(so3.exp(d[1:4]) @ RIG.T_right_left.R, RIG.T_right_left.t + d[4:])
        pointed = POINTED_SIGMA_PX * rng.normal(size=(2, 2))
        noisy = replace(
            true,
            left_px=true.left_px + pointed,
            right_px=true.right_px + pointed + 0.1 * rng.normal(size=(2, 2)),
            length_m=length_m + sigma_m * rng.normal(),
        )
        drawn.append(with_known_lengths(calibration(StereoRig(left, RIG.right, T), sigma), [noisy]).rig.T_right_left.t)
    covariance = np.cov(np.array(drawn).T)
    ratio = np.sqrt(np.diagonal(covariance) / np.diagonal(stated.covariance.block("translation")))
    np.testing.assert_allclose(ratio, 1.0, atol=0.2)  # 120 draws: 0.065 each
    assert stated.baseline_sigma_m == pytest.approx(np.linalg.norm(drawn, axis=1).std(), rel=0.2)


def test_a_length_that_is_given_has_no_deviation():
    """What is left along the translation is rounding, as 7e-14 m were, and would print with 12 decimals."""
    rig = replace(RIG, T_right_left=SE3(RIG.T_right_left.R, np.array([-0.537, -0.0042, -0.0069])))
    made = calibration(rig, [0.1, *[1e-4] * 3, *[1e-3] * 3])
    along = rig.T_right_left.t / rig.baseline_m
    across = np.eye(7)
    across[4:, 4:] -= np.outer(along, along)
    for sigma_m in (0.0, 1e-7, 1e-3):
        matrix = across @ made.covariance.matrix @ across.T
        matrix[4:, 4:] += sigma_m**2 * np.outer(along, along) + 1e-27 * np.eye(3)
        given = replace(made, covariance=replace(made.covariance, matrix=matrix))
        assert given.baseline_sigma_m == pytest.approx(sigma_m, rel=1e-3, abs=0)


@pytest.mark.parametrize(
    ("factor", "sigma_m", "is_metric", "is_said"),
    [
        (0.1, 0.0, True, True),
        (1.3, 0.01, True, True),
        (1.3, 0.04, True, False),
        (1.03, 0.0, True, False),
        (0.1, 0.0, False, False),
    ],
)
def test_a_baseline_far_from_the_files_is_said(factor, sigma_m, is_metric, is_said):
    """A unit mixed up or an end that lies elsewhere shows in no residual; 3 % more, or what its deviation allows, is nothing."""
    rig = replace(RIG, T_right_left=SE3(RIG.T_right_left.R, factor * RIG.T_right_left.t))
    given = calibration(rig, [0.1, *[1e-4] * 3, *[sigma_m] * 3])
    given = replace(given, provenance={**given.provenance, "length_from": "--baseline"})
    found = length_unlike_file(given, NaturalSource([], replace(RIG, is_metric=is_metric)))
    assert [one.code for one in found] == ["baseline-unlike-file"] * is_said
    assert all(f"by --baseline the cameras stand {rig.baseline_m:.4g} m apart" in one.text for one in found)


def test_lengths_are_averaged_and_contradictions_named():
    start = calibration(RIG, [0.1, *[1e-4] * 3, *[1e-3] * 3])
    good, wrong = seen(RIG, ENDS_M, LENGTH_M), seen(RIG, ENDS_M + [2.0, 0.1, 1.0], 1.2 * LENGTH_M)
    one, two = with_known_lengths(start, [good]), with_known_lengths(start, [good, good])
    assert not two.findings and two.rig.baseline_m == pytest.approx(RIG.baseline_m)
    assert 0.7 < two.baseline_sigma_m / one.baseline_sigma_m < 0.9  # what the turn brings is common to both
    odd = with_known_lengths(start, [good, wrong])
    assert [one.code for one in odd.findings] == ["known-lengths-disagree"]
    assert RIG.baseline_m < odd.rig.baseline_m < 1.2 * RIG.baseline_m
    with pytest.raises(DataError, match="not found"):
        with_known_lengths(start, [replace(good, right_px=good.left_px + [200.0, 0.0])])


def test_points_are_found_along_the_epipolar_line(images):
    for end in ENDS_M:
        found = match_along_epipolar(*images, RIG, CAMERA.project(end[None])[0])
        truth = CAMERA.project(RIG.T_right_left.apply(end[None]))[0]
        assert np.linalg.norm(found.right_px - truth) < 0.15 and found.likeness > 0.9
    with pytest.raises(NotMatchedError, match="outside of the left image of 480x360"):
        match_along_epipolar(*images, RIG, np.array([480.0, 100.0]))
    with pytest.raises(NotMatchedError, match="border"):
        match_along_epipolar(*images, RIG, np.array([3.0, 100.0]))
    flat = np.full((360, 480), 90, np.uint8)
    with pytest.raises(NotMatchedError, match="looks like it"):
        match_along_epipolar(flat, images[1], RIG, CAMERA.project(ENDS_M)[0])
    stripes = np.tile((np.arange(480) // 6 % 2 * 120 + 60).astype(np.uint8), (360, 1))
    with pytest.raises(NotMatchedError, match="two places"):
        match_along_epipolar(
            stripes, stripes, replace(RIG, T_right_left=SE3(np.eye(3), RIG.T_right_left.t)), np.array([240.0, 180])
        )


def test_recalibrate_takes_its_length_from_the_scene(images, tmp_path, capsys):
    """The old rig is turned and has half of the length; a known length of the first pair mends that."""
    for side, image in zip(("left", "right"), images, strict=True):
        cv2.imwrite(str(tmp_path / f"{side}_7.png"), image)
    turn = so3.exp(np.radians([0.5, 0.0, 0.0]))
    rig_json.write_rig(
        tmp_path / "old.json", StereoRig(CAMERA, CAMERA, SE3(turn @ RIG.T_right_left.R, 0.5 * RIG.T_right_left.t))
    )
    (x, y), (x2, y2) = CAMERA.project(ENDS_M)
    output = tmp_path / "new.json"
    source = [
        "--left",
        str(tmp_path / "left_*.png"),
        "--right",
        str(tmp_path / "right_*.png"),
        "--rig",
        str(tmp_path / "old.json"),
    ]
    arguments = ["recalibrate", *source, "--calibrator", "lm", "--output", str(output), "--json", "--known-length"]
    assert main([*arguments, f"0:{x},{y}:{x2},{y2}={1000 * LENGTH_M}mm"]) == 0
    document = json.loads(capsys.readouterr().out)
    new = rig_json.read_calibration(output)
    assert abs(new.rig.baseline_m - RIG.baseline_m) < 3 * new.baseline_sigma_m < 0.06 * RIG.baseline_m
    assert document["provenance"]["length_from"] == "a known length in the scene"
    assert document["provenance"]["known_lengths"][0]["pair"] == "7"
    assert "baseline-unlike-file" in [one["code"] for one in document["findings"]]  # the old file has half of it
    assert main([*arguments, "nine:1,2:3,4=1m", "--force"]) == 3 and "pair nine" in capsys.readouterr().err


def test_what_cannot_be_measured_is_refused_by_name(images, tmp_path):
    for side, image in zip(("left", "right"), images, strict=True):
        cv2.imwrite(str(tmp_path / f"{side}_7.png"), image)
    pairs = [StereoPair("7", tmp_path / "left_7.png", tmp_path / "right_7.png")]
    start = calibration(RIG, [0.1, *[1e-4] * 3, *[1e-3] * 3])
    for ends, code in (
        (np.array([[1.0, 2.0], [300.0, 200.0]]), "known-length-not-found"),
        (CAMERA.project(ENDS_M)[[0, 0]] + [[0.0, 0.0], [0.5, 0.0]], "known-length-tells-too-little"),
    ):
        with pytest.raises(DataError) as caught:
            measure_known_lengths(start, pairs, [KnownLength("7", ends, 1.0)])
        assert [one.code for one in caught.value.findings] == [code]
    found = measure_known_lengths(start, pairs, [KnownLength("0", CAMERA.project(ENDS_M), LENGTH_M)])
    assert abs(found.rig.baseline_m - RIG.baseline_m) < 2 * found.baseline_sigma_m


def test_the_words_of_the_option():
    length = parse_known_length("a:b:120.5,300.2:410,298.7=1.50m+-2mm")
    assert isinstance(length, KnownLength) and length.pair == "a:b" and length.sigma_m == pytest.approx(0.002)
    np.testing.assert_allclose(length.left_px, [[120.5, 300.2], [410, 298.7]])
    assert parse_known_length("0:1,2:3,4=30mm").length_m == pytest.approx(0.03)
    for text in (
        "0:1,2:3,4=30",
        "0:1,2:3,4=",
        "0:1,2:1,2=1m",
        "1,2:3,4=1m",
        "0:1,2:3=1m",
        "0:1,nan:3,4=1m",
        "0:1,2:3,4=1m+-",
        "0:x,2:3,4=1m",
        "0:1,2:3,4=-1m",
    ):
        with pytest.raises(typer.BadParameter, match="--known-length"):
            parse_known_length(text)


@pytest.mark.parametrize(
    ("option", "words"), [("--baseline=1m", "leave one out"), ("--reference", "whose length stays")]
)
def test_a_length_is_given_once(option, words, capsys):
    assert main(["recalibrate", "--dataset", "euroc:x", "--known-length", "0:1,2:3,4=1m", option]) == 2
    assert words in " ".join(capsys.readouterr().err.split())


def test_a_reference_keeps_the_files_length(capsys):
    assert main(["recalibrate", "--dataset", "euroc:x", "--reference", "--baseline", "1m"]) == 2
    assert "whose length stays: leave out --baseline" in capsys.readouterr().err
