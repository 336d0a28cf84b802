"""The ellipse fit's model, stated plainly in NumPy (``ellipse_fit.hpp`` has the reasons)."""

import numpy as np
from scipy.optimize import least_squares
from scipy.special import erf


def shape_of(axes, angle):
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, -s], [s, c]])
    return R @ np.diag(1 / np.square(axes)) @ R.T


def grey_values(p, u, v):
    """``p``: centre (2), shape matrix (xx, xy, yy), log blur, level, half contrast, light's slope (2)."""
    x, y = u - p[0], v - p[1]
    wx, wy = p[2] * x + p[3] * y, p[3] * x + p[4] * y
    q = x * wx + y * wy
    distance = (q - np.sqrt(q)) / np.maximum(np.hypot(wx, wy), 1e-9)
    edge = erf(distance / np.exp(p[5]) / np.sqrt(2))
    return (p[6] + p[7] * edge) * (1 + p[8] * x + p[9] * y)


def refit(image, start, reach):
    """Minimum over the pixels within ``reach`` of the outline, and the covariance of its centre for a noise of one grey level."""
    v, u = np.mgrid[: image.shape[0], : image.shape[1]].astype(float)
    p = np.asarray(start, float)
    M = np.array([[p[2], p[3]], [p[3], p[4]]])
    values, vectors = np.linalg.eigh(M)
    axes = 1 / np.sqrt(values)
    along = np.stack([u - p[0], v - p[1]], axis=-1) @ vectors

    def inside(grow):
        return np.square(along / (axes + grow)).sum(axis=-1) < 1

    taken = inside(reach) & ~(inside(-reach) if axes.min() - reach > 0.5 else np.zeros_like(u, bool))
    scale = np.array([1, 1, *(3 * [values.mean()]), 1, 100, 100, 1e-3, 1e-3])
    fit = least_squares(
        lambda z: grey_values(z * scale, u[taken], v[taken]) - image[taken],
        p / scale,
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
    )
    inverse = np.linalg.inv(fit.jac.T @ fit.jac)[:2, :2]
    return fit.x * scale, inverse
