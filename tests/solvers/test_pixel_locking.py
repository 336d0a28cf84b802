"""Periodic errors of the measured coordinates: found where they are, nowhere else, and taken out."""

from dataclasses import replace

import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.evidence.pixel_locking import PixelLocking, RigLocking
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig
from binocal.solvers.pixel_locking import find_pixel_locking

BOARD = parse_board("chessboard:11x8:20mm")


def curve(u, period_px, amplitude_px):
    """A lock to the middles of the pixels, with its first overtone."""
    phase = 2 * np.pi * u / period_px
    return -amplitude_px * (np.sin(phase) + 0.3 * np.sin(2 * phase))


def locked(truth_px, period_px, amplitude_px, rng, noise_px=0.03):
    return truth_px + curve(truth_px, period_px, amplitude_px) + noise_px * rng.standard_normal(truth_px.shape)


@pytest.mark.parametrize("period_px", [1.0, 2.0, 3.0, 4.0])
def test_a_lock_is_found_with_its_period_and_taken_out(period_px):
    rng = np.random.default_rng(0)
    truth = rng.uniform(0, 600, (20, 54, 2))
    measured = locked(truth, period_px, 0.03, rng)
    measured[0, :10] = np.nan
    is_seen = np.isfinite(measured[..., 0])
    locking = find_pixel_locking(measured - truth, measured, is_seen)
    assert locking is not None
    assert locking.period_px == pytest.approx(period_px) and locking.amplitude_px == pytest.approx(0.034, rel=0.15)
    assert np.all(np.abs(locking.variance_share - 0.37) < 0.08)  # 0.03^2 (1 + 0.09) / 2 beside 0.03^2: 0.35
    left = (locking.corrected(measured) - truth)[is_seen]
    assert np.std(left) == pytest.approx(0.03, rel=0.04) and np.std((measured - truth)[is_seen]) > 0.036
    other = locked(rng.uniform(0, 600, (5, 54, 2)), period_px, 0.03, rng, noise_px=0.0)  # corners it has not seen
    assert np.std(locking.errors_px(other) - curve(other, period_px, 0.03)) < 0.006


def test_a_lock_of_one_axis_leaves_the_other_alone():
    rng = np.random.default_rng(1)
    truth = rng.uniform(0, 600, (20, 54, 2))
    measured = truth + 0.03 * rng.standard_normal(truth.shape)
    measured[..., 1] += curve(truth[..., 1], 1.0, 0.03)
    locking = find_pixel_locking(measured - truth, measured, np.ones((20, 54), bool))
    assert locking is not None and locking.variance_share[0] == 0 < locking.variance_share[1]
    assert np.isnan(locking.period_px[0]) and np.array_equal(locking.corrected(measured)[..., 0], measured[..., 0])


def test_noise_board_and_outliers_are_no_lock():
    rng = np.random.default_rng(2)
    for n_views in (4, 12, 100):
        for _ in range(20):
            points = rng.uniform(0, 600, (n_views, 54, 2))
            residuals = 0.1 * rng.standard_normal(points.shape) + 0.2 * rng.standard_normal((54, 2))
            residuals[0, :3] = 30.0
            weights = np.ones((n_views, 54))
            weights[0, :3] = 0.0
            assert find_pixel_locking(residuals, points, np.ones((n_views, 54), bool), weights) is None


def test_a_bent_board_does_not_hide_a_lock():
    rng = np.random.default_rng(3)
    truth = rng.uniform(0, 600, (12, 54, 2))
    measured = locked(truth + 0.2 * rng.standard_normal((54, 2)), 1.0, 0.03, rng)
    locking = find_pixel_locking(measured - truth, measured, np.ones((12, 54), bool))
    assert locking is not None and locking.variance_share.min() > 0.2


def test_too_few_corners_say_nothing():
    rng = np.random.default_rng(4)
    truth = rng.uniform(0, 600, (2, 40, 2))
    measured = locked(truth, 1.0, 0.1, rng)
    assert find_pixel_locking(measured - truth, measured, np.ones((2, 40), bool)) is None


def test_it_is_written_and_read_as_plain_data():
    rng = np.random.default_rng(5)
    truth = rng.uniform(0, 600, (20, 54, 2))
    measured = locked(truth, 4.0, 0.03, rng)
    both = RigLocking(right=find_pixel_locking(measured - truth, measured, np.ones((20, 54), bool)))
    again = RigLocking.of_document(both.document())
    assert again.left is None and again.right is not None and both.right is not None
    assert np.array_equal(again.right.corrected(measured), both.right.corrected(measured))
    with pytest.raises(ValueError, match="without sines_px"):
        PixelLocking.of_document({k: v for k, v in both.right.document().items() if k != "sines_px"})


@pytest.mark.usefixtures("unchecked_types")
def test_shapes_are_checked():
    with pytest.raises(ValueError, match="2 frequencies need"):
        PixelLocking(np.ones(2), np.ones((2, 3)), np.ones((2, 2)), np.ones(2))


def simulated(rng, n_views=15):
    rig = table2_rig()
    return simulate_detections(StereoScene(rig, BOARD, sample_board_poses(rig, BOARD, n_views, rng)), rng)


def test_a_rig_of_corners_that_lock_is_that_of_corners_that_do_not():
    rng = np.random.default_rng(6)
    exact = simulated(rng)
    noisy = replace(
        exact,
        **{
            f"{s}_px": getattr(exact, f"{s}_px") + 0.02 * rng.standard_normal(exact.left_px.shape)
            for s in ("left", "right")
        },
    )
    clean = calibrate(noisy, model="brown4")
    assert not clean.findings and "pixel_locking" not in clean.provenance
    right = noisy.right_px + curve(exact.right_px, 1.0, 0.04)
    calibration = calibrate(replace(noisy, right_px=right), model="brown4")
    (found,) = calibration.findings
    assert found.code == "corners-lock-to-pixels" and found.figures["camera"] == "right"
    assert found.figures["period_px"] == pytest.approx(1) and found.figures["amplitude_px"] == pytest.approx(
        0.045, rel=0.15
    )
    assert calibration.noise_px == pytest.approx(clean.noise_px, rel=0.1)  # 0.03 px with the curve left in
    # The evidence stays as it was measured; what was taken out can be taken out of other corners of the camera.
    assert np.array_equal(calibration.corners.detections.right_px, right)
    locking = RigLocking.of_document(calibration.provenance["pixel_locking"])
    assert locking.left is None and locking.right is not None
    assert np.std(locking.right.corrected(right) - noisy.right_px) < 0.008


@pytest.mark.slow
def test_clean_rigs_are_not_said_to_lock():
    for seed in range(60):
        rng = np.random.default_rng(seed)
        exact = simulated(rng, int(rng.integers(4, 30)))
        noise_px = rng.choice([0.03, 0.1, 0.3])
        noisy = replace(
            exact,
            left_px=exact.left_px + noise_px * rng.standard_normal(exact.left_px.shape),
            right_px=exact.right_px + noise_px * rng.standard_normal(exact.left_px.shape),
        )
        codes = {found.code for found in calibrate(noisy, model="brown4").findings}
        assert "corners-lock-to-pixels" not in codes
