"""Lens distortion before anything else is known: the radial profile that makes board views projective.

A pixel at (dx, dy) from the distortion centre is lifted to the ray (dx, dy, g), g = 1 + l1 r² + l2 r⁴, lengths in
half diagonals of the image. With l1 < 0 this covers barrel distortion and every usual fisheye (equidistant: g = θ /
tan θ, whose series it follows to 1 % at 75°; stereographic: l2 = 0 exactly), rays beyond 90° included (g < 0).
Neither focal length nor pose enters: the homographies' residual alone decides (Fitzgibbon 2001, "Simultaneous linear
estimation of multiple view geometry and lens distortion"; two coefficients and the centre are this project's, solved
by Gauss-Newton with the homographies eliminated).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.geometry.homography import PlaneFit, PlaneFrame, fit_plane, plane_spread
from binocal.geometry.so3 import turn_to_z
from binocal.shapes import Float

MAX_VIEWS, MAX_POINTS = (
    12,
    60,
)  # evenly chosen, points of a whole board; enough for a start, the joint solver sees everything
_NO_FIT = 1.0  # residual, half diagonals, of a corner whose view has no homography on a candidate's rays
_MIN_G = 0.3  # 75-80 deg from the axis: nearer to the horizon rays are turned before the plane is used
_MIN_COSINE = 0.08  # a corner 85 deg from its own view's mean ray is left out
_CANDIDATES = (
    0.0,
    -0.12,
    -0.3,
    -0.5,
    -0.8,
    -1.3,
    -2.2,
    0.25,
)  # l1: none, barrel up to 240° fisheyes (diagonal), pincushion


@dataclass(frozen=True, slots=True, eq=False)
class Lifting:
    """Radial profile, pixel → ray (dx, dy, g); placed by ``centre_px``, scaled by ``unit_px``, ``aspect`` = fx / fy."""

    centre_px: Float[ndarray, "2"]
    unit_px: float
    aspect: float
    l1: float
    l2: float
    sigma_centre: Float[ndarray, "2"]
    """Standard deviation of the centre, in units, as far as the distortion itself determines it."""

    def lift(
        self, u_px: Float[ndarray, "*n"], v_px: Float[ndarray, "*n"]
    ) -> tuple[Float[ndarray, "*n"], Float[ndarray, "*n"], Float[ndarray, "*n"]]:
        """dx, dy (rows scaled by ``aspect``) and g, in units."""
        dx = (u_px - self.centre_px[0]) / self.unit_px
        dy = (v_px - self.centre_px[1]) * (self.aspect / self.unit_px)
        r2 = dx * dx + dy * dy
        return dx, dy, 1 + r2 * (self.l1 + r2 * self.l2)


def estimate_lifting(
    frame: PlaneFrame,
    u_px: Float[ndarray, "views n"],
    v_px: Float[ndarray, "views n"],
    weights: Float[ndarray, "views n"],
    size_wh: tuple[int, int],
    aspect: float = 1.0,
) -> Lifting:
    """Radial profile and its centre from at most 12 evenly chosen views; weight 0 marks unseen or outlying corners.

    Of a whole board 60 points are enough; of a board seen in part so many more that a view keeps as many of those it shows.
    """
    centre = np.array([(size_wh[0] - 1) / 2, (size_wh[1] - 1) / 2])
    unit = float(np.hypot(*size_wh) / 2)
    n_views, n_points = u_px.shape
    chosen = np.linspace(0, n_views - 1, min(MAX_VIEWS, n_views)).round().astype(int)[:, None]
    share_seen = float(np.mean(weights[chosen[:, 0]] > 0))
    n_chosen = min(n_points, int(np.ceil(MAX_POINTS / max(share_seen, 1e-3))))
    points = np.linspace(0, n_points - 1, n_chosen).round().astype(int)
    frame = replace(frame, xy=frame.xy[points], basis=frame.basis[points])
    u = (u_px[chosen, points] - centre[0]) / unit
    v = (v_px[chosen, points] - centre[1]) * (aspect / unit)
    w = weights[chosen, points]
    u, v = np.where(w > 0, u, 0.0), np.where(w > 0, v, 0.0)
    w_flat = np.repeat(w[:, None] > 0, 2, axis=1).ravel()

    coarse = np.zeros((len(_CANDIDATES), 4))
    coarse[:, 0] = _CANDIDATES
    few = slice(None, None, 3)
    best = coarse[int(np.argmin(_cost(_residuals(coarse, frame, u[few], v[few], w[few]))))]
    # Priors in units: l1, l2 of usual lenses; principal points lie within a few percent of the middle
    prior = 1 / np.array([2.0, 2.0, 0.06, 0.06]) ** 2
    offsets = 1e-5 * np.concatenate(
        [np.zeros((1, 4)), np.eye(4)]
    )  # a candidate and its four finite differences at once
    lam, current, candidate = 1e-4, np.inf, best
    N, gradient, sigma2 = np.zeros((4, 4)), np.zeros(4), 1.0
    for _ in range(10):
        residuals = _residuals(candidate + offsets, frame, u, v, w)
        cost = float(_cost(residuals[:1])[0])
        if cost < current * (1 + 1e-6):
            gain = current - cost
            best, current, lam = candidate, cost, max(lam / 10, 1e-6)
            r = residuals[0].ravel()
            J = (residuals[1:].reshape(4, -1) - r) / offsets[1, 0]
            scale = max(1.4826 * float(np.median(np.abs(r[w_flat]))), 1e-7)
            sigma2 = scale * scale
            kernel = J / np.square(1 + np.square(r / (4 * scale)))  # each row times its square-root-free weight
            N = kernel @ J.T
            gradient = kernel @ r + sigma2 * prior * best
            if gain < 0.02 * current:
                break
        else:
            lam = max(lam * 30, 0.01)
            if lam > 300:
                break
        step = -np.linalg.solve(N + sigma2 * np.diag(prior) + lam * np.diag(np.diag(N)), gradient)
        if np.max(np.abs(step)) < 1e-3:
            break
        candidate = best + np.clip(step, -0.3, 0.3)
    sigma = np.sqrt(np.diag(np.linalg.inv(N / sigma2 + np.diag(1 / np.array([2.0, 2.0, 0.3, 0.3]) ** 2))))
    return Lifting(
        centre + unit * best[2:] / np.array([1, aspect]), unit, aspect, float(best[0]), float(best[1]), sigma[2:]
    )


def _residuals(parameters: Float[ndarray, "k 4"], frame: PlaneFrame, u: ndarray, v: ndarray, w: ndarray) -> ndarray:
    """Homography residuals in units of the image, (k, views, 2, n), weighted; finite.

    A view that has no homography on a candidate's rays, because few of its corners are left this side of the horizon, counts
    against that candidate, and no further.
    """
    l1, l2, cx, cy = (parameters[:, i, None, None] for i in range(4))
    dx, dy = u - cx, v - cy
    r2 = dx * dx + dy * dy
    _, du, dv, _, root, _ = _fit_rays(frame, dx, dy, 1 + r2 * (l1 + r2 * l2), w, parameters[:, 0], n_passes=1)
    with np.errstate(all="ignore"):
        residuals = np.stack([du, dv], axis=-2) * (root * np.sqrt(w))[..., None, :]
    return np.where(np.isfinite(residuals), residuals, np.where(w > 0, _NO_FIT, 0.0)[..., None, :])


def _fit_rays(
    frame: PlaneFrame, dx: ndarray, dy: ndarray, g: ndarray, w: ndarray, l1: Float[ndarray, "*k"], n_passes: int = 2
) -> tuple[PlaneFit, ndarray, ndarray, ndarray | None, ndarray, ndarray]:
    """Fit on lifted rays: the fit, residuals in its plane, each view's turn, plane-to-image scale, and the weights.

    Where rays come near the lifted plane's horizon, each view is first turned (a 3x3 matrix M per view, after scaling
    g to metric rays by the equidistant estimate of the focal length) so that its mean ray is the axis: the homography
    found is then M H.
    """
    if np.all((g > _MIN_G) | (w == 0)):
        g = np.where(w > 0, g, 1.0)
        weights = w * g * g
        with np.errstate(all="ignore"):
            fit, du, dv = fit_plane(frame, dx / g, dy / g, weights, n_passes)
        return fit, du, dv, None, g, weights
    focal = 1 / np.sqrt(3 * np.maximum(-np.asarray(l1), 0.02))[..., None, None]
    rays = np.stack([dx, dy, focal * g], axis=-2)
    length = np.sqrt(np.sum(rays * rays, axis=-2, keepdims=True))
    rays = rays / np.where(length > 0, length, 1.0)
    axis = np.sum(rays * w[..., None, :], axis=-1)
    axis /= np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), 1e-12)
    M = turn_to_z(axis)
    turned = M @ rays
    z = np.where(turned[..., 2, :] > _MIN_COSINE, turned[..., 2, :], np.nan)
    w = np.where(np.isnan(z), 0.0, w)
    z = np.where(np.isnan(z), 1.0, z)
    a, b = turned[..., 0, :] / z, turned[..., 1, :] / z
    root = np.broadcast_to((plane_spread(dx, dy, w) / plane_spread(a, b, w))[..., None], a.shape)
    weights = w * root * root
    with np.errstate(all="ignore"):
        fit, du, dv = fit_plane(frame, a, b, weights, n_passes)
    M = M.copy()
    M[..., 2] *= focal
    return fit, du, dv, M, root, weights


def _cost(residuals: Float[ndarray, "k views 2 n"]) -> Float[ndarray, "k"]:
    """Mean absolute residual: robust enough to choose and to accept, and smooth enough."""
    return np.mean(np.abs(residuals), axis=(1, 2, 3))


def fit_lifted(
    lifting: Lifting, frame: PlaneFrame, u_px: ndarray, v_px: ndarray, weights: ndarray
) -> tuple[Float[ndarray, "views 3 2"], Float[ndarray, "views 6 6"], ndarray]:
    """First two columns of each homography board → (dx, dy, g), their covariance for unit noise, distances (px)."""
    dx, dy, g = lifting.lift(u_px, v_px)
    fit, du, dv, M, root, _ = _fit_rays(frame, dx, dy, g, weights, np.asarray(lifting.l1))
    columns, covariance = fit.rows[..., :2], fit.column_covariance
    if M is not None:
        inverse = np.linalg.inv(M)
        columns = inverse @ columns
        both = np.zeros((*inverse.shape[:-2], 6, 6))
        both[..., :3, :3] = both[..., 3:, 3:] = inverse
        covariance = both @ covariance @ both.swapaxes(-1, -2)
    return columns, covariance, np.hypot(du, dv) * root * lifting.unit_px


def fit_brown(lifting: Lifting, focal_px: float, r_max: float, n_coefficients: int) -> Float[ndarray, "d"]:
    """Brown-Conrady coefficients (k1, k2, p1, p2, ...) that follow the profile up to radius ``r_max`` (units).

    k1, k2 for four coefficients, k3 too for more; the rational ones stay 0. Fewer where the polynomial would fold
    back in range.
    """
    f = focal_px / lifting.unit_px
    r = np.linspace(0.02, 1, 60) * r_max
    g = 1 + r * r * (lifting.l1 + r * r * lifting.l2)
    keep = g > 0.12  # beyond 83° for f = r a polynomial in tan θ is hopeless
    r, g = r[keep], g[keep]
    x = r / (f * g)
    out = np.zeros(n_coefficients)
    slots = [0, 1] if n_coefficients == 4 else [0, 1, 4]
    for n_terms in range(len(slots), 0, -1):
        A = np.stack([x ** (3 + 2 * k) for k in range(n_terms)], axis=-1)
        scale = np.max(np.abs(A), axis=0)
        k = np.linalg.lstsq(A / scale, r / f - x, rcond=None)[0] / scale
        slope = 1 + sum((3 + 2 * i) * k[i] * x ** (2 + 2 * i) for i in range(n_terms))
        if np.all(slope > 0.02):
            out[slots[:n_terms]] = k
            return out
    return out


def fit_kannala_brandt(lifting: Lifting, focal_px: float, r_max: float) -> Float[ndarray, "4"]:
    """Fisheye coefficients that follow the profile up to ``r_max`` (units); k3, k4 stay 0 below 70° of half field."""
    f = focal_px / lifting.unit_px
    r = np.linspace(0.02, 1, 60) * r_max
    theta = np.arctan2(r / f, 1 + r * r * (lifting.l1 + r * r * lifting.l2))
    n_terms = 2 if theta[-1] < 1.2 else 3
    A = np.stack([theta ** (3 + 2 * k) for k in range(n_terms)], axis=-1)
    out = np.zeros(4)
    out[:n_terms] = np.linalg.lstsq(A, r / f - theta, rcond=None)[0]
    return out
