"""The compiled square fit against a plain statement of the same model, and its guards."""

import numpy as np
import plain_square_fit as plain
import pytest

from binocal.kernels.square_fits import SquareFits, fit_squares

UPRIGHT = np.array([[18.2, 17.4], [42.7, 18.1], [41.9, 43.3], [17.6, 41.8]])
SLANTED = np.array([[14.3, 24.2], [38.6, 16.9], [47.2, 33.4], [22.9, 44.8]])  # corners of 57 to 125 degrees
BOWS = np.array([[2.0, -0.4, 0.3], [-1.2, 0.2, 0.0], [0.8, 0.5, -0.2], [1.5, 0.0, 0.0]])


def make_square(corners=UPRIGHT, blur_px=1.1, noise_dn=2.0, seed=0, levels=(120, -80), slope=(1e-3, -2e-3), bows=None):
    v, u = np.mgrid[:60, :60].astype(float)
    p = np.array([*np.ravel(corners), np.log(blur_px), np.log(blur_px), *levels, *slope])
    exact = plain.grey_values(p, u, v, bows)
    return (exact + noise_dn * np.random.default_rng(seed).standard_normal(exact.shape)).astype(np.float32), p


def fit_one(image, start=UPRIGHT, bows=None, outward=np.inf, reach=6.0) -> SquareFits:
    bows = np.zeros((1, 4, 3)) if bows is None else bows[None]
    return fit_squares(image, np.array([start]), bows, np.full((1, 4), outward), np.array([reach]))


def as_fitted(fit: SquareFits) -> np.ndarray:
    """The corners before light is taken to fall ahead of the blur."""
    blur = fit.corners.blur_px[0].prod()
    return fit.corners_px[0] - blur * fit.corners.light_slope[0]


@pytest.mark.parametrize("corners", [UPRIGHT, SLANTED], ids=["upright", "slanted"])
@pytest.mark.parametrize("bows", [None, BOWS], ids=["straight", "bent"])
def test_an_exact_square_comes_back_from_a_pixel_away(corners, bows):
    image, _ = make_square(corners, noise_dn=0.0, bows=bows)
    fit = fit_one(image, corners + [[1.0, -0.8], [-0.7, 0.9], [1.2, 0.5], [-0.4, -1.0]], bows)
    assert np.abs(as_fitted(fit) - corners).max() < 1e-3  # measured 1e-4 to 6e-4
    assert fit.corners.blur_px[0] == pytest.approx([1.1, 1.1], rel=3e-3)
    assert fit.corners.contrast_dn[0] == pytest.approx(-155.2, rel=2e-3)  # 160 in the light of the image's corner


def test_the_estimate_is_the_plain_models_minimum():
    image, p = make_square(SLANTED)
    fit = fit_one(image, SLANTED + 0.7)
    found, inverse = plain.refit(image, [*as_fitted(fit).ravel(), *p[8:]], 5.6)
    assert np.abs(found[:8] - as_fitted(fit).ravel()).max() < 2e-3  # the estimate's own sigma is 0.02
    C = fit.corners.joint_covariance[:, :2, :2]
    for corner in range(4):
        mine = inverse[2 * corner : 2 * corner + 2, 2 * corner : 2 * corner + 2]
        assert np.allclose(C[corner], mine, rtol=0.08, atol=0.06 * mine.max())


@pytest.mark.parametrize("blur_px", [0.6, 1.1, 2.5])
def test_errors_are_as_the_information_matrix_says(blur_px):
    exact, p = make_square(SLANTED, blur_px, noise_dn=0.0)
    scores, errors = [], []
    for seed in range(150):
        noise = np.random.default_rng(seed).standard_normal(exact.shape).astype(np.float32)
        fit = fit_one(exact + 3 * noise, SLANTED + 0.5)
        error = fit.corners_px[0] - blur_px**2 * p[12:] - SLANTED
        C = 9 * fit.corners.joint_covariance[:, :2, :2]
        scores.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(C), error).mean())
        errors.append(error)
    assert np.mean(scores) == pytest.approx(2, abs=0.35)  # chi-square with 2 degrees of freedom
    bias = np.mean(errors, axis=0) / (np.std(errors, axis=0) / np.sqrt(150))
    assert np.abs(bias).max() < 4  # of eight numbers, in standard errors


def test_clipped_paper_does_not_pull_the_corners():
    image, _ = make_square(levels=(180, -120), slope=(6e-3, 0), noise_dn=1.0)
    fit = fit_one(np.rint(np.clip(image, 0, 255)).astype(np.uint8))
    assert 0.2 < fit.corners.clipped_share[0] < 0.9
    assert np.abs(as_fitted(fit) - UPRIGHT).max() < 0.08


@pytest.mark.parametrize(
    "given",
    [
        dict(start=np.full((4, 2), np.nan)),
        dict(start=UPRIGHT[::-1]),
        dict(start=UPRIGHT[[0, 2, 1, 3]]),
        dict(start=UPRIGHT - 17),
        dict(start=UPRIGHT + 4, reach=2.0),
        dict(start=UPRIGHT[0] + np.array([[0, 0], [3, 0], [3, 3], [0, 3.0]])),
    ],
    ids=["nothing", "counter-clockwise", "crossed", "outside", "too far", "too small"],
)
def test_what_shows_no_square_is_none(given):
    image, _ = make_square()
    assert np.isnan(fit_one(image, **given).corners_px).all()


def test_plain_images_and_wrong_ones():
    assert np.isnan(fit_one(np.full((60, 60), 90, np.uint8)).corners_px).all()
    nothing = fit_squares(
        np.zeros((9, 9), np.uint8), np.zeros((0, 4, 2)), np.zeros((0, 4, 3)), np.zeros((0, 4)), np.zeros(0)
    )
    assert len(nothing.corners_px) == 0
    with pytest.raises(ValueError, match="float32"):
        fit_one(np.zeros((60, 60)))
