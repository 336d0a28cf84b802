"""What the pixels about a spot's outline allow at best."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.shapes import Float

BAND_PX = 5.6


def ellipse_bound(
    outline_px: Float[ndarray, "k 2"],
    *,
    blur_px: float,
    noise_dn: float,
    gap_px: float,
    most_dn: float = np.inf,
    levels_dn: tuple[float, float] = (30.0, 210.0),
) -> Float[ndarray, "2 2"]:
    """Least covariance of an unbiased estimate of a spot's centre, px^2 (Cramér-Rao).

    ``outline_px`` are points around its true outline, evenly spread on the printed circle; ``blur_px`` is the Gaussian's
    sigma with pixel integration included; ``gap_px`` the distance to the nearest other outline, half of which is the
    spot's; ``levels_dn`` are the grey levels inside and outside. Ten parameters: centre, the outline's shape (3), blur,
    offset, contrast and the light's two slopes. The pixels' noise is independent; those of the noiseless image beyond
    ``most_dn`` (clipped) say nothing.
    """
    centre = outline_px.mean(axis=0)
    # The even points of a circle, projected, have half the squared half-axes for their covariance.
    shape = np.linalg.inv(2 * np.cov((outline_px - centre).T, bias=True))
    axes = 1 / np.sqrt(np.linalg.eigvalsh(shape))
    outward = min(max(BAND_PX, 3 * blur_px + 2), 0.5 * gap_px)
    reach = int(np.ceil(axes.max() + outward)) + 1
    middle = np.rint(centre)
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1] + middle[::-1, None, None]
    first = np.array([*centre, shape[0, 0], shape[0, 1], shape[1, 1], np.log(blur_px), 0.0, 0.0])
    distance = _distance(x, y, first)
    inside = (distance < outward) & (distance > -max(BAND_PX, 3 * blur_px + 2))
    x, y = x[inside], y[inside]
    grey = _grey(x, y, first, levels_dn)
    x, y = x[grey < most_dn], y[grey < most_dn]
    steps = np.array([1e-4, 1e-4, *(1e-4 * np.trace(shape) * np.ones(3)), 1e-4, 1e-6, 1e-6])
    columns = [
        (_grey(x, y, first + step, levels_dn) - _grey(x, y, first - step, levels_dn)) / (2 * step.sum())
        for step in np.diag(steps)
    ]
    edge = _grey(x, y, first, (0.0, 1.0))
    J = np.stack([*columns, np.ones_like(x, dtype=float), edge])
    scale = np.linalg.norm(J, axis=1)
    J = J / scale[:, None]
    covariance = noise_dn**2 * np.linalg.inv(J @ J.T)[:2, :2]
    return covariance / np.outer(scale[:2], scale[:2])


def _distance(x: ndarray, y: ndarray, p: Float[ndarray, "8"]) -> ndarray:
    u, v = x - p[0], y - p[1]
    wx, wy = p[2] * u + p[3] * v, p[3] * u + p[4] * v
    q = np.maximum(u * wx + v * wy, 1e-4)
    return (q - np.sqrt(q)) / np.maximum(np.hypot(wx, wy), 1e-9)


def _grey(x: ndarray, y: ndarray, p: Float[ndarray, "8"], levels_dn: tuple[float, float]) -> ndarray:
    from scipy.special import ndtr

    dark, bright = levels_dn
    print_dn = dark + (bright - dark) * ndtr(_distance(x, y, p) / np.exp(p[5]))
    return print_dn * (1 + p[6] * (x - p[0]) + p[7] * (y - p[1]))
