"""Intrinsics from vanishing points of board views (the paper's section 3.2.1, eqs 7-12).

The two edge directions of a board have the vanishing points g = h1, h = h2, the first two columns of its homography,
its two diagonals h1 + h2 and h1 - h2. Each pair belongs to orthogonal directions, so with the image of the absolute
conic ω = K⁻ᵀ K⁻¹ (eqs 9, 10):

    h1ᵀ ω h2 = 0,    (h1 + h2)ᵀ ω (h1 - h2) = h1ᵀ ω h1 - h2ᵀ ω h2 = 0.

Three views determine five linear parameters, two determine four (no skew), one the focal length with a centred
principal point. The linear solution is then polished by weighting both constraints of a view by their covariance,
with a robust weight per view.

Coordinates here are pixels relative to the assumed centre, divided by half the image's diagonal (``unit``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.errors import TooFewViewsError
from binocal.findings import finding, refusal
from binocal.shapes import Float

FOCAL_RANGE = (0.08, 60.0)  # in half diagonals: 170° of a fisheye to a 2° telephoto lens
MAX_VIEWS = 40  # a start needs no more, evenly chosen; the joint solver sees every view
_CENTRE_LIMIT = 0.6  # a principal point farther out than 60 % of the half diagonal is a failed estimate, not a lens


@dataclass(frozen=True, slots=True, eq=False)
class VanishingEstimate:
    """Pinhole matrix in unit coordinates, and how far it can be trusted.

    ``freedom`` counts the linear parameters that the closed form could determine: 5, 4, 3 (centred), 1 (centred, fx =
    fy). ``residuals`` are both constraints of each view in standard deviations, ``weights`` the views' robust
    weights, ``singular_values`` those of the linear system, ascending, relative to the largest; ``sigma_log_focal``
    the relative standard deviation of the focal length, from views whose tilt is significant; ``sigma_centre`` that
    of the principal point in half diagonals.
    """

    K: Float[ndarray, "3 3"]
    freedom: int
    residuals: Float[ndarray, "views 2"]
    weights: Float[ndarray, "views"]
    singular_values: Float[ndarray, "k"]
    sigma_log_focal: float
    sigma_centre: Float[ndarray, "2"]
    notes: tuple[str, ...] = ()


def conic_rows(h1: Float[ndarray, "*batch 3"], h2: Float[ndarray, "*batch 3"]) -> Float[ndarray, "*batch 6"]:
    """Coefficients of ``h1ᵀ ω h2`` in ω = (ω11, ω12, ω22, ω13, ω23, ω33)."""
    a, b = h1, h2
    return np.stack(
        [
            a[..., 0] * b[..., 0], a[..., 0] * b[..., 1] + a[..., 1] * b[..., 0], a[..., 1] * b[..., 1],
            a[..., 0] * b[..., 2] + a[..., 2] * b[..., 0], a[..., 1] * b[..., 2] + a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 2],
        ],
        axis=-1,
    )  # fmt: skip


def solve_conic(
    columns: Float[ndarray, "views 3 2"], weights: Float[ndarray, "views"], freedom: int
) -> tuple[Float[ndarray, "3 3"] | None, Float[ndarray, "k"]]:
    """K of the vanishing-point constraints, or None where ω is not positive definite; and the system's singular values.

    ``freedom``: 5 all of K; 4 no skew; 3 no skew and a centred principal point; 1 fx = fy too.
    The focal length of ``freedom`` 3 and 1 follows from ω = diag(1/fx², 1/fy², 1). Source: eqs 9,
    10; Zhang 2000, appendix B.
    """
    h1, h2 = columns[..., 0], columns[..., 1]
    size = np.sqrt(np.sum(h1 * h1, axis=-1) + np.sum(h2 * h2, axis=-1))
    h1, h2 = h1 / size[:, None], h2 / size[:, None]
    rows = (
        np.concatenate([conic_rows(h1, h2), (conic_rows(h1, h1) - conic_rows(h2, h2)) / 2])
        * np.r_[weights, weights][:, None]
    )
    if freedom == 5:
        system = rows
    elif freedom == 4:
        system = rows[:, [0, 2, 3, 4, 5]]
    elif freedom == 3:
        system = rows[:, [0, 2, 5]]
    else:
        system = np.stack([rows[:, 0] + rows[:, 2], rows[:, 5]], axis=-1)
    values, vectors = np.linalg.eigh(system.T @ system)  # squares the condition number; the polish makes up for it
    singular = np.sqrt(np.maximum(values, 0.0))
    b = vectors[:, 0]
    omega = np.zeros(6)
    if freedom == 5:
        omega[:] = b
    elif freedom == 4:
        omega[[0, 2, 3, 4, 5]] = b
    elif freedom == 3:
        omega[[0, 2, 5]] = b
    else:
        omega[[0, 2, 5]] = b[0], b[0], b[1]
    return _pinhole_of_conic(omega), singular / max(float(singular[-1]), 1e-300)


def _pinhole_of_conic(omega: Float[ndarray, "6"]) -> Float[ndarray, "3 3"] | None:
    """K with K33 = 1 from ω = K⁻ᵀ K⁻¹ up to scale, by Cholesky; None where ω is indefinite or K implausible."""
    W = omega[np.array([[0, 1, 3], [1, 2, 4], [3, 4, 5]])]
    try:
        lower = np.linalg.cholesky(W if np.trace(W) > 0 else -W)
    except np.linalg.LinAlgError:
        return None
    K = np.linalg.inv(lower.T)
    K = K / K[2, 2]
    is_plausible = (
        FOCAL_RANGE[0] < K[0, 0] < FOCAL_RANGE[1] and FOCAL_RANGE[0] < K[1, 1] < FOCAL_RANGE[1]
        and 0.5 < K[0, 0] / K[1, 1] < 2.0 and np.all(np.abs(K[:2, 2]) < _CENTRE_LIMIT)
    )  # fmt: skip
    return K if is_plausible else None


def estimate_pinhole(
    columns: Float[ndarray, "views 3 2"],
    covariance: Float[ndarray, "views 6 6"],
    *,
    sigma_centre: Float[ndarray, "2"],
    has_skew: bool = False,
    log_focal: tuple[float, float] | None = None,
) -> VanishingEstimate:
    """K from the first two columns of the homographies and their covariance, order (h11, h21, h31, h12, h22, h32).

    The closed form is tried with as many parameters as the views can carry and falls back, loudly (``notes``), to
    fewer. The polish minimises the squared constraints in standard deviations under weak priors: principal point
    within ``sigma_centre`` of the origin, fx / fy within 20 % of 1, and ``log_focal`` (value, sigma) where another
    camera vouches for it; where the views speak, the priors are silent. One weight per view (Cauchy) tames bad views.

    Raises:
        TooFewViewsError: No view at all.
    """
    n_views = len(columns)
    if n_views == 0:
        raise TooFewViewsError(0, 1)
    if n_views > MAX_VIEWS:
        chosen = np.linspace(0, n_views - 1, MAX_VIEWS).round().astype(int)
        columns, covariance, n_views = columns[chosen], covariance[chosen], MAX_VIEWS
    ladder = [f for f, least in ((5, 3), (4, 2), (3, 1), (1, 1)) if n_views >= least and (has_skew or f != 5)]
    if n_views == 1:
        ladder = [1]
    weights = np.ones(n_views)
    notes: list[str] = []
    K, freedom, singular = None, 0, np.zeros(1)
    for freedom in ladder:
        K, singular = solve_conic(columns, weights, freedom)
        if K is not None and freedom >= 4 and n_views >= 3:
            for _ in range(2):  # a bad view bends the unweighted solution: reweight before polishing
                residuals, _ = _whitened(_pack(K), columns, covariance)
                weights = _view_weights(residuals)
                better, singular = solve_conic(columns, weights, freedom)
                K = K if better is None else better
        if K is not None:
            break
    if K is None:
        K = _scan_focal(columns, covariance)
        freedom = 1
    if freedom < ladder[0]:
        notes.append(
            "the closed form gave no plausible principal point; it was started at the centre"
            + (" with fx = fy" if freedom == 1 else "")
        )
    best = _polish(_pack(K), columns, covariance, sigma_centre, has_skew, log_focal)
    if best[0] > 20 * n_views:  # a typical view misses its constraints by 7 sigma: try another valley
        other = _polish(_pack(_scan_focal(columns, covariance)), columns, covariance, sigma_centre, has_skew, log_focal)
        best = min(best, other, key=lambda result: result[0])
    _, theta, residuals, weights, information = best
    sigma_log_focal, centre = _uncertainty(theta, columns, covariance, information, n_views)
    return VanishingEstimate(
        _unpack(theta), freedom, residuals, weights, singular, sigma_log_focal, centre, tuple(notes)
    )


def _pack(K: Float[ndarray, "3 3"]) -> Float[ndarray, "5"]:
    return np.array([np.log(K[0, 0]), np.log(K[1, 1] / K[0, 0]), K[0, 2], K[1, 2], K[0, 1] / K[0, 0]])


def _unpack(theta: Float[ndarray, "5"]) -> Float[ndarray, "3 3"]:
    f = np.exp(theta[0])
    return np.array([[f, theta[4] * f, theta[2]], [0, f * np.exp(theta[1]), theta[3]], [0, 0, 1]])


def _back_project(
    theta: Float[ndarray, "*batch 5"], columns: ndarray
) -> tuple[ndarray, ndarray, Float[ndarray, "*batch"]]:
    """``K⁻¹ [h1 h2]`` by view (*batch, views, 3, 2), K⁻¹ itself, and K's focal length along x."""
    fx = np.exp(theta[..., 0])
    fy = fx * np.exp(theta[..., 1])
    inverse = np.zeros((*theta.shape[:-1], 3, 3))
    inverse[..., 0, 0], inverse[..., 1, 1], inverse[..., 2, 2] = 1 / fx, 1 / fy, 1
    inverse[..., 0, 1] = -theta[..., 4] / fy
    inverse[..., 0, 2] = (-theta[..., 2] + theta[..., 4] * theta[..., 3] * fx / fy) / fx
    inverse[..., 1, 2] = -theta[..., 3] / fy
    inverse = inverse[..., None, :, :]
    return inverse @ columns, inverse, fx


def _constraints(theta: Float[ndarray, "*batch 5"], columns: ndarray) -> ndarray:
    """Cosines between the edge directions and between the diagonals, (*batch, views, 2)."""
    A, _, _ = _back_project(theta, columns)
    a, b = A[..., 0], A[..., 1]
    aa, bb = np.sum(a * a, axis=-1), np.sum(b * b, axis=-1)
    return np.stack([np.sum(a * b, axis=-1) * 2, aa - bb], axis=-1) / (aa + bb)[..., None]


def _whitener(theta: Float[ndarray, "*batch 5"], columns: ndarray, covariance: ndarray) -> ndarray:
    """Inverse Cholesky factor of the constraints' covariance, (*batch, views, 2, 2)."""
    A, inverse, _ = _back_project(theta, columns)
    size = np.sum(A * A, axis=(-1, -2))[..., None, None]
    a_K, b_K = A.swapaxes(-1, -2)[..., :1, :] @ inverse, A.swapaxes(-1, -2)[..., 1:, :] @ inverse
    J = np.concatenate([np.concatenate([b_K, a_K], axis=-1), np.concatenate([a_K, -b_K], axis=-1)], axis=-2) * (
        2 / size
    )
    C = J @ covariance @ J.swapaxes(-1, -2)
    # (1e-5)² stands for what no covariance knows: unmodelled distortion, an uneven board
    p, q, r = C[..., 0, 0] + 1e-10, C[..., 0, 1], C[..., 1, 1] + 1e-10
    l11 = np.sqrt(p)
    l21 = q / l11
    l22 = np.sqrt(np.maximum(r - l21 * l21, 1e-20))
    out = np.zeros(C.shape)
    out[..., 0, 0], out[..., 1, 1] = 1 / l11, 1 / l22
    out[..., 1, 0] = -l21 / (l11 * l22)
    return out


def _whitened(theta: Float[ndarray, "*batch 5"], columns: ndarray, covariance: ndarray) -> tuple[ndarray, ndarray]:
    W = _whitener(theta, columns, covariance)
    return (W @ _constraints(theta, columns)[..., None])[..., 0], W


def _view_weights(residuals: Float[ndarray, "views 2"]) -> Float[ndarray, "views"]:
    """Square roots of Cauchy weights over views; the scale is the median view's, at least one standard deviation."""
    length = np.sqrt(np.sum(residuals**2, axis=-1))
    scale = max(1.0, float(np.median(length)) / 1.1774)
    return 1 / np.sqrt(1 + (length / (3 * scale)) ** 2)


def _scan_focal(columns: ndarray, covariance: ndarray) -> Float[ndarray, "3 3"]:
    """Centred K with the focal length of least robust cost among 40 candidates."""
    theta = np.zeros((40, 5))
    shortest, longest = np.log(FOCAL_RANGE)
    theta[:, 0] = np.linspace(shortest, longest, 40)
    residuals, _ = _whitened(theta, columns, covariance)
    cost = np.sum(np.log1p(np.sum(residuals**2, axis=-1) / 9), axis=-1)
    return _unpack(theta[int(np.argmin(cost))])


def _polish(
    theta: Float[ndarray, "5"],
    columns: ndarray,
    covariance: ndarray,
    sigma_centre: ndarray,
    has_skew: bool,
    log_focal: tuple[float, float] | None,
) -> tuple[float, ndarray, ndarray, ndarray, ndarray]:
    """Robust cost, parameters, whitened residuals, view weights and information (without priors) of Gauss-Newton."""
    n_free = 5 if has_skew else 4
    theta = theta.copy()
    if not has_skew:
        theta[4] = 0.0
    value, sigma = (0.0, np.inf) if log_focal is None else log_focal
    prior_mean = np.r_[value, 0, 0, 0, 0][:n_free]
    prior_sigma = np.r_[sigma, 0.2, sigma_centre, 0.02][:n_free]
    prior = 1 / prior_sigma**2
    step_size = 1e-6 * np.eye(5)[:n_free]
    information = np.zeros((n_free, n_free))
    for _ in range(8):
        residuals, W = _whitened(theta, columns, covariance)
        weights = _view_weights(residuals)
        stacked = _constraints(np.concatenate([theta[None] + step_size, theta[None] - step_size]), columns)
        J = np.moveaxis(stacked[:n_free] - stacked[n_free:], 0, -1) / 2e-6
        J = (W @ J) * weights[:, None, None]
        J = J.reshape(-1, n_free)
        information = J.T @ J
        gradient = J.T @ (residuals * weights[:, None]).ravel() + prior * (theta[:n_free] - prior_mean)
        step = -np.linalg.solve(information + np.diag(prior + 1e-9 + 1e-6 * np.diag(information)), gradient)
        step = np.clip(step, -0.4, 0.4)
        theta[:n_free] += step
        theta[0] = np.clip(theta[0], *np.log(FOCAL_RANGE))
        theta[2:4] = np.clip(theta[2:4], -_CENTRE_LIMIT, _CENTRE_LIMIT)
        theta[1] = np.clip(theta[1], -0.7, 0.7)
        if np.max(np.abs(step)) < 1e-4:
            break
    residuals, _ = _whitened(theta, columns, covariance)
    weights = _view_weights(residuals)
    scale2 = max(1.0, float(np.median(np.sum(residuals**2, axis=-1))) / 1.386)
    cost = float(
        np.sum(np.log1p(np.sum(residuals**2, axis=-1) / 9)) * 9 + np.sum(prior * (theta[:n_free] - prior_mean) ** 2)
    )
    return cost, theta, residuals, weights, information / scale2


def board_slopes(
    theta_or_K: Float[ndarray, "3 3"], columns: ndarray, covariance: ndarray
) -> tuple[Float[ndarray, "views 2"], Float[ndarray, "views 2 2"]]:
    """Tilt of each board as slopes (tangents about both axes) against the image plane, and their covariance.

    From the board's vanishing line l = h1 x h2: slopes = K's lengths times (l1, l2) / l3, taken at the principal point.
    """
    K = theta_or_K
    inverse = np.linalg.inv(K)
    A = inverse @ columns
    a, b = A[..., 0], A[..., 1]
    normal = np.cross(a, b)
    slopes = normal[:, :2] / normal[:, 2:]
    # d(a x b) = da x b + a x db
    skew_a, skew_b = _hat(a), _hat(b)
    dn = np.concatenate([-skew_b @ inverse, skew_a @ inverse], axis=-1)
    J = (dn[:, :2] - slopes[..., None] * dn[:, 2:]) / normal[:, 2, None, None]
    return slopes, J @ covariance @ J.swapaxes(-1, -2)


def _hat(a: Float[ndarray, "*batch 3"]) -> Float[ndarray, "*batch 3 3"]:
    out = np.zeros((*a.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -a[..., 2], a[..., 1], -a[..., 0]
    return out - out.swapaxes(-1, -2)


def _uncertainty(
    theta: ndarray, columns: ndarray, covariance: ndarray, information: ndarray, n_views: int
) -> tuple[float, Float[ndarray, "2"]]:
    """Relative sigma of the focal length (all else marginalised under weak priors), and sigma of the principal point.

    Information that comes from noise alone does not count: it is scaled by the share of the tilt that exceeds 3 sigma.
    """
    slopes, C = board_slopes(_unpack(theta), columns, covariance)
    with np.errstate(all="ignore"):
        significance = np.sum(
            slopes[:, None, :] @ np.linalg.inv(C + 1e-12 * np.eye(2)) @ slopes[..., None], axis=(-1, -2)
        )
    share = float(np.mean(np.maximum(0.0, 1 - 9 / np.maximum(np.nan_to_num(significance), 1e-9))))
    weak_prior = np.r_[0.0, 1 / 0.05**2, 1 / 0.15**2, 1 / 0.15**2, 1 / 0.01**2][: len(information)]
    C = np.linalg.inv(information * share + np.diag(weak_prior + 1e-2))
    free = np.linalg.inv(
        information * share + np.diag(np.r_[1e-2, 1 / 0.05**2, 1e-2, 1e-2, 1 / 0.01**2][: len(information)])
    )
    return float(np.sqrt(C[0, 0])), np.sqrt(np.diag(free)[2:4])


def check_orientations(K: Float[ndarray, "3 3"], columns: ndarray, covariance: ndarray, camera: str) -> None:
    """Refuse sets of views from which no pinhole matrix follows: all fronto-parallel, or all parallel to each other.

    The decision is statistical: the scatter of the boards' slopes against the covariance that the corners' own
    residuals give them, so that a weak but honest set passes.

    Raises:
        DegenerateGeometryError: Named set, and what to add.
    """
    slopes, C = board_slopes(K, columns, covariance)
    weight = np.linalg.inv(C + 1e-12 * np.eye(2))
    keep = np.ones(len(slopes), dtype=bool)
    mean = np.median(slopes, axis=0)
    d, distance = slopes - mean, np.zeros(len(slopes))
    for _ in range(2):
        mean = np.linalg.solve(weight[keep].sum(axis=0), (weight[keep] @ slopes[keep][..., None]).sum(axis=0))[:, 0]
        d = slopes - mean
        distance = np.sum(d[:, None, :] @ weight @ d[..., None], axis=(-1, -2))
        keep = distance <= max(np.quantile(distance, 0.9), 1e-300)  # one wild view must not make a set look varied
    spread = float(np.median(distance)) / 1.386
    tilt_deg = float(np.degrees(np.arctan(np.hypot(*mean))))
    spread_deg = float(np.degrees(np.sqrt(np.median(np.sum(d * d, axis=-1)))))
    if spread < 6.0:  # median of chi-square with 2 degrees of freedom, relative: 1 is pure noise
        centre_weight = float(mean @ weight.sum(axis=0) @ mean) / len(slopes)
        which = (
            "parallel to the image plane"
            if tilt_deg < 5 or centre_weight < 6
            else f"parallel to each other (tilt {tilt_deg:.0f} deg)"
        )
        raise refusal(finding("boards-parallel", camera=camera, parallel_to=which, spread_deg=spread_deg))
