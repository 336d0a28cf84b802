"""What the pixels about a printed square's outline allow at best."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.shapes import Float

BAND_PX = 5.6
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)


def square_bound(
    corners_px: Float[ndarray, "4 2"],
    *,
    blur_px: float,
    noise_dn: float,
    outward_px: Float[ndarray, "4"],
    most_dn: float = np.inf,
    levels_dn: tuple[float, float] = (30.0, 210.0),
) -> Float[ndarray, "4 2 2"]:
    """Least covariance of an unbiased estimate of a square's corners, px^2 (Cramér-Rao).

    ``corners_px`` are the true ones, clockwise as seen, with straight sides between them; ``blur_px`` is the Gaussian's sigma with
    pixel integration included; ``outward_px`` how far from each side the square's own ground reaches; ``levels_dn`` are the grey
    levels inside and outside. Fourteen parameters: the corners, the blur of either pair of sides, offset, contrast and the light's
    two slopes. The pixels' noise is independent; those of the noiseless image beyond ``most_dn`` (clipped) say nothing.
    """
    band = max(BAND_PX, 3 * blur_px + 2)
    low, high = np.floor(corners_px.min(axis=0) - band), np.ceil(corners_px.max(axis=0) + band)
    x, y = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    first = np.array([*corners_px.ravel(), np.log(blur_px), np.log(blur_px), 0.0, 0.0])
    distance = _distances(x, y, corners_px)
    inside = (distance >= -np.minimum(band, outward_px)[:, None, None]).all(axis=0) & (distance.min(axis=0) <= band)
    x, y = x[inside], y[inside]
    middle = corners_px.mean(axis=0)
    grey = _grey(x, y, first, middle, levels_dn)
    x, y = x[grey < most_dn], y[grey < most_dn]
    steps = np.array([*(1e-4 * np.ones(10)), 1e-6, 1e-6])
    columns = [
        (_grey(x, y, first + step, middle, levels_dn) - _grey(x, y, first - step, middle, levels_dn)) / (2 * step.sum())
        for step in np.diag(steps)
    ]
    J = np.stack([*columns, np.ones_like(x), _grey(x, y, first, middle, (0.0, 1.0))])
    scale = np.linalg.norm(J, axis=1)
    J = J / scale[:, None]
    covariance = noise_dn**2 * np.linalg.inv(J @ J.T)[:8, :8] / np.outer(scale[:8], scale[:8])
    return np.stack([covariance[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] for i in range(4)])


def _distances(x: ndarray, y: ndarray, corners: Float[ndarray, "4 2"]) -> ndarray:
    """Inward distance from each side."""
    way = np.roll(corners, -1, axis=0) - corners
    way = way / np.linalg.norm(way, axis=1, keepdims=True)
    return np.stack([t[0] * (y - c[1]) - t[1] * (x - c[0]) for c, t in zip(corners, way, strict=True)])


def _grey(
    x: ndarray, y: ndarray, p: Float[ndarray, "12"], middle: Float[ndarray, "2"], levels_dn: tuple[float, float]
) -> ndarray:
    from scipy.special import ndtr

    corners = p[:8].reshape(4, 2)
    z = _distances(x, y, corners) / np.exp(p[8:10])[[0, 1, 0, 1]][:, None]
    outside = ndtr(-z)
    bright = outside.sum(axis=0)
    way = np.roll(corners, -1, axis=0) - corners
    way = way / np.linalg.norm(way, axis=1, keepdims=True)
    for i in range(4):  # two sides that meet: their distances are jointly normal
        r = 0.5 * (way[i] @ way[i - 1]) * (_NODES + 1)
        bright = bright - outside[i - 1] * outside[i]
        near = np.maximum(np.abs(z[i - 1]), np.abs(z[i])) < 6
        h, k = z[i - 1][near, None], z[i][near, None]
        density = np.exp(-0.5 * (h * h + k * k - 2 * r * h * k) / (1 - r * r)) / (2 * np.pi * np.sqrt(1 - r * r))
        bright[near] -= density @ (0.5 * (way[i] @ way[i - 1]) * _WEIGHTS)
    dark, paper = levels_dn
    return (dark + (paper - dark) * bright) * (1 + p[10] * (x - middle[0]) + p[11] * (y - middle[1]))
