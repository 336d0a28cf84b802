"""The rough start for clean sets: near enough on clean ones, silent on the others."""

from dataclasses import replace

import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.calibrators import CalibrationRequest, calibrate, joint
from binocal.geometry import so3
from binocal.initialization.verified_start import estimate_verified_start
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig
from binocal.solvers.minimization import minimize

BOARD = parse_board("chessboard:11x8:20mm")


def make_views(n_views=12, seed=0, noise_px=0.2):
    rng = np.random.default_rng(seed)
    rig = table2_rig()
    scene = StereoScene(rig, BOARD, sample_board_poses(rig, BOARD, n_views, rng))
    return rig, simulate_detections(scene, rng, noise_px=noise_px)


def test_the_start_is_near_the_rig():
    # measured: focal length 1.5 %, rotation 0.9 deg, translation 17 mm (depth follows the focal length)
    rig, detections = make_views()
    start = estimate_verified_start(detections, "brown5")
    assert abs(start.parameters[0][0] / rig.left.parameters[0] - 1) < 0.03
    assert np.degrees(so3.angle_rad(start.R_right_left @ rig.T_right_left.R.T)) < 2.0
    assert np.linalg.norm(start.t_right_left - rig.T_right_left.t) < 0.03
    assert 0.2 < start.homography_px < 0.6


@pytest.mark.parametrize("what", ["few corners", "outside"])
def test_what_does_not_look_clean_gets_no_start(what):
    _, detections = make_views()
    px = detections.left_px.copy()
    if what == "few corners":
        px[3, 11:] = np.nan
    else:
        px[3, 5] = [1290.0, 100.0]
    assert estimate_verified_start(replace(detections, left_px=px), "brown5") is None


def test_a_clean_set_goes_the_short_way_and_ends_where_the_long_one_does(monkeypatch):
    _, detections = make_views()
    monkeypatch.setattr(joint, "diagnose_views", None)  # the short way never asks
    short = calibrate(detections, model="brown5")
    monkeypatch.undo()
    monkeypatch.setattr(joint, "_calibrate_clean", lambda *_: None)
    long = calibrate(detections, model="brown5")
    # equal to 0.02 sigma, the solver's own tolerance; measured 0.002
    apart = (short.rig.left.parameters - long.rig.left.parameters)[[0, 1, 2, 3]]
    sigma = [short.covariance.sigma[f"left.{name}"] for name in ("fx", "fy", "cx", "cy")]
    assert np.abs(apart / sigma).max() < 0.02
    assert np.linalg.norm(short.rig.T_right_left.t - long.rig.T_right_left.t) < 1e-6
    assert short.noise_px == pytest.approx(long.noise_px, rel=1e-3) and short.rejected == long.rejected == ()


@pytest.mark.parametrize("what", ["flipped view", "wild corners", "collinear view", "swapped images of one view"])
def test_a_doubtful_set_goes_the_long_way(what):
    _, detections = make_views(30)
    right = detections.right_px.copy()
    if what == "flipped view":
        right[4] = right[4, ::-1]
    elif what == "wild corners":
        right[4, :6] += 40.0
    elif what == "collinear view":
        right[4] = right[4, :1] + np.linspace(0, 1, 88)[:, None] * [300.0, 100.0]
    else:
        right[[4, 5]] = right[[5, 4]]
    assert joint._calibrate_clean(replace(detections, right_px=right), CalibrationRequest("brown5"), minimize) is None
    assert joint._calibrate_clean(detections, CalibrationRequest("brown5"), minimize) is not None
