"""The compiled ellipse fit against a plain statement of the same model, and its guards."""

import numpy as np
import plain_ellipse_fit as plain
import pytest
from scipy import optimize

from binocal.kernels.corner_fits import CORNER_FIT, CornerFits, pool_corners
from binocal.kernels.ellipse_fits import fit_ellipses


def make_spot(
    axes=(14.0, 9.0),
    angle=0.5,
    blur_px=1.1,
    noise_dn=2.0,
    seed=0,
    at=(30.3, 29.6),
    levels=(110, 80),
    slope=(1e-3, -2e-3),
):
    v, u = np.mgrid[:60, :60].astype(float)
    M = plain.shape_of(axes, angle)
    p = np.array([*at, M[0, 0], M[0, 1], M[1, 1], np.log(blur_px), *levels, *slope])
    exact = plain.grey_values(p, u, v)
    return (exact + noise_dn * np.random.default_rng(seed).standard_normal(exact.shape)).astype(np.float32), p


def fit_one(image, start=(30.0, 30.0), axes=(13.0, 9.5), angle=0.4, outward=np.inf, inward=np.inf):
    return fit_ellipses(
        image, np.array([start]), np.array([axes]), np.array([angle]), np.array([outward]), np.array([inward])
    )


def as_fitted(fit):
    """The plain parameters at the kernel's estimate, before light is taken to fall ahead of the blur; levels are left to be found."""
    blur, slope = fit.centres.blur_px[0, 0], fit.centres.light_slope[0]
    at = fit.centres.points_px[0] - blur**2 * slope
    # As they look: blur moves a curved edge inward, to first order, by what the fit has given back.
    seen = optimize.fsolve(lambda axes: axes + blur**2 * axes / (2 * axes[::-1] ** 2) - fit.axes_px[0], fit.axes_px[0])
    M = plain.shape_of(seen, fit.angles_rad[0])
    return [*at, M[0, 0], M[0, 1], M[1, 1], np.log(blur), 110, 80, *slope]


@pytest.mark.parametrize("axes", [(14.0, 9.0), (6.0, 4.0), (20.0, 20.0)])
def test_the_estimate_is_the_plain_models_minimum(axes):
    image, _ = make_spot(axes)
    fit = fit_one(image, axes=np.array(axes) * 1.05)
    assert np.isfinite(fit.centres.points_px).all()
    at = as_fitted(fit)
    p, inverse = plain.refit(image, at, 5.6)
    assert np.abs(p[:2] - at[:2]).max() < 1e-3  # measured 5e-5 to 5e-4 px; the estimate's own sigma is 0.006 to 0.011
    assert np.allclose(inverse, fit.centres.joint_covariance[0, :2, :2], rtol=0.08, atol=0.04 * inverse.max())


def test_an_exact_spot_comes_back_from_two_pixels_away():
    image, p = make_spot(noise_dn=0.0)
    fit = fit_one(image, start=(31.5, 28.2))
    assert np.abs(as_fitted(fit)[:2] - p[:2]).max() < 2e-4
    assert (
        np.abs(fit.axes_px - [14 + 1.21 * 7 / 81, 9 + 1.21 * 4.5 / 196]).max() < 1e-3
        and np.abs(fit.angles_rad - 0.5) < 1e-4
    )
    assert fit.centres.blur_px[0, 0] == pytest.approx(1.1, rel=1e-3)
    assert fit.centres.contrast_dn[0] == pytest.approx(160, rel=1e-3)


def test_light_that_falls_before_the_blur_moves_no_centre():
    import cv2

    v, u = np.mgrid[:960, :960] / 16 + 1 / 32 - 0.5  # sixteen samples a pixel and axis
    outside = ((u - 30.3) ** 2 + (v - 29.6) ** 2 > 12**2).astype(np.float32)
    light = (1 + 0.01 * (u - 30)).astype(np.float32)
    exact = cv2.GaussianBlur((40 + 160 * outside) * light, (0, 0), 32.0).reshape(60, 16, 60, 16).mean(axis=(1, 3))
    fit = fit_one(exact.astype(np.float32), axes=(12.0, 12.0), angle=0.0)
    # measured 0.0006 px; 4 px^2 times the slope, 0.04 px, if light fell behind the blur
    assert np.abs(fit.centres.points_px[0] - [30.3, 29.6]).max() < 2e-3
    assert np.abs(fit.axes_px - 12).max() < 0.01  # measured 0.005; a blurred disc of that radius seems 0.17 px smaller


@pytest.mark.parametrize("blur_px", [0.6, 1.1, 2.5])
def test_errors_are_as_the_information_matrix_says(blur_px):
    scores = []
    for seed in range(200):
        image, p = make_spot(blur_px=blur_px, noise_dn=3.0, seed=seed)
        fit = fit_one(image)
        error = fit.centres.points_px[0] - blur_px**2 * p[8:] - p[:2]
        scores.append(error @ np.linalg.solve(9 * fit.centres.joint_covariance[0, :2, :2], error))
    assert np.mean(scores) == pytest.approx(2, abs=0.42)  # chi-square with 2 degrees: 3 sigma of the mean of 200


def test_clipped_paper_does_not_pull_the_centre():
    image, p = make_spot(levels=(160, 120), slope=(8e-3, 0), noise_dn=1.0)
    clipped = np.rint(np.clip(image, 0, 255)).astype(np.uint8)
    fit = fit_one(clipped)
    assert 0.2 < fit.centres.clipped_share[0] < 0.8
    assert np.abs(fit.centres.points_px[0] - fit.centres.blur_px[0, 0] ** 2 * p[8:] - p[:2]).max() < 0.05


@pytest.mark.parametrize(("smoothing_px", "least", "most"), [(0.0, 0.8, 1.2), (0.8, 4.0, 9.0)])
def test_noise_that_is_alike_in_neighbouring_pixels_is_seen(smoothing_px, least, most):
    import cv2

    ratios = []
    for seed in range(150):
        image, _ = make_spot((14.0, 14.0), noise_dn=0.0)
        noise = 3 * np.random.default_rng(seed).standard_normal(image.shape).astype(np.float32)
        noise = cv2.GaussianBlur(noise, (0, 0), smoothing_px) if smoothing_px else noise
        fit = fit_one(image + noise, axes=(14.0, 14.0), angle=0.0)
        ratios.append(fit.centres.long_variance[0] / fit.centres.variance[0])
    # Measured 1.01 and 6.24; a smoothing of 0.8 px leaves an eighth of the variance, and all of it on large scales.
    assert least < np.mean(ratios) < most


def test_spots_on_clipped_paper_keep_their_own_slope_of_the_light():
    records = np.zeros(20, CORNER_FIT)
    records["point_px"] = 40.0 * np.stack(np.meshgrid(np.arange(5), np.arange(4)), axis=-1).reshape(-1, 2)
    records["light_slope"] = [1e-3, 0]
    # x, y, and the slopes, the first of which goes with x
    records["covariance"] = [1e-4, 0, 1e-6, 0, 1e-4, 0, 0, 1e-7, 0, 1e-7]
    records["odd_variance"], records["half_contrast_dn"], records["n_pixels"] = 1.0, 80.0, 900.0
    records["long_variance"] = np.nan
    records["light_slope"][7:9] = [2e-3, 0]  # no one's but their own
    records["clipped_share"][8] = 0.3
    moved = pool_corners(CornerFits(records), are_corners=False).points_px - records["point_px"]
    assert abs(moved[7, 0]) > 1e-3 and moved[8, 0] == 0


@pytest.mark.parametrize(
    "start",
    [dict(start=(np.nan, 0)), dict(start=(5, 30)), dict(axes=(0.5, 0.5)), dict(axes=(40, 40)), dict(start=(44, 30))],
)
def test_what_shows_no_ellipse_is_none(start):
    image, _ = make_spot()
    assert np.isnan(fit_one(image, **start).centres.points_px).all()


def test_plain_images_and_wrong_ones():
    assert np.isnan(fit_one(np.full((60, 60), 90, np.uint8)).centres.points_px).all()
    assert (
        len(fit_ellipses(np.zeros((9, 9), np.uint8), np.zeros((0, 2)), np.zeros((0, 2)), *3 * [np.zeros(0)]).axes_px)
        == 0
    )
    with pytest.raises(ValueError, match="float32"):
        fit_one(np.zeros((60, 60)))
