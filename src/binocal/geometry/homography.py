"""Homographies from a plane to many images at once: weighted DLT in closed form, and a robust fit over it.

The normal equations of the DLT depend on the corners through 24 sums per view, so a fit costs one matrix product;
eliminating the first two rows of H leaves a 3x3 problem, so no per-view eigendecomposition is needed. The third row
is scaled to end in 1 in coordinates that are centred on the board: that entry is the depth of the board's centre,
which is never near zero. Source: Hartley & Zisserman 2004, algorithm 4.2, with the algebraic error divided by the
last pass's depths (Sampson weights).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal import kernels
from binocal.shapes import Bool, Float

MIN_POINTS = 4  # a homography has 8 degrees of freedom, a point gives 2
_SYMMETRIC = np.array([[0, 1, 3], [1, 2, 4], [3, 4, 5]])
_FLAT = 1e-4  # variance ratio: points whose spread across a line is 1 % of that along it determine no homography
_MEDIAN_TO_SIGMA = 1 / 1.1774  # median of a Rayleigh distribution
_N_SUBSETS = 96  # 4-point starts: with 40 % outliers all 96 fail once in 600,000 times
_SUSPECT_RATIO = 4.5  # largest residual over robust sigma: 1 in 300 clean 88-corner views exceeds it
_WILD_RATIO = 8.0  # honest distortion stays below
_WILD = 0.02  # robust sigma over the board's RMS radius
_CHUNK = 64  # suspect views examined at once, to bound memory

GOOD, TOO_FEW, COINCIDENT, COLLINEAR, UNFIT = range(5)


@dataclass(frozen=True, slots=True, eq=False)
class PlaneFrame:
    """Board coordinates centred and scaled: ``basis`` (n, 6) holds x², xy, y², x, y, 1 of the normalised points."""

    xy: Float[ndarray, "n 2"]
    basis: Float[ndarray, "n 6"]
    centre: Float[ndarray, "2"]
    scale: float

    @staticmethod
    def of(object_points: Float[ndarray, "n d"]) -> PlaneFrame:
        """Frame of planar points; a third coordinate is ignored."""
        points = np.asarray(object_points, dtype=float)[:, :2]
        centre = points.mean(axis=0)
        xy = points - centre
        scale = math.sqrt(np.vdot(xy, xy) / len(xy)) or 1.0
        xy /= scale
        return PlaneFrame(xy, monomials(xy[:, 0], xy[:, 1]), centre, scale)

    @property
    def matrix(self) -> Float[ndarray, "3 3"]:
        """Homogeneous matrix from board coordinates to normalised ones."""
        return np.array([[1, 0, -self.centre[0]], [0, 1, -self.centre[1]], [0, 0, self.scale]]) / self.scale


def monomials(x: Float[ndarray, "*n"], y: Float[ndarray, "*n"]) -> Float[ndarray, "*n 6"]:
    """x², xy, y², x, y, 1."""
    out = np.empty((*x.shape, 6))
    for i, column in enumerate((x * x, x * y, y * y, x, y, 1.0)):
        out[..., i] = column
    return out


def plane_moments(
    basis: Float[ndarray, "*#batch n 6"],
    u: Float[ndarray, "*batch n"],
    v: Float[ndarray, "*batch n"],
    w: Float[ndarray, "*batch n"],
) -> Float[ndarray, "*batch 4 3 3"]:
    """Sums over points of ``w X Xᵀ`` times 1, u, v and u² + v², X = (x, y, 1). Weight 0 drops a point; u, v finite."""
    rows = np.empty((*w.shape[:-1], 4, w.shape[-1]))
    rows[..., 0, :] = w
    wu = np.multiply(w, u, out=rows[..., 1, :])
    wv = np.multiply(w, v, out=rows[..., 2, :])
    np.multiply(wu, u, out=rows[..., 3, :])
    rows[..., 3, :] += wv * v
    if basis.ndim > 2:  # each view has its own points
        return (rows @ basis)[..., _SYMMETRIC]
    return (rows.reshape(-1, rows.shape[-1]) @ basis).reshape(*rows.shape[:-1], 6)[..., _SYMMETRIC]


def plane_spread(
    x: Float[ndarray, "*batch n"], y: Float[ndarray, "*batch n"], w: Float[ndarray, "*#batch n"]
) -> Float[ndarray, "*batch"]:
    """Weighted RMS radius about the weighted mean; 1 where there is none. Points of weight 0 must be finite."""
    total = np.maximum(w.sum(axis=-1), 1e-9)
    wx, wy = w * x, w * y
    second = (np.sum(wx * x, axis=-1) + np.sum(wy * y, axis=-1)) / total
    spread2 = second - (np.sum(wx, axis=-1) / total) ** 2 - (np.sum(wy, axis=-1) / total) ** 2
    return np.sqrt(np.where(spread2 > 1e-14 * second, spread2, 1.0))


@dataclass(frozen=True, slots=True, eq=False)
class PlaneFit:
    """Least-squares homographies in normalised coordinates, with what their covariance needs.

    ``rows`` maps (x, y, 1) to (u, v, 1) times the depth. ``S_inverse``, ``P`` and ``D_inverse`` are the blocks of the
    inverse normal matrix: rows 1 and 2 are ``P[:, :3] h3`` and ``P[:, 3:] h3``, each with noise ``S_inverse``, and
    the first two entries of row 3 have the covariance ``D_inverse``; all for unit weights' noise.
    """

    rows: Float[ndarray, "*batch 3 3"]
    S_inverse: Float[ndarray, "*batch 3 3"]
    P: Float[ndarray, "*batch 3 6"]
    D_inverse: Float[ndarray, "*batch 2 2"]

    @property
    def column_covariance(self) -> Float[ndarray, "*batch 6 6"]:
        """Covariance of the first two columns, ordered (h11, h21, h31, h12, h22, h32), for unit noise."""
        G = np.zeros((*self.rows.shape[:-2], 3, 3, 2))  # row, column, by the two free entries of the third row
        G[..., 0, :, :], G[..., 1, :, :] = self.P[..., :2], self.P[..., 3:5]
        G[..., 2, 0, 0] = G[..., 2, 1, 1] = 1.0
        G = np.concatenate([G[..., :, 0, :], G[..., :, 1, :]], axis=-2)
        covariance = G @ self.D_inverse @ G.swapaxes(-1, -2)
        for row in range(2):
            for i in range(2):
                for j in range(2):
                    covariance[..., 3 * i + row, 3 * j + row] += self.S_inverse[..., i, j]
        return covariance


def solve_plane(moments: Float[ndarray, "*batch 4 3 3"]) -> PlaneFit:
    """Homographies of :func:`plane_moments`. NOT checked: that the points determine one (else NaN or inf)."""
    S, S_u, S_v, S_q = (moments[..., i, :, :] for i in range(4))
    S_inverse = _inverse3(S)
    P = S_inverse @ np.concatenate([S_u, S_v], axis=-1)
    D = S_q - S_u @ P[..., :3] - S_v @ P[..., 3:]
    with np.errstate(all="ignore"):
        a, b, d = D[..., 0, 0], D[..., 0, 1], D[..., 1, 1]
        determinant = a * d - b * b
        D_inverse = np.stack([d, -b, -b, a], axis=-1).reshape(*a.shape, 2, 2) / determinant[..., None, None]
        h3 = np.ones((*a.shape, 3))
        h3[..., :2] = -(D_inverse @ D[..., :2, 2:])[..., 0]
        rows = np.stack([(P[..., :3] @ h3[..., None])[..., 0], (P[..., 3:] @ h3[..., None])[..., 0], h3], axis=-2)
    return PlaneFit(rows, S_inverse, P, D_inverse)


def _inverse3(S: Float[ndarray, "*batch 3 3"]) -> Float[ndarray, "*batch 3 3"]:
    """Inverse by cofactors; inf or NaN where singular (``numpy.linalg.inv`` would fail for the whole batch)."""
    a, b, c, d, e, f = S[..., 0, 0], S[..., 0, 1], S[..., 0, 2], S[..., 1, 1], S[..., 1, 2], S[..., 2, 2]
    out = np.empty(S.shape)
    out[..., 0, 0] = d * f - e * e
    out[..., 0, 1] = out[..., 1, 0] = c * e - b * f
    out[..., 0, 2] = out[..., 2, 0] = b * e - c * d
    out[..., 1, 1] = a * f - c * c
    out[..., 1, 2] = out[..., 2, 1] = b * c - a * e
    out[..., 2, 2] = a * d - b * b
    with np.errstate(all="ignore"):
        return out / (a * out[..., 0, 0] + b * out[..., 0, 1] + c * out[..., 0, 2])[..., None, None]


def map_plane(
    rows: Float[ndarray, "*batch 3 3"], xy: Float[ndarray, "n 2"]
) -> tuple[Float[ndarray, "*batch n"], Float[ndarray, "*batch n"], Float[ndarray, "*batch n"]]:
    """u, v and depth (third homogeneous coordinate) of plane points."""
    X = np.concatenate([xy.T, np.ones((1, len(xy)))])
    mapped = rows @ X
    with np.errstate(all="ignore"):
        inverse = 1.0 / mapped[..., 2, :]
        return mapped[..., 0, :] * inverse, mapped[..., 1, :] * inverse, mapped[..., 2, :]


def fit_plane(
    frame: PlaneFrame,
    u: Float[ndarray, "*batch n"],
    v: Float[ndarray, "*batch n"],
    w: Float[ndarray, "*batch n"],
    n_passes: int = 2,
) -> tuple[PlaneFit, Float[ndarray, "*batch n"], Float[ndarray, "*batch n"]]:
    """Weighted least-squares fit in image coordinates of order one, and residuals u, v; geometric from pass two on.

    What :func:`solve_plane` makes of :func:`plane_moments`, once for each pass; from the second on the weights are
    divided by the squared depths. Compiled.
    """
    rows, S_inverse, P, D_inverse, du, dv = kernels.fit_planes(frame.xy, u, v, w, n_passes)
    return PlaneFit(rows, S_inverse, P, D_inverse), du, dv


@dataclass(frozen=True, slots=True, eq=False)
class HomographyFit:
    """Robust homographies of many views.

    ``H`` takes board coordinates (x, y, 1) to pixels, NaN where ``status`` is not GOOD (0); TOO_FEW, COINCIDENT,
    COLLINEAR and UNFIT say why. ``residuals_px`` are distances (NaN = not seen), ``weights`` in [0, 1] what the
    robust fit gave each corner (0 = not seen), ``sigma_px`` the robust standard deviation of one coordinate; lens
    distortion counts as noise here. ``px_per_unit``: RMS radius of the seen corners in the image over that on the
    board.
    """

    H: Float[ndarray, "views 3 3"]
    residuals_px: Float[ndarray, "views n"]
    weights: Float[ndarray, "views n"]
    sigma_px: Float[ndarray, "views"]
    px_per_unit: Float[ndarray, "views"]
    status: ndarray

    @property
    def is_valid(self) -> Bool[ndarray, "views"]:
        """Where a homography was found."""
        return self.status == GOOD


def fit_homographies(
    object_points: Float[ndarray, "n d"], pixels: Float[ndarray, "views n 2"], *, is_robust: bool = True
) -> HomographyFit:
    """Homographies board → pixels of all views; NaN pixels were not seen, object points lie in z = 0.

    Views that a plain fit explains evenly are left at it. The others (a residual above 4.5 robust standard
    deviations, or a scale 3 times the median view's) start again from the best of 96 four-corner fits (least median),
    and are reweighted (Geman-McClure, scale = median of that view's residuals): up to 40 % of wild corners, or a
    wrapped row, do not spoil a view, and honest lens distortion only widens the scale.

    Source: Rousseeuw & Leroy 1987 (least median of squares); Holland & Welsch 1977 (reweighting).
    """
    frame = PlaneFrame.of(object_points)
    pixels = np.asarray(pixels, dtype=float)
    is_seen = np.isfinite(pixels[..., 0])
    n_seen = is_seen.sum(axis=-1)
    w = is_seen.astype(float)
    count = np.maximum(n_seen, 1)[:, None]
    u, v = np.where(is_seen, pixels[..., 0], 0.0), np.where(is_seen, pixels[..., 1], 0.0)
    centre_u, centre_v = u.sum(axis=-1, keepdims=True) / count, v.sum(axis=-1, keepdims=True) / count
    u, v = (u - centre_u) * w, (v - centre_v) * w
    status, spread, board_spread = _classify(frame, u, v, w, n_seen)
    usable = status == GOOD
    scale = np.where(usable, spread, 1.0)[:, None]
    u, v = u / scale, v / scale

    with np.errstate(all="ignore"):
        fit, du, dv = fit_plane(frame, u, v, w)
        rows, weights = fit.rows, w
        residuals = np.hypot(du, dv)
        sigma = _sigma(residuals, is_seen, n_seen)
        if is_robust:
            worst = np.max(np.where(is_seen, residuals, 0), axis=-1)
            sigma_px = sigma * scale[:, 0]
            typical = np.median(sigma_px[usable]) if usable.any() else 0.0
            is_wild = (sigma_px > 3 * typical) | (sigma > _WILD) | (worst > _WILD_RATIO * sigma) | ~np.isfinite(worst)
            suspect = usable & (n_seen > MIN_POINTS) & (is_wild | (worst > _SUSPECT_RATIO * sigma))
            suspect &= ~(worst * scale[:, 0] < 1e-6)
            if suspect.any():
                rows, weights, residuals, sigma = rows.copy(), w.copy(), residuals.copy(), sigma.copy()
                for group, restarts in ((suspect & ~is_wild, False), (suspect & is_wild, True)):
                    index = np.flatnonzero(group)
                    for part in (index[i : i + _CHUNK] for i in range(0, len(index), _CHUNK)):
                        start = None if restarts else (rows[part], residuals[part], sigma[part])
                        rows[part], weights[part], residuals[part], sigma[part] = _refit(
                            frame, u[part], v[part], w[part], n_seen[part], start
                        )
        depth = map_plane(rows, frame.xy)[2]
        is_front = np.all(~(weights > 0.1) | (depth > 1e-3), axis=-1) & np.all(np.isfinite(rows), axis=(-1, -2))
    status = np.where(usable & ~is_front, UNFIT, status)
    good = status == GOOD
    to_px = np.zeros((len(u), 3, 3))
    to_px[:, 0, 0] = to_px[:, 1, 1] = scale[:, 0]
    to_px[:, 0, 2], to_px[:, 1, 2], to_px[:, 2, 2] = centre_u[:, 0], centre_v[:, 0], 1.0
    with np.errstate(all="ignore"):
        H = to_px @ rows @ frame.matrix
    H[~good] = np.nan
    return HomographyFit(
        H,
        np.where(is_seen & good[:, None], residuals * scale, np.nan),
        np.where(good[:, None], weights, 0.0),
        np.where(good, sigma * scale[:, 0], np.nan),
        np.where(n_seen >= MIN_POINTS, spread / np.maximum(board_spread * frame.scale, 1e-300), np.nan),
        status,
    )


def _classify(
    frame: PlaneFrame, u: ndarray, v: ndarray, w: ndarray, n_seen: ndarray
) -> tuple[ndarray, Float[ndarray, "views"], Float[ndarray, "views"]]:
    """Why a view cannot have a homography, and the RMS radius of its pixels and of its board points."""
    count = np.maximum(n_seen, 1)
    uu, uv, vv = (np.sum(a * b, axis=-1) / count for a, b in ((u, u), (u, v), (v, v)))
    spread = np.sqrt(uu + vv)
    sums = w @ frame.basis / count[:, None]
    xx, xy, yy = sums[:, 0] - sums[:, 3] ** 2, sums[:, 1] - sums[:, 3] * sums[:, 4], sums[:, 2] - sums[:, 4] ** 2

    def is_flat(a: ndarray, b: ndarray, d: ndarray) -> ndarray:
        return (a * d - b * b) < _FLAT / 4 * (a + d) ** 2

    status = np.full(len(u), GOOD)
    status[is_flat(uu, uv, vv) | is_flat(xx, xy, yy)] = COLLINEAR
    status[spread < 1.0] = COINCIDENT  # a board two pixels wide measures nothing
    status[n_seen < MIN_POINTS] = TOO_FEW
    return status, spread, np.sqrt(np.maximum(xx + yy, 0.0))


def _sigma(residuals: ndarray, is_seen: ndarray, n_seen: ndarray) -> Float[ndarray, "*batch"]:
    """Robust standard deviation of a coordinate: the median distance, corrected for the 8 fitted parameters."""
    n = residuals.shape[-1]
    if np.all(n_seen == n):
        middle = np.partition(residuals, n // 2, axis=-1)[..., n // 2]
    else:
        ordered = np.sort(np.where(is_seen, residuals, np.inf), axis=-1)
        middle = np.take_along_axis(
            ordered, np.broadcast_to((n_seen // 2)[..., None], (*ordered.shape[:-1], 1)), axis=-1
        )[..., 0]
    return middle * _MEDIAN_TO_SIGMA * np.sqrt(2 * n_seen / np.maximum(2 * n_seen - 8, 1))


def _refit(
    frame: PlaneFrame,
    u: ndarray,
    v: ndarray,
    w: ndarray,
    n_seen: ndarray,
    start: tuple[ndarray, ndarray, ndarray] | None,
) -> tuple[ndarray, ndarray, ndarray, ndarray]:
    """Rows, weights, residuals, sigma of suspect views, normalised; from four-corner fits if ``start`` is None."""
    is_seen = w > 0
    rows, residuals, sigma = _best_subset(frame, u, v, is_seen, n_seen) if start is None else start
    depth, weights = map_plane(rows, frame.xy)[2], w
    for iteration in range(6 if start is None else 4):
        width = np.maximum((4.0 if iteration < 2 else 3.0) * sigma, 1e-9)[:, None]
        weights = w / (1 + (residuals / width) ** 2) ** 2
        rows = solve_plane(plane_moments(frame.basis, u, v, weights / np.maximum(depth * depth, 1e-2))).rows
        u_fit, v_fit, depth = map_plane(rows, frame.xy)
        residuals = np.hypot(u - u_fit, v - v_fit)
        residuals = np.where(np.isfinite(residuals) & (depth > 0), residuals, 1e3)
        sigma = _sigma(residuals, is_seen, n_seen)
    return rows, weights, residuals, sigma


def _best_subset(
    frame: PlaneFrame, u: ndarray, v: ndarray, is_seen: ndarray, n_seen: ndarray
) -> tuple[ndarray, ndarray, ndarray]:
    """Rows, residuals and sigma of the four-corner fit with the least median residual, per view."""
    # The same pseudo-random subsets on every call: results must not depend on what ran before.
    keys = np.random.default_rng(0).random((_N_SUBSETS, u.shape[-1]))
    keys = np.where(is_seen[:, None, :], keys, 2.0)
    chosen = np.argpartition(keys, 3, axis=-1)[..., :4]
    view = np.arange(len(u))
    picked = view[:, None, None], chosen
    rows = solve_plane(plane_moments(frame.basis[chosen], u[picked], v[picked], np.ones(chosen.shape))).rows
    u_fit, v_fit, depth = map_plane(rows, frame.xy)
    residuals = np.hypot(u[:, None] - u_fit, v[:, None] - v_fit)
    residuals = np.where(np.isfinite(residuals) & (depth > 0.02), residuals, 1e3)
    sigma = _sigma(residuals, is_seen[:, None, :], n_seen[:, None])
    best = view, np.argmin(sigma, axis=-1)
    return rows[best], residuals[best], sigma[best]
