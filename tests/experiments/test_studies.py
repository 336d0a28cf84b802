"""What goes beyond the paper's experiment: target distance, preparation of images, colour channels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.errors import BinocalError
from binocal.evidence import Detections
from binocal.experiments import colours, preparations
from binocal.experiments import target_distance as distance
from binocal.experiments.case import Sample, results_of
from binocal.experiments.rendered import RenderedFiles
from binocal.simulation import StereoScene, sample_board_poses, table2_rig


def figures(result):
    assert not result.failure
    return {one.criterion: one for one in result.measured}


@pytest.mark.parametrize("distance_m", [0.3, 10.0])
def test_the_target_fills_the_common_field_at_its_distance(distance_m):
    rig = table2_rig()
    target = distance.target_at(rig, distance_m)
    assert np.all(target.points[:, 2] == distance_m) and len(target.points) == distance.GRID**2
    assert np.all((target.left_px > 0) & (target.left_px < rig.left.size_wh))
    assert np.ptp(target.left_px[:, 0]) > 0.6 * 1280 * (1 - 320 / 1280 * (distance_m < 1))


def test_depth_and_length_err_as_the_calibration_predicts():
    cases = [case for case in distance.distance_cases() if case.name in ("1 m", "10 m")]
    shares = []
    for case in cases:
        case = replace(case, make=distance.NoisyCorners(8))
        found = [results_of(case, seed, ["lm", "prior unchanged", "Cramér-Rao bound"]) for seed in range(3)]
        for lm, prior, bound in found:
            ours, prior = figures(lm), figures(prior)
            shares.append([one.value / one.bound for one in ours.values()])
            assert figures(bound)["depth error, exact matches"].value < 3 * ours["depth error, exact matches"].bound
            far_off = prior["depth error, exact matches"].value
            assert np.isnan(far_off) or far_off > 10 * ours["depth error, exact matches"].value
    rms = np.sqrt(np.mean(np.square(shares), axis=0))
    assert np.all((rms > 0.4) & (rms < 1.8)) and rms[1] == pytest.approx(1, abs=0.25)


@pytest.fixture(scope="module")
def found():
    """Exact corners of six views, and the same with noise."""
    rig, board = table2_rig(), parse_board(preparations.SPEC)
    poses = sample_board_poses(rig, board, 6, np.random.default_rng(0))
    files = RenderedFiles(StereoScene(rig, board, poses), ())
    rng = np.random.default_rng(1)
    sides = [side + rng.normal(0, 0.03, side.shape) for side in files.exact_px()]
    return files, Detections.from_arrays(board.object_points_m, *sides, rig.left.size_wh)


def test_corner_figures_are_those_of_the_noise(found):
    files, corners = found
    pixels = corners.left_px.copy()
    pixels[0, 3] += 5  # a wrong corner
    pixels[1, :8] = np.nan
    corners = replace(corners, left_px=pixels)
    said = preparations.corner_figures(files, corners)
    n = int(np.isfinite(np.stack(files.exact_px())[..., 0]).sum())
    n_lost = int(np.isfinite(files.exact_px()[0][1, :8, 0]).sum())
    assert said["corner error"][0] == pytest.approx(0.03, rel=0.1) and said["wrong corners"][0] == 1
    assert said["corners found"][0] == pytest.approx(100 * (n - n_lost - 1) / n)


def test_a_displacement_is_told_of_both_cameras(found):
    _, green = found
    middle = (np.array(green.left_size_wh) - 1) / 2
    red = replace(green, left_px=green.left_px + 6e-4 * (green.left_px - middle))
    sample = Sample({"green": green, "red": red}, table2_rig())
    (made,) = colours.Displacement("red against green")(sample)
    assert made.said["aberration in the image's corner, left"][0] == pytest.approx(6e-4 * 800, rel=0.01)
    assert abs(made.said["aberration in the image's corner, right"][0]) < 1e-9
    few = {"green": green, "red": red.select(np.arange(2))}
    with pytest.raises(BinocalError, match="too few"):
        colours.Displacement("red against green")(Sample(few, table2_rig()))


def test_halves_of_a_recording_are_the_same_views_in_every_channel(found):
    _, green = found
    red = green.select(np.arange(5))
    sample = colours.ColourHalves({"green": green, "red": red}, "brown4")(0)
    for half in (sample.evidence, sample.truth):
        assert half["green"].names == half["red"].names
    assert not set(sample.evidence["red"].names) & set(sample.truth["red"].names)
    (made,) = colours.HeldOutIn("green")(Sample({"green": green}, {"green": green}, choices={"model": "brown4"}))
    assert made.said["held-out row error"][0] < 0.1
