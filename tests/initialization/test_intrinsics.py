from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from simulated_rigs import TABLE2, rotation_error_deg, simulate, with_outliers

from binocal.errors import TooFewViewsError
from binocal.geometry.homography import PlaneFrame
from binocal.initialization.distortion import estimate_lifting
from binocal.initialization.intrinsics import estimate_intrinsics

WIDE_BROWN = np.array([700, 700, 641, 470, 0, -0.35, 0.12, 1e-3, -5e-4])
FISHEYE = np.array([300, 300, 325, 236, 0, -0.02, 0.005, -0.003, 0.0005])
FISHEYE_150 = np.array([420, 420, 635, 486, 0, 0.02, -0.005, 0.001, 0])
NON_SQUARE = np.array([195, 231, 135, 88, 0, -0.1, 0.05, 0, 0])

# bound on the relative error of the focal length, and on the RMS distance in pixels (0.28 is the noise)
LENSES = {
    "table2": ("brown4", TABLE2, (1280, 960), 0.01, 0.32),
    "wide": ("brown5", np.r_[WIDE_BROWN, 0], (1280, 960), 0.02, 1.5),
    "wide8": ("brown8", np.r_[WIDE_BROWN, 0, 0, 0, 0], (1280, 960), 0.02, 1.5),
    "fisheye": ("fisheye4", FISHEYE, (640, 480), 0.01, 0.32),
    "fisheye150": ("fisheye4", FISHEYE_150, (1280, 960), 0.01, 0.35),
    "non_square": ("brown4", NON_SQUARE, (270, 180), 0.02, 0.32),
}


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("seed", range(3))
def test_lands_beside_the_truth(lens: str, seed: int) -> None:
    model, parameters, size_wh, focal_bound, rms_bound = LENSES[lens]
    rig = simulate(seed, model=model, parameters=parameters, size_wh=size_wh)
    camera = estimate_intrinsics(rig.points, rig.left_px, size_wh, model)
    assert camera.is_usable.all()
    assert camera.rms_px < rms_bound
    np.testing.assert_allclose(camera.parameters[:2], parameters[:2], rtol=focal_bound)
    np.testing.assert_allclose(camera.parameters[2:4], parameters[2:4], atol=0.02 * size_wh[0])
    assert np.median(rotation_error_deg(camera.poses.R, rig.T_left_board.R)) < 0.6  # measured 0.05 to 0.4


def test_three_views_are_enough() -> None:
    rig = simulate(0, 3)
    camera = estimate_intrinsics(rig.points, rig.left_px, rig.size_wh, "brown4")
    np.testing.assert_allclose(camera.parameters[:2], 1600, rtol=0.02)


@pytest.mark.parametrize(("share", "size_px"), [(0.05, 5), (0.05, 50), (0.3, 50)])
def test_outliers_do_not_move_it(share: float, size_px: float) -> None:
    rig = simulate(0)
    px, wild = with_outliers(rig.left_px, share, size_px, rig.rng)
    camera = estimate_intrinsics(rig.points, px, rig.size_wh, "brown4")
    np.testing.assert_allclose(camera.parameters[:2], 1600, rtol=0.01)
    assert np.median(camera.weights[wild]) < 0.1


def test_missing_corners_do_not_move_it() -> None:
    rig = simulate(1)
    px = rig.left_px.copy()
    px[rig.rng.random(px.shape[:2]) < 0.3] = np.nan
    camera = estimate_intrinsics(rig.points, px, rig.size_wh, "brown4")
    np.testing.assert_allclose(camera.parameters[:2], 1600, rtol=0.01)
    assert (camera.weights[np.isnan(px[..., 0])] == 0).all()


def test_exact_views_give_a_start_within_a_hundredth_of_a_pixel() -> None:
    rig = simulate(0, noise_px=0.0)
    camera = estimate_intrinsics(rig.points, rig.left_px, rig.size_wh, "brown4")
    assert camera.rms_px < 0.05  # the profile is a series of the model, not the model
    np.testing.assert_allclose(camera.parameters[:2], 1600, rtol=1e-3)


def test_views_without_corners_have_no_pose() -> None:
    rig = simulate(0)
    px = rig.left_px.copy()
    px[[2, 7]] = np.nan
    camera = estimate_intrinsics(rig.points, px, rig.size_wh, "brown4")
    assert np.flatnonzero(~camera.is_usable).tolist() == [2, 7]
    assert np.isnan(camera.poses.R[[2, 7]]).all() and np.isnan(camera.poses.t[[2, 7]]).all()


def test_no_view_and_an_unknown_model_are_refused() -> None:
    points = simulate(0, 1).points
    with pytest.raises(TooFewViewsError):
        estimate_intrinsics(points, np.full((3, 88, 2), np.nan), (640, 480), "brown4")
    with pytest.raises(ValueError, match="unknown camera model"):
        estimate_intrinsics(points, np.zeros((3, 88, 2)), (640, 480), "mirror")


@pytest.mark.data
def test_real_fisheye_images() -> None:
    folder = Path(os.environ.get("BINOCAL_DATA", Path(__file__).parents[3] / "shared" / "data")) / "stereopi_fisheye"
    if not folder.is_dir():
        pytest.skip(f"real images not found at {folder}; set BINOCAL_DATA")
    import cv2

    points = np.stack([*np.divmod(np.arange(54), 9)[::-1], np.zeros(54)], axis=-1) * 0.025
    views = []
    for path in sorted(folder.glob("left_*.png"))[:14]:
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        found, corners = cv2.findChessboardCorners(
            image, (9, 6), flags=cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_FAST_CHECK
        )
        if found:
            corners = cv2.cornerSubPix(image, corners, (5, 5), (-1, -1), (3, 40, 1e-3))
            views.append(corners.reshape(-1, 2))
    camera = estimate_intrinsics(points, np.array(views, dtype=float), (640, 480), "fisheye4")
    assert len(views) >= 6
    assert camera.rms_px < 0.3  # measured 0.12 over 20 views, at OpenCV's refined 0.136
    assert 320 < camera.parameters[0] < 350


def test_a_lens_whose_residuals_are_not_finite_is_left_at_the_prior() -> None:
    # coordinates whose squares overflow: no candidate has a finite cost
    column, row = np.meshgrid(np.arange(6.0), np.arange(5.0))
    points = np.c_[column.ravel(), row.ravel(), np.zeros(30)]
    u, v = (np.tile(1e160 * axis.ravel(), (4, 1)) for axis in (column, row))
    with np.errstate(all="ignore"):
        lifting = estimate_lifting(PlaneFrame.of(points), u, v, np.ones(u.shape), (640, 480), 1.0)
    assert np.array_equal(lifting.centre_px, [319.5, 239.5])
    assert np.allclose(lifting.sigma_centre, 0.3)  # the prior's
