"""The compiled corner fit against a plain statement of the same model, and its guards."""

import cv2
import numpy as np
import plain_corner_fit as plain
import pytest

from binocal.kernels.corner_fits import fit_corners, range_of


def make_corner(
    opening_rad=1.4, turn_rad=0.3, blur_px=1.1, tone=0.0, noise_dn=2.0, seed=0, at=(20.3, 19.6), levels=(110, 80)
):
    v, u = np.mgrid[:41, :41].astype(float)
    p = [*at, turn_rad, turn_rad + opening_rad + np.pi, *np.log([blur_px, blur_px]), *levels, 5e-4, -3e-4, tone]
    exact = plain.grey_values(p, u, v)
    return (exact + noise_dn * np.random.default_rng(seed).standard_normal(exact.shape)).astype(np.float32), np.array(p)


def make_clipped_corner(over, *, black_dn=40.0, **corner):
    """Paper at ``over`` times the range of 8 bits."""
    white_dn = over * 255.0
    image, p = make_corner(levels=((white_dn + black_dn) / 2, (white_dn - black_dn) / 2), **corner)
    return np.rint(np.clip(image, 0, 255)).astype(np.uint8), p


def fit_one(image, start=(20.0, 20.0), reach=16.0, strip=np.inf):
    return fit_corners(image, np.array([start]), np.array([reach]), np.array([strip]))


def edges_as_started(fit):
    """The plain parameters at the kernel's estimate; level and tone are left to be found."""
    (a1, a2), (b1, b2) = fit.edges_rad[0], np.log(fit.blur_px[0])
    return [*fit.points_px[0], a1, a2, b1, b2, 110, fit.contrast_dn[0] / 2, *fit.light_slope[0], 0]


@pytest.mark.parametrize("opening_rad", [0.6, 1.0, 1.57, 2.3])
def test_the_estimate_is_the_plain_models_minimum(opening_rad):
    image, _ = make_corner(opening_rad)
    fit = fit_one(image)
    assert np.isfinite(fit.points_px).all()
    p, inverse = plain.refit(image, edges_as_started(fit), fit.radius_px[0])
    # measured 2e-5 to 2e-4 px; the estimate's own sigma is 0.006
    assert np.abs(p[:2] - fit.points_px[0]).max() < 6e-4
    assert np.allclose(inverse, fit.joint_covariance[0, :2, :2], rtol=0.03, atol=0.02 * inverse.max())


@pytest.mark.parametrize("opening_rad", [0.5, 1.57, 2.5])
@pytest.mark.parametrize("tone", [0.0, 0.2])
def test_an_exact_corner_comes_back_from_two_pixels_away(opening_rad, tone):
    image, p = make_corner(opening_rad, tone=tone, noise_dn=0.0)
    fit = fit_one(image, start=(21.8, 18.4))
    assert np.abs(fit.points_px[0] - p[:2]).max() < 2e-4  # measured 2e-5
    assert np.abs(fit.blur_px - 1.1).max() < 2e-3 and fit.contrast_dn[0] == pytest.approx(160, rel=2e-3)
    assert np.abs(fit.light_slope[0] - p[8:10]).max() < 1e-5


@pytest.mark.parametrize("blur_px", [0.6, 1.1, 2.5])
def test_errors_are_as_the_information_matrix_says(blur_px):
    scores = []
    for seed in range(200):
        image, p = make_corner(1.2, blur_px=blur_px, noise_dn=3.0, seed=seed)
        fit = fit_one(image)
        error = fit.points_px[0] - p[:2]
        scores.append(error @ np.linalg.solve(9 * fit.joint_covariance[0, :2, :2], error))
    assert np.mean(scores) == pytest.approx(2, abs=0.42)  # chi-square with 2 degrees: 3 sigma of the mean of 200


@pytest.mark.parametrize("over", [1.0, 1.5, 2.5])
@pytest.mark.parametrize("opening_rad", [1.0, 1.57])
def test_the_estimate_of_a_clipped_corner_is_the_plain_models_minimum(over, opening_rad):
    image, truth = make_clipped_corner(over, opening_rad=opening_rad)
    fit = fit_one(image)
    p, inverse = plain.refit(image, truth, fit.radius_px[0], clipping=(np.hypot(2, 0.29), 0.0, 255.0), tone_spread=0.02)
    # measured 4e-6 to 3e-4 px; the estimate's own sigma is 0.005
    assert np.abs(p[:2] - fit.points_px[0]).max() < 6e-4
    assert np.allclose(inverse, fit.joint_covariance[0, :2, :2], rtol=0.06, atol=0.03 * inverse.max())
    assert fit.contrast_dn[0] == pytest.approx(2 * p[7], rel=0.01)
    assert 0.1 < fit.clipped_share[0] < 0.6


@pytest.mark.parametrize("over", [1.0, 1.4, 2.0, 3.0])
@pytest.mark.parametrize("blur_px", [0.7, 1.2])
def test_errors_of_clipped_corners_are_as_stated(over, blur_px):
    """And the noise is that of the pixels where it is not clipped."""
    scores, odd = [], []
    for seed in range(200):
        image, p = make_clipped_corner(over, opening_rad=1.2, blur_px=blur_px, noise_dn=3.0, seed=seed)
        fit = fit_one(image)
        error = fit.points_px[0] - p[:2]
        scores.append(error @ np.linalg.solve(9.08 * fit.joint_covariance[0, :2, :2], error))
        odd.append(fit.odd_variance[0])
    assert np.mean(scores) == pytest.approx(2, abs=0.42)  # measured 1.79 to 2.10
    assert np.mean(odd) == pytest.approx(9.08, rel=0.02)


def test_ink_that_is_clipped_is_fitted_like_paper():
    image, p = make_corner(levels=(60, 110), noise_dn=2.0)  # ink at -50
    dark = np.rint(np.clip(image, 0, 255)).astype(np.uint8)
    fits = [fit_one(dark), fit_one(dark.astype(np.uint16) * 200)]  # the second's top is not known
    for fit in fits:
        assert np.abs(fit.points_px[0] - p[:2]).max() < 0.012  # 3 sigma
        assert np.abs(fit.points_px[0] - fits[0].points_px[0]).max() < 5e-4
        assert 0.4 < fit.clipped_share[0] < 0.7


def test_sharpened_paper_beside_crushed_black_is_fitted_with_the_least_blur():
    """Edges sharper than the least blur: a step that counts on less never ended."""
    image, p = make_corner(blur_px=0.5, levels=(45, 75), noise_dn=1.5)
    sharp = image + 2 * (image - cv2.GaussianBlur(image, (0, 0), 1.0))
    for strip in (np.inf, 4.0):
        fit = fit_one(np.rint(np.clip(sharp - 10, 0, 255)).astype(np.uint8), strip=strip)
        assert np.abs(fit.points_px[0] - p[:2]).max() < 0.02  # measured 0.007
        assert fit.blur_px[0].min() == pytest.approx(0.25, abs=1e-3) and fit.n_evaluations[0] < 20


def test_the_top_of_sixteen_bits_is_where_many_pixels_are():
    image, _ = make_clipped_corner(1.6)
    of_12_bits = np.minimum(image.astype(np.uint16) * 16, 4031)  # black level taken off
    fits = [fit_one(image), fit_one(of_12_bits)]
    assert range_of(image) == (0, 255) and range_of(of_12_bits) == (0, 4031)
    assert np.abs(fits[0].points_px - fits[1].points_px).max() < 2e-3
    ramp = np.arange(200 * 200, dtype=np.uint16).reshape(200, 200)
    assert range_of(ramp)[1] == np.inf and range_of(image.astype(np.float32)) == (-np.inf, np.inf)
    assert range_of(np.zeros((0, 0), np.uint16)) == (-np.inf, np.inf)


def test_odd_residuals_are_the_noise_whatever_the_blurs_shape():
    v, u = np.mgrid[:41, :41].astype(float)
    square = np.clip(u - 20.2, -1.5, 1.5) * np.clip(v - 19.7, -1.5, 1.5) / 1.5**2  # a box of 3 px is no Gaussian
    image = (110 + 80 * square + 2 * np.random.default_rng(0).standard_normal(u.shape)).astype(np.float32)
    fit = fit_one(image)
    assert np.abs(fit.points_px[0] - [20.2, 19.7]).max() < 0.02
    assert 3 < fit.odd_variance[0] < 8 < 1.5 * fit.odd_variance[0] < fit.variance[0]  # measured 6.3 of


def test_eight_and_sixteen_bits_agree():
    image, _ = make_corner(noise_dn=0.0)
    fits = [fit_one(np.rint(image * scale).astype(kind)) for scale, kind in ((1, np.uint8), (257, np.uint16))]
    assert np.abs(fits[0].points_px - fits[1].points_px).max() < 3e-3  # rounding to 8 bits is noise of 0.29
    assert fits[1].contrast_dn[0] == pytest.approx(257 * fits[0].contrast_dn[0], rel=1e-3)


def test_bands_leave_out_what_is_printed_inside_the_squares():
    image, p = make_corner(1.57, 0.0, noise_dn=1.0)
    marked = image.copy()
    marked[27:, 28:] = 20.0
    marked[27:, :13] = 240.0
    error = np.abs(fit_one(marked, strip=6.5).points_px[0] - p[:2]).max()
    assert error < 0.012  # measured 0.004; without bands 0.05
    assert not np.abs(fit_one(marked).points_px[0] - p[:2]).max() < 0.012


def test_no_corner_is_no_number():
    flat = np.full((41, 41), 100, np.uint8)
    edge = np.repeat(np.where(np.arange(41) > 20, 200, 50)[None], 41, axis=0).astype(np.uint8)
    noise = np.random.default_rng(0).integers(0, 255, (41, 41)).astype(np.uint8)
    for image in (flat, edge, noise):
        assert np.isnan(fit_one(image).points_px).all() and np.isnan(fit_one(image).joint_covariance).all()
    image, _ = make_corner()
    for start in ((1.0, 20.0), (np.nan, np.nan), (500.0, 20.0), (-3.0, 20.0), (np.inf, 0.0)):
        assert np.isnan(fit_one(image, start=start).points_px).all()
    assert (
        np.isnan(fit_one(image, reach=np.nan).points_px).all() and np.isnan(fit_one(image, reach=-1.0).points_px).all()
    )
    assert fit_corners(image, np.zeros((0, 2)), np.zeros(0), np.zeros(0)).points_px.shape == (0, 2)


def test_a_image_of_another_type_is_the_callers_mistake():
    with pytest.raises(ValueError, match="float64"):
        fit_one(np.zeros((41, 41)))
    with pytest.raises(ValueError, match="uint8"):
        fit_one(np.zeros((41, 41, 3), np.uint8))


def test_images_that_are_not_contiguous_are_read_alike():
    image, _ = make_corner()
    wide = np.repeat(image, 2, axis=1)
    assert np.array_equal(fit_one(wide[:, ::2]).points_px, fit_one(image).points_px)
