from __future__ import annotations

import numpy as np
import pytest

from binocal.errors import DegenerateGeometryError, TooFewViewsError
from binocal.geometry import so3
from binocal.initialization.vanishing_points import check_orientations, estimate_pinhole, solve_conic

K_TRUE = np.array([[2.0, 0.0, 0.03], [0, 2.1, -0.02], [0, 0, 1]])
WIDE = np.array([0.15, 0.15])


def _columns(tilts_rad: np.ndarray, K: np.ndarray = K_TRUE) -> np.ndarray:
    return (K @ so3.exp(np.asarray(tilts_rad)))[..., :2]


def _covariance(n: int, sigma: float = 1e-4) -> np.ndarray:
    return np.broadcast_to(sigma**2 * np.eye(6), (n, 6, 6))


TILTS = np.array([[0.5, 0.1, 0.2], [-0.3, 0.4, -0.1], [0.1, -0.5, 0.3], [0.4, 0.4, 0]])


def test_three_views_determine_five_parameters() -> None:
    K = K_TRUE.copy()
    K[0, 1] = 0.02
    found, singular = solve_conic(_columns(TILTS[:3], K), np.ones(3), 5)
    np.testing.assert_allclose(found, K, rtol=1e-6, atol=1e-6)
    assert singular[0] < 1e-6 < singular[1]


def test_two_views_determine_four() -> None:
    found, _ = solve_conic(_columns(TILTS[:2]), np.ones(2), 4)
    np.testing.assert_allclose(found, K_TRUE, rtol=1e-6, atol=1e-6)


def test_one_view_determines_the_focal_length_of_a_centred_camera() -> None:
    K = np.diag([1.7, 1.7, 1.0])
    found, _ = solve_conic(_columns(TILTS[:1], K), np.ones(1), 1)
    np.testing.assert_allclose(found, K, rtol=1e-6)


def test_polish_keeps_the_exact_answer_whatever_the_priors_say() -> None:
    result = estimate_pinhole(_columns(TILTS), _covariance(4, 1e-7), sigma_centre=WIDE)
    np.testing.assert_allclose(result.K, K_TRUE, atol=1e-4)
    assert result.freedom == 4 and not result.notes


def test_non_square_pixels_are_found() -> None:
    K = np.array([[1.2, 0, 0.01], [0, 1.42, 0.0], [0, 0, 1]])
    result = estimate_pinhole(_columns(TILTS, K), _covariance(4, 1e-6), sigma_centre=WIDE)
    assert result.K[0, 0] / result.K[1, 1] == pytest.approx(1.2 / 1.42, rel=1e-3)


def test_bad_views_are_outvoted() -> None:
    rng = np.random.default_rng(0)
    columns = _columns(rng.uniform(-0.6, 0.6, (20, 3)))
    columns += rng.normal(0, 1e-4, columns.shape)
    columns[:3] += rng.normal(0, 0.2, (3, 3, 2))
    result = estimate_pinhole(columns, _covariance(20), sigma_centre=WIDE)
    assert abs(result.K[0, 0] / 2 - 1) < 0.01  # measured 0.001
    assert result.weights[:3].max() < 0.3 < result.weights[3:].min()


def test_stated_focal_sigma_is_the_scatter() -> None:
    rng = np.random.default_rng(1)
    columns = _columns(rng.uniform(-0.6, 0.6, (12, 3)))
    runs = [
        estimate_pinhole(columns + rng.normal(0, 1e-3, columns.shape), _covariance(12, 1e-3), sigma_centre=WIDE)
        for _ in range(60)
    ]
    scatter = np.std([np.log(r.K[0, 0]) for r in runs])
    assert 0.6 < scatter / np.median([r.sigma_log_focal for r in runs]) < 1.6  # measured 1.0


def test_no_view_is_refused() -> None:
    with pytest.raises(TooFewViewsError):
        estimate_pinhole(np.zeros((0, 3, 2)), np.zeros((0, 6, 6)), sigma_centre=WIDE)


@pytest.mark.parametrize(
    ("tilt", "words"), [((0, 0), "parallel to the image plane"), ((0.4, 0.2), "parallel to each other")]
)
def test_parallel_boards_are_named(tilt: tuple[float, float], words: str) -> None:
    rng = np.random.default_rng(0)
    rolls = np.stack([so3.exp(np.array([0, 0, roll])) for roll in rng.uniform(-1, 1, 20)])
    columns = (K_TRUE @ (so3.exp(np.array([*tilt, 0.0])) @ rolls))[..., :2]
    columns += rng.normal(0, 1e-3, columns.shape)
    with pytest.raises(DegenerateGeometryError, match=words):
        check_orientations(K_TRUE, columns, _covariance(20, 1e-3), "left")


def test_varied_boards_pass() -> None:
    columns = _columns(TILTS)
    check_orientations(K_TRUE, columns, _covariance(4, 1e-3), "left")
    slopes_only_noise = _columns(np.zeros((4, 3)))
    with pytest.raises(DegenerateGeometryError):
        check_orientations(K_TRUE, slopes_only_noise, _covariance(4, 1e-3), "left")
