"""The corner model of corner_fit.hpp stated plainly: bivariate normal probabilities and numerical derivatives."""

import numpy as np
from scipy.optimize import least_squares
from scipy.special import erf
from scipy.stats import norm


def saddle(d1, d2, rho):
    """E[sign(d1 + z1) sign(d2 + z2)] for standard normals of correlation rho, by 40-point quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    arc = np.arcsin(rho)
    value = erf(d1 / np.sqrt(2)) * erf(d2 / np.sqrt(2))
    for t, w in zip(arc * (nodes + 1) / 2, arc * weights / 2, strict=True):
        value = value + 2 / np.pi * w * np.exp(-(d1**2 + d2**2 - 2 * d1 * d2 * np.sin(t)) / (2 * np.cos(t) ** 2))
    return value


def grey_values(p, u, v):
    """Of pixels (u, v). ``p``: x, y, two angles, two log blurs, offset, half contrast, two slopes, tone."""
    x, y, t1, t2, l1, l2, a, b, gx, gy, q = p
    du, dv = u - x, v - y
    d1 = (-np.sin(t1) * du + np.cos(t1) * dv) / np.exp(l1)
    d2 = (-np.sin(t2) * du + np.cos(t2) * dv) / np.exp(l2)
    F = saddle(d1, d2, np.cos(t1 - t2))
    return (a + b * (F + q * (1 - F**2))) * (1 + gx * du + gy * dv)


def clipped_greys(greys, noise, bottom, top):
    """What to expect of grey values whose normal noise is clipped with them at both ends of the range."""
    a, b = (bottom - greys) / noise, (top - greys) / noise
    inside = greys * (norm.cdf(b) - norm.cdf(a)) - noise * (norm.pdf(b) - norm.pdf(a))
    return bottom * norm.cdf(a) + inside + top * norm.sf(b)


def disc(image, x, y, radius):
    """Pixels, grey values and weights of a disc whose edge is one pixel wide."""
    v, u = np.mgrid[: image.shape[0], : image.shape[1]].astype(float)
    weight = np.clip(radius + 0.5 - np.hypot(u - x, v - y), 0, 1)
    used = weight > 0
    return u[used], v[used], image[used].astype(float), weight[used]


def refit(image, start, radius, n_rounds=3, clipping=None, tone_spread=0.15):
    """The weighted least-squares estimate by SciPy, with the kernel's weak priors, and the position's inverse information.

    ``clipping``: noise, bottom and top of grey values that are clipped.
    """
    model = grey_values if clipping is None else lambda p, u, v: clipped_greys(grey_values(p, u, v), *clipping)
    p = np.array(start, dtype=float)
    for _ in range(n_rounds):
        u, v, value, weight = disc(image, p[0], p[1], radius)
        noise = (
            np.sqrt((weight * (value - model(p, u, v)) ** 2).sum() / weight.sum()) if clipping is None else clipping[0]
        )

        def residuals(p, u=u, v=v, value=value, weight=weight, noise=noise):
            data = np.sqrt(weight) * (value - model(p, u, v))
            return np.r_[data, noise / 0.3 * (p[4] - p[5]), noise / tone_spread * p[10]]

        fit = least_squares(residuals, p, jac="3-point", x_scale=np.maximum(np.abs(p), 1e-3), xtol=1e-12, ftol=1e-14)
        p = fit.x
    return p, np.linalg.inv(fit.jac.T @ fit.jac)[:2, :2]
