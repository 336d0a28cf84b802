"""What must not matter, or follow exactly: the order of views, which camera is called left, the board's unit of length."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.evidence import Detections
from binocal.geometry import so3
from binocal.simulation.noise import simulate_detections
from binocal.simulation.rigs import random_rig
from binocal.simulation.scenes import StereoScene, sample_board_poses

pytestmark = pytest.mark.usefixtures("many_calls")

BOARD = parse_board("chessboard:8x6:30mm")
FEW = settings(max_examples=8, derandomize=True, deadline=None)
SEEDS = st.integers(0, 10_000)


def recording(seed, model="brown4", n_views=8):
    rng = np.random.default_rng(seed)
    rig = random_rig(rng, model)
    scene = StereoScene(rig, BOARD, sample_board_poses(rig, BOARD, n_views, rng))
    return simulate_detections(scene, rng, noise_px=0.2, outlier_share=0.02, outlier_px=20.0, missing_share=0.05)


def solved(detections, model="brown4"):
    return calibrate(detections, model=model, calibrator="lm")


def in_sigmas(a, b, *, scale=1.0):
    """The largest difference of two calibrations in standard deviations of the first; ``scale`` is b's unit of length over a's."""
    values = []
    for found, unit in ((a, 1.0), (b, scale)):
        cameras = [np.delete(camera.parameters, 4) for camera in (found.rig.left, found.rig.right)]
        turn = so3.log(found.rig.T_right_left.R @ a.rig.T_right_left.R.T)
        values.append(np.concatenate([*cameras, turn, found.rig.T_right_left.t / unit]))
    return np.max(np.abs(values[0] - values[1]) / np.sqrt(np.diag(a.covariance.matrix)))


@FEW
@given(SEEDS, st.randoms(use_true_random=False))
def test_the_order_of_the_views_does_not_matter(seed, shuffler):
    detections = recording(seed)
    order = list(range(detections.n_views))
    shuffler.shuffle(order)
    a, b = solved(detections), solved(detections.select(np.array(order)))
    assert in_sigmas(a, b) < 0.02  # the stop rule
    assert {v.name: v.n_outliers for v in a.views} == {v.name: v.n_outliers for v in b.views}
    assert [v.name for v in b.views] == [
        detections.names[i] for i in order if detections.names[i] in {v.name for v in a.views}
    ]


@FEW
@given(SEEDS)
def test_exchanged_cameras_give_the_inverse_rig(seed):
    detections = recording(seed)
    exchanged = replace(
        detections,
        left_px=detections.right_px,
        right_px=detections.left_px,
        left_size_wh=detections.right_size_wh,
        right_size_wh=detections.left_size_wh,
    )
    a, b = solved(detections), solved(exchanged)
    back = b.rig.T_right_left.inverse()
    turned_back = replace(b, rig=replace(b.rig, left=b.rig.right, right=b.rig.left, T_right_left=back))
    assert in_sigmas(a, turned_back) < 0.02
    assert "cameras-exchanged" in {f.code for f in b.findings} ^ {f.code for f in a.findings}
    assert a.noise_px == pytest.approx(b.noise_px, rel=1e-3)


@FEW
@given(SEEDS, st.floats(0.01, 100.0))
def test_a_larger_board_makes_a_longer_baseline_and_nothing_else(seed, factor):
    detections = recording(seed)
    larger = replace(detections, object_points_m=factor * detections.object_points_m)
    a, b = solved(detections), solved(larger)
    assert in_sigmas(a, b, scale=factor) < 0.02
    assert b.T_left_board.t == pytest.approx(factor * a.T_left_board.t, rel=1e-3, abs=1e-4 * factor)
    assert b.baseline_sigma_m == pytest.approx(factor * a.baseline_sigma_m, rel=1e-3)


@FEW
@given(SEEDS)
def test_a_crop_moves_the_principal_points_and_nothing_else(seed):
    """Cropping both images moves the principal points by the crop, and nothing else."""
    detections = recording(seed, n_views=10)
    shift = np.array([7.0, -5.0])
    width, height = detections.left_size_wh
    moved = Detections.from_arrays(
        detections.object_points_m, detections.left_px + shift, detections.right_px + shift, (width, height)
    )
    a, b = solved(detections), solved(moved)
    for side in ("left", "right"):
        assert getattr(b.rig, side).parameters[2:4] - getattr(a.rig, side).parameters[2:4] == pytest.approx(
            shift, abs=0.1
        )
    assert in_sigmas(replace(a, rig=replace(a.rig, left=b.rig.left, right=b.rig.right)), b) < 0.05
