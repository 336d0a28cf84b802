"""Nothing wrong in silence: each mistake ends right, with the culprit named, or refused by name."""

import re
from functools import partial

import numpy as np
import pytest

from binocal import calibrators
from binocal.boards import parse_board
from binocal.errors import BinocalError, CalibrationError, DataError, DegenerateGeometryError, TooFewViewsError
from binocal.evidence import Detections
from binocal.geometry import so3
from binocal.simulation import corruptions as wrong
from binocal.simulation.noise import add_outliers, simulate_detections
from binocal.simulation.rigs import table2_rig
from binocal.simulation.scenes import StereoScene, fronto_parallel, same_pose, sample_board_poses
from binocal.solvers.covariance import cramer_rao_bound

BOARD = parse_board("chessboard:11x8:20mm")
NOISE_PX = 0.2
calibrate = partial(calibrators.calibrate, model="brown4")
VIEWS = 20


@pytest.fixture(scope="module", params=[0, 1, 2])
def clean(request):
    """Scene, its clean detections, their calibration and the bound."""
    rng = np.random.default_rng(request.param)
    rig = table2_rig()
    scene = StereoScene(rig, BOARD, sample_board_poses(rig, BOARD, VIEWS, rng))
    detections = simulate_detections(scene, rng, noise_px=NOISE_PX)
    bound = cramer_rao_bound(rig, BOARD.object_points_m, scene.T_left_board, NOISE_PX)
    return detections, calibrate(detections), bound


def said(calibration):
    """Everything that the result tells the user."""
    lines = list(calibration.warnings)
    lines += [f"{r.name}: {r.reason}" for r in calibration.rejected]
    lines += [f"{v.name}: {v.note}" for v in calibration.views if v.note]
    return "\n".join(lines)


def assert_right(calibration, reference, bound, factor=1.0):
    """Rotation, translation and focal lengths within ``factor`` sigma of the clean result."""
    ours, theirs, sigma = calibration.rig, reference.rig, bound.sigma
    rotation = so3.log(ours.T_right_left.R @ theirs.T_right_left.R.T)
    for axis, value in zip("xyz", rotation, strict=True):
        assert abs(value) < factor * sigma[f"rotation.{axis}"]
    for axis, value in zip("xyz", ours.T_right_left.t - theirs.T_right_left.t, strict=True):
        assert abs(value) < factor * sigma[f"translation.{axis}"]
    for side in ("left", "right"):
        for i, name in enumerate(("fx", "fy")):
            difference = getattr(ours, side).parameters[i] - getattr(theirs, side).parameters[i]
            assert abs(difference) < factor * sigma[f"{side}.{name}"]


def test_the_clean_set_is_clean(clean):
    _, calibration, bound = clean
    assert said(calibration) == "" and len(calibration.views) == VIEWS
    assert calibration.noise_px == pytest.approx(NOISE_PX, rel=0.05)
    sigma = calibration.covariance.sigma
    assert sigma["translation.x"] == pytest.approx(bound.sigma["translation.x"], rel=0.15)


@pytest.mark.parametrize("distance_px", [5.0, 50.0])
def test_five_percent_of_the_corners_off(clean, distance_px):
    detections, reference, bound = clean
    spoiled = add_outliers(detections, np.random.default_rng(9), share=0.05, distance_px=distance_px)
    calibration = calibrate(spoiled)
    assert_right(calibration, reference, bound)
    moved = {
        (side, view, int(corner))
        for side, before, after in (
            ("left", detections.left_px, spoiled.left_px),
            ("right", detections.right_px, spoiled.right_px),
        )
        for view, name in enumerate(detections.names)
        for corner in np.nonzero(np.abs(after[view] - before[view]).max(axis=1) > 0)[0]
    }
    named = {(o.camera, int(v.name), o.corner) for v in calibration.views for o in v.outliers}
    assert len(moved - named) == 0
    assert len(named - moved) <= 5
    assert re.search(r"of 3520 corners \(\d\.\d %\) do not fit", said(calibration))


REPAIRED = {
    "one left view flipped": (lambda d: wrong.flip_view(d, 4), r"04.*revers|revers.*04"),
    "one right view flipped": (lambda d: wrong.flip_view(d, 7, side="right"), r"07.*revers|revers.*07"),
    "all left views flipped": (wrong.flip_all_left, r"revers"),
    "one left view shifted by a row": (lambda d: wrong.shift_view_by_row(d, BOARD, 3), r"03: "),
    "shifted, wrapped round": (lambda d: wrong.shift_view_by_row(d, BOARD, 3, vacated="wrap"), r"03: "),
    "shifted, last row missing": (lambda d: wrong.shift_view_by_row(d, BOARD, 3, vacated="missing"), r"03: "),
    "one right view shifted by a row": (lambda d: wrong.shift_view_by_row(d, BOARD, 6, side="right"), r"06: "),
    "one pair mismatched": (lambda d: wrong.mismatch_pair(d, 5, 12), r"05: "),
    "one view of zeros": (lambda d: wrong.zero_view(d, 2), r"02: "),
}


@pytest.mark.parametrize("case", list(REPAIRED))
def test_one_bad_view_is_repaired_or_dropped_and_named(clean, case):
    detections, reference, bound = clean
    spoil, message = REPAIRED[case]
    calibration = calibrate(spoil(detections))
    assert_right(calibration, reference, bound, factor=1.5)
    assert re.search(message, said(calibration)), said(calibration)
    assert len(calibration.views) >= VIEWS - 1


def test_swapped_cameras_are_said_and_calibrated(clean):
    detections, reference, bound = clean
    calibration = calibrate(wrong.swap_cameras(detections))
    assert "exchange" in said(calibration) and "--left" in said(calibration)
    T = calibration.rig.T_right_left.inverse()
    assert np.abs(T.t - reference.rig.T_right_left.t).max() < 2 * max(bound.sigma[f"translation.{a}"] for a in "xyz")


REFUSED = {
    "all pairs off by one": (wrong.shift_all_pairs, r"off by one|k matches"),
    "columns and rows exchanged": (lambda d: wrong.exchange_columns_and_rows(d, BOARD), r"columns and rows|rows"),
    "1 view": (lambda d: d.select(np.arange(1)), r"1 usable view"),
    "2 views": (lambda d: d.select(np.arange(2)), r"2 usable views"),
    "image size swapped": (wrong.swap_image_size, r"outside"),
    "image size too small": (lambda d: wrong.state_image_size(d, (640, 480)), r"outside"),
    "image size too large": (lambda d: wrong.state_image_size(d, (2560, 1920)), r"image size"),
    "right corners at half resolution": (wrong.halve_right_resolution, r"right.*resolution|resolution.*right"),
    "same view 20 times": (lambda d: wrong.repeat_view(d, 0, 20), r"same|pose|tilt"),
}


@pytest.mark.parametrize("case", list(REFUSED))
def test_what_cannot_be_right_is_refused_by_name(clean, case):
    detections, _, _ = clean
    spoil, message = REFUSED[case]
    with pytest.raises(BinocalError, match=message) as caught:
        calibrate(spoil(detections))
    assert isinstance(caught.value, (CalibrationError, DataError))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("size_wh", [(1440, 1080), (1536, 1152), (1600, 1200), (1920, 1080), (1440, 960)])
def test_a_size_a_little_too_large_is_said(clean, size_wh):
    detections, reference, bound = clean
    calibration = calibrate(wrong.state_image_size(detections, size_wh))
    assert_right(calibration, reference, bound)
    assert "check the image size" in said(calibration)


def test_few_views_carry_their_number(clean):
    with pytest.raises(TooFewViewsError) as caught:
        calibrate(clean[0].select(np.arange(2)))
    assert (caught.value.found, caught.value.needed) == (2, 3)


@pytest.mark.parametrize("noise_px", [0.02, 0.1, 0.3, 0.5])
@pytest.mark.parametrize("poses", [fronto_parallel, same_pose])
def test_degenerate_views_are_refused(poses, noise_px):
    rig = table2_rig()
    for seed in range(3):
        rng = np.random.default_rng(seed)
        scene = StereoScene(rig, BOARD, poses(rig, BOARD, 20, rng))
        with pytest.raises((DegenerateGeometryError, TooFewViewsError), match=r"tilt"):
            calibrate(simulate_detections(scene, rng, noise_px=noise_px))


def test_nan_corners_are_corners_not_seen(clean):
    detections, reference, bound = clean
    left = detections.left_px.copy()
    left[:, ::5] = np.nan
    calibration = calibrate(Detections.from_arrays(detections.object_points_m, left, detections.right_px, (1280, 960)))
    assert_right(calibration, reference, bound, factor=1.5)
    left[3, 5, 0] = 4.0
    with pytest.raises(DataError, match=r"left view 03, corner 5: one coordinate is NaN"):
        Detections.from_arrays(detections.object_points_m, left, detections.right_px, (1280, 960))


@pytest.mark.usefixtures("unchecked_types")
def test_twenty_left_against_nineteen_right(clean):
    detections, _, _ = clean
    with pytest.raises(DataError, match="20 left views against 19 right views"):
        Detections.from_arrays(detections.object_points_m, detections.left_px, detections.right_px[:19], (1280, 960))
