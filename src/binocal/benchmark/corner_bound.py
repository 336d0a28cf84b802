"""What the pixels about a corner allow at best."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.shapes import Float


def corner_bound(
    corner: Float[ndarray, "2"],
    edges_rad: Float[ndarray, "2"],
    *,
    blur_px: float,
    contrast_dn: float,
    noise_dn: float,
    radius_px: float,
    strip_px: float = np.inf,
    size_wh: tuple[float, float] = (np.inf, np.inf),
) -> Float[ndarray, "2 2"]:
    """Least covariance of an unbiased estimate of a corner's position, px^2 (Cramér-Rao).

    Of the disc of ``radius_px`` those pixels tell that are within ``strip_px`` of an edge and in an image of ``size_wh``.
    ``blur_px`` is the Gaussian's sigma with pixel integration included, ``contrast_dn`` bright minus dark. Derivatives of
    the position, the angles and the blur are those of the exact blurred pattern of two crossing edges. NaN where
    too few pixels tell.
    """
    from scipy.special import erf

    reach = int(np.ceil(radius_px)) + 1
    centre = np.rint(corner)
    v, u = np.mgrid[-reach : reach + 1, -reach : reach + 1] + (centre - corner)[::-1, None, None]
    normals = np.stack([-np.sin(edges_rad), np.cos(edges_rad)], axis=-1)
    along = np.stack([np.cos(edges_rad), np.sin(edges_rad)], axis=-1)
    beside = np.minimum(*(np.abs(n[0] * u + n[1] * v) for n in normals))
    x, y = u + corner[0], v + corner[1]
    inside = (np.hypot(u, v) <= radius_px) & (beside <= strip_px)
    inside &= (x >= 0) & (y >= 0) & (x <= size_wh[0] - 1) & (y <= size_wh[1] - 1)
    u, v = u[inside], v[inside]
    d1, d2 = (n[0] * u / blur_px + n[1] * v / blur_px for n in normals)
    s1, s2 = (a[0] * u / blur_px + a[1] * v / blur_px for a in along)
    rho = float(normals[0] @ normals[1])
    rest = np.sqrt(1 - rho**2)
    density = np.sqrt(2 / np.pi)
    F1 = density * np.exp(-0.5 * d1**2) * erf((d2 - rho * d1) / (np.sqrt(2) * rest))
    F2 = density * np.exp(-0.5 * d2**2) * erf((d1 - rho * d2) / (np.sqrt(2) * rest))
    joint = 2 / (np.pi * rest) * np.exp(-0.5 * (d1**2 - 2 * rho * d1 * d2 + d2**2) / rest**2)
    skew = np.sin(edges_rad[0] - edges_rad[1])
    position = [-(F1 * normals[0][i] + F2 * normals[1][i]) / blur_px for i in (0, 1)]
    # The pattern itself, for the contrast's column, by Price's integral over the correlation.
    nodes, weights = np.polynomial.legendre.leggauss(12)
    arc = np.arcsin(rho)
    F = erf(d1 / np.sqrt(2)) * erf(d2 / np.sqrt(2))
    for t, w in zip(arc * (nodes + 1) / 2, arc * weights / np.pi, strict=True):
        F = F + w * np.exp(-(d1**2 + d2**2 - 2 * d1 * d2 * np.sin(t)) / (2 * np.cos(t) ** 2))
    half = 0.5 * contrast_dn
    turn1, turn2 = -F1 * s1 - joint * skew, -F2 * s2 + joint * skew
    columns = [half * c for c in (*position, turn1, turn2, F1 * d1 + F2 * d2)] + [np.ones_like(u), F, u, v]
    J = np.stack(columns)
    if J.shape[1] < len(J):
        return np.full((2, 2), np.nan)
    return noise_dn**2 * np.linalg.inv(J @ J.T)[:2, :2]
