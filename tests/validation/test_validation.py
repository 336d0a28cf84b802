"""Checks of a calibration on its own corners: quiet on sound sets, loud on what is wrong, with a size that is right."""

from dataclasses import replace

import numpy as np
import pytest

from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.cameras import Camera, StereoRig
from binocal.errors import CancelledError, NotConvergedError
from binocal.findings import Severity
from binocal.geometry import so3
from binocal.simulation import StereoScene, random_rig, sample_board_poses, simulate_detections, table2_rig
from binocal.uncertainty import Covariance
from binocal.validation import (
    corner_residuals,
    cross_validate,
    halves,
    measure_lens_adequacy,
    measure_whiteness,
    overview,
    smooth_residuals,
    validate,
)
from binocal.validation.halves import projection_difference_px
from binocal.validation.lens import N_BASIS, spline_basis

pytestmark = pytest.mark.usefixtures("many_calls")

RIG, BOARD, NOISE_PX = table2_rig(), parse_board("chessboard:8x6:25mm"), 0.15


def seen(rig=RIG, n_views=16, seed=0):
    rng = np.random.default_rng(seed)
    return simulate_detections(
        StereoScene(rig, BOARD, sample_board_poses(rig, BOARD, n_views, rng)), rng, noise_px=NOISE_PX
    )


@pytest.fixture(scope="module")
def sound():
    return calibrate(seen(), model="brown4", calibrator="lm")


@pytest.fixture(scope="module")
def report(sound):
    return validate(sound)


def test_a_sound_set_has_notes_with_sizes_and_no_warning(sound, report):
    codes = [found.code for found in report.findings]
    assert codes == ["halves-agree", "lens-model-suffices", "rays-everywhere", "residuals-checked"]
    assert report.warnings == () and all(found.severity is Severity.NOTE for found in report.findings)
    assert 0.3 < report.halves.depth_z < 2 and report.halves.depth_rms < 5 * report.halves.depth_stated
    assert report.lens.gain.share < 0.01 and report.lens.largest_px < 0.1
    assert abs(report.whiteness.correlation) < 0.06 and report.whiteness.common_px < 0.05
    lines = overview(sound, report)
    assert [line.name for line in lines] == [
        "Views", "Fit", "Board", "Exposures", "Halves", "Lens", "Rays", "Residuals", "Depth", "Rows",
    ]  # fmt: skip
    assert all(line.severity is None and line.text for line in lines)
    unsure = replace(sound, covariance=Covariance(sound.covariance.names, 1e4 * sound.covariance.matrix))
    depth = next(line for line in overview(unsure, report) if line.name == "Depth")
    assert depth.severity is Severity.WARNING  # 5 % and more at the worst place


def test_halves_of_a_rig_that_changed_disagree(sound):
    """Every other view by a rig turned by a degree's twentieth: what each half says alone is sound."""
    turned = StereoRig(RIG.left, RIG.right, RIG.T_right_left)
    W, T = so3.exp(np.radians([0.0, 0.05, 0.0])), RIG.T_right_left
    turned = replace(turned, T_right_left=type(T)(W @ T.R, T.t))
    rng = np.random.default_rng(1)
    poses = sample_board_poses(RIG, BOARD, 16, rng)
    first, second = (
        simulate_detections(StereoScene(rig, BOARD, poses), np.random.default_rng(2), noise_px=NOISE_PX)
        for rig in (RIG, turned)
    )
    even = (np.arange(16) % 2 == 0)[:, None, None]
    mixed = replace(first, right_px=np.where(even, first.right_px, second.right_px))
    cross = cross_validate(replace(sound, evidence=replace(sound.evidence, detections=mixed)))
    assert cross.depth_z > 5
    # the turn is along the disparity: depth at the far range is off by z / b times it
    far = cross.fields[1].depth_m
    assert np.nanmedian(np.abs(cross.depth[1])) == pytest.approx(far / 0.06 * np.radians(0.05), rel=0.3)


def test_a_lens_that_its_model_cannot_follow_is_said_with_its_size():
    rng = np.random.default_rng(0)
    rig = random_rig(rng, "fisheye4", size_wh=(640, 480), field_deg=100)
    scene = StereoScene(rig, BOARD, sample_board_poses(rig, BOARD, 24, rng))
    detections = simulate_detections(scene, rng, noise_px=0.1)
    plain = validate(calibrate(detections, model="brown4", calibrator="lm"))
    (found,) = [f for f in plain.findings if f.code.startswith("lens-model-")]
    fitting = measure_lens_adequacy(calibrate(detections, model="fisheye4", calibrator="lm"))
    assert fitting.gain.share < 0.01 and fitting.largest_px < 0.1
    assert (
        found.code == "lens-model-misfits" and found.figures["share_percent"] > 10
    )  # measured: 23 to 64 on four lenses
    assert plain.lens.largest_px == found.figures["profile_px"] > 0.3


def test_errors_that_neighbours_share_are_measured(sound):
    rng = np.random.default_rng(3)
    x, y = BOARD.object_points_m[:, :2].T / 0.05  # smooth over two squares
    detections = seen(seed=4)
    for side in ("left_px", "right_px"):
        phase = rng.uniform(0, 6, (detections.n_views, 4, 1))
        wave = np.stack(
            [np.sin(x + phase[:, 0]) * np.cos(y + phase[:, 1]), np.cos(x + phase[:, 2]) * np.sin(y + phase[:, 3])], -1
        )
        detections = replace(detections, **{side: getattr(detections, side) + 0.2 * wave})
    made = calibrate(detections, model="brown4", calibrator="lm")
    white = measure_whiteness(made)
    assert white.correlation > 0.15 and 0.04 < white.common_px < 0.15 and white.sigma < 0.03
    assert white.by_point_px.shape == (48, 4) and white.by_view_px.shape == (16, 4)
    counted = {**made.provenance, "views_in_common": {"sigma_factor": 2.0}}
    uncounted = {**made.provenance, "views_in_common": {"sigma_factor": 1.0}}
    codes = [
        [f.code for f in validate(replace(made, provenance=p)).findings if f.code.startswith("residuals")]
        for p in (counted, uncounted)
    ]
    expected = "residuals-correlated" if white.correlation > 0.2 else "residuals-checked"
    assert codes == [["residuals-checked"], [expected]]


def test_residuals_are_those_of_the_calibration(sound):
    left, right = corner_residuals(sound)
    together = np.concatenate([left, right], axis=1)
    rms = np.sqrt(np.nanmean(np.sum(together**2, axis=-1)))
    assert rms == pytest.approx(sound.rms.all_px, rel=1e-6)
    outliers = calibrate(simulate_outliers(), model="brown4", calibrator="lm")
    left, right = corner_residuals(outliers)
    rms = np.sqrt(np.nanmean(np.sum(np.concatenate([left, right], axis=1) ** 2, axis=-1)))
    assert rms == pytest.approx(outliers.rms.all_px, rel=1e-6)  # those without weight count in neither


def simulate_outliers():
    from binocal.simulation.noise import add_outliers

    return add_outliers(seen(), np.random.default_rng(0), share=0.02, distance_px=5.0)


def test_a_turn_of_the_camera_is_no_difference_of_its_projection():
    a = RIG.left
    moved = Camera(a.model, a.size_wh, a.parameters + np.r_[0, 0, 3.0, 0, np.zeros(5)])
    grid = np.ones((5, 7), dtype=bool)
    assert np.all(projection_difference_px(a, a, grid) < 1e-9)
    assert np.nanmax(projection_difference_px(a, moved, grid)) < 0.6  # 3 px of principal point are mostly a turn
    wider = Camera(a.model, a.size_wh, a.parameters * np.r_[1.01, 1.01, np.ones(7)])
    corner = projection_difference_px(a, wider, grid)[0, 0]
    assert corner == pytest.approx(0.01 * np.hypot(647, 473), rel=0.1)
    assert np.isnan(projection_difference_px(a, a, np.zeros((5, 7), dtype=bool))).all()


def test_splines_add_up_to_one_and_reach_the_ends():
    basis = spline_basis(np.linspace(0, 1, 50))
    np.testing.assert_allclose(basis.sum(axis=-1), 1, atol=1e-12)
    assert basis.shape == (50, N_BASIS) and (basis >= 0).all() and (basis.max(axis=0) > 0.1).all()


def test_too_few_views_and_failing_halves_are_said(sound, monkeypatch):
    few = calibrate(seen(n_views=7), model="brown4", calibrator="lm")
    assert cross_validate(few) is None
    found = validate(few).findings[0]
    assert found.code == "halves-undetermined" and "8 views are needed" in found.text

    def fails(*given, **options):
        raise NotConvergedError("no minimum\nin 100 iterations", {})

    monkeypatch.setattr(halves, "calibrate_as_requested", fails)
    report = validate(sound)
    assert report.halves.failure == "no minimum in 100 iterations" and np.isnan(report.halves.depth_z)
    assert "no minimum in 100 iterations" in report.findings[0].text
    assert next(line for line in overview(sound, report) if line.name == "Halves").text.startswith("not compared")

    def stopped(*given, **options):
        raise CancelledError("stopped")

    monkeypatch.setattr(halves, "calibrate_as_requested", stopped)
    with pytest.raises(CancelledError):
        validate(sound)


def test_without_corners_nothing_is_checked(sound):
    bare = replace(sound, evidence=None)
    assert validate(bare).findings == ()
    assert [line.name for line in overview(bare, validate(bare))][:2] == ["Views", "Fit"]


def test_residuals_are_averaged_over_the_image():
    rng = np.random.default_rng(0)
    px = rng.uniform((0, 0), (639, 479), (40, 50, 2))
    field = np.stack([px[..., 0] / 640 - 0.5, 0 * px[..., 0]], axis=-1)  # outwards to left and right
    noisy = field + rng.normal(0, 0.3, px.shape)
    noisy[0, :10] = np.nan
    noisy[px[..., 1] > 300] = np.nan
    smoothed = smooth_residuals(px, noisy, (640, 480))
    known = np.isfinite(smoothed.sigma_px)
    assert known.any() and not known[smoothed.px[..., 1] > 420].any()
    off = smoothed.mean_px[known] - np.stack([smoothed.px[known][:, 0] / 640 - 0.5, np.zeros(known.sum())], axis=-1)
    inner = (smoothed.px[known][:, 0] > 80) & (smoothed.px[known][:, 0] < 560)
    assert 0.5 < np.sqrt(np.mean((off[inner] / smoothed.sigma_px[known][inner, None]) ** 2)) < 1.3
    assert np.isnan(smooth_residuals(px, np.full(px.shape, np.nan), (640, 480)).mean_px).all()
