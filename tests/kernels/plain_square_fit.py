"""The square fit's model, stated plainly in NumPy and SciPy (``square_fit.hpp`` has the reasons)."""

import numpy as np
from scipy.optimize import least_squares
from scipy.special import ndtr


def edges_of(corners):
    """Clockwise corners (4, 2) as seen: starts, directions and lengths of the edges."""
    ways = np.roll(corners, -1, axis=0) - corners
    length = np.linalg.norm(ways, axis=1)
    return corners, ways / length[:, None], length


def distances(corners, bows, u, v):
    """Inward distance of each pixel from each edge, (4, ...)."""
    starts, ways, length = edges_of(corners)
    found = []
    for start, t, size, bow in zip(starts, ways, length, bows, strict=True):
        x, y = u - start[0], v - start[1]
        along = np.clip((t[0] * x + t[1] * y) / size, -0.5, 1.5)
        inward = along * (1 - along)
        slope = (1 - 2 * along) * np.polyval(bow[::-1], along) + inward * (bow[1] + 2 * bow[2] * along)
        off = t[0] * y - t[1] * x - inward * np.polyval(bow[::-1], along)
        found.append(off * (1 - 0.5 * (slope / size) ** 2))
    return np.array(found)


def beyond_product(h, k, rho):
    """What the joint normal distribution of two values has beyond the product of its margins: its integral over the correlation."""
    node, weight = np.polynomial.legendre.leggauss(24)
    r = 0.5 * rho * (node + 1)
    squares, product = (h * h + k * k)[..., None], (h * k)[..., None]
    density = np.exp(-0.5 * (squares - 2 * r * product) / (1 - r * r)) / (2 * np.pi * np.sqrt(1 - r * r))
    return density @ (0.5 * rho * weight)


def grey_values(p, u, v, bows=None):
    """``p``: four corners (8), two log blurs, level, half contrast, the light's slope (2) about the origin of u and v."""
    corners, bows = np.reshape(p[:8], (4, 2)), np.zeros((4, 3)) if bows is None else bows
    z = distances(corners, bows, u, v) / np.exp(p[8:10])[[0, 1, 0, 1]].reshape(4, *np.ones(u.ndim, int))
    outside = ndtr(-z)
    F = 1 - outside.sum(axis=0)
    _, ways, length = edges_of(corners)
    inward = np.stack([-ways[:, 1], ways[:, 0]], axis=-1)
    for i in range(4):  # two edges that meet: both outside, jointly, as their tangents there are
        begins = ways[i] + bows[i, 0] / length[i] * inward[i]
        ends = ways[i - 1] - bows[i - 1].sum() / length[i - 1] * inward[i - 1]
        rho = begins @ ends / np.linalg.norm(begins) / np.linalg.norm(ends)
        F = F + outside[i - 1] * outside[i] + beyond_product(z[i - 1], z[i], rho)
    return (p[10] + p[11] * (2 * F - 1)) * (1 + p[12] * u + p[13] * v)


def refit(image, start, reach, bows=None):
    """Minimum over the pixels within ``reach`` of the outline, and the covariance of its corners for a noise of one grey level."""
    v, u = np.mgrid[: image.shape[0], : image.shape[1]].astype(float)
    p = np.asarray(start, float)
    d = distances(np.reshape(p[:8], (4, 2)), np.zeros((4, 3)) if bows is None else bows, u, v)
    taken = (d.min(axis=0) > -reach) & (d.min(axis=0) < reach)
    u, v, values = u[taken], v[taken], image[taken]
    scale = np.array([*np.ones(10), 100, 100, 1e-3, 1e-3])
    fit = least_squares(
        lambda z: grey_values(z * scale, u, v, bows) - values, p / scale, xtol=1e-10, ftol=1e-12, gtol=1e-10
    )
    inverse = np.linalg.inv(fit.jac.T @ fit.jac)[:8, :8]
    return fit.x * scale, inverse
