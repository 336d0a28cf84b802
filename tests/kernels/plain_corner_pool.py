"""How the fits of one image become one estimate, stated plainly in NumPy (``corner_pool.hpp`` has the reasons)."""

from __future__ import annotations

import numpy as np

MIN_CORNERS_TO_POOL, LEAST_SLOPE_SPREAD, NOISE_SPREAD, MAX_MISFIT = 12, 2e-5, 1.3, 0.1
FAR_SLOPE, CHANCE, PIXELS_PER_CELL = 3.0, 8.0, 15.0
LEAST_LONG, MOST_LONG, OFF_LINE, LEAST_APART_PX, ROUNDING = 0.4, 16.0, 0.3, 2.5, 1 / 12
MOST_CROSSING = 0.3


def pool(fits):
    """Points, covariances, sums of cross-covariances, misfits and noise."""
    is_fitted = np.isfinite(fits.points_px[:, 0])
    noise2 = max(float(np.median(fits.odd_variance[is_fitted])), 1 / 12) if is_fitted.any() else np.nan
    misfit = fits.odd_variance / noise2
    is_fitted &= ~(np.sqrt(np.maximum(fits.odd_variance - noise2, 0)) > MAX_MISFIT * np.abs(fits.contrast_dn))
    scale = coherence(fits.long_variance[is_fitted & (misfit < 2)], noise2) * noise2
    joint = fits.joint_covariance * (scale * np.maximum(1, misfit / NOISE_SPREAD))[:, None, None]
    points, covariance = share_slope(fits.points_px, fits.light_slope, joint, is_fitted & (misfit < 2))
    coherent = misfit - 1 - CHANCE / np.sqrt(np.maximum(fits.n_pixels, 1))
    growth = (1 + np.maximum(coherent, 0) * fits.n_pixels / PIXELS_PER_CELL) / np.maximum(1, misfit / NOISE_SPREAD)
    covariance *= np.maximum(growth, 1)[:, None, None]
    points[~is_fitted] = np.nan
    cross = cross_covariance(points, covariance, fits)
    covariance += sampling_covariance(fits)
    covariance[~is_fitted] = cross[~is_fitted] = np.nan
    return points, covariance, cross, misfit, np.sqrt(noise2)


def coherence(long_variance, noise2):
    """Variance of the noise as it moves corners over that of the pixels' noise."""
    ratios = long_variance[np.isfinite(long_variance)] / noise2
    if len(ratios) < 8:
        return 1.0
    off, chance2 = ratios.mean() - 1, ratios.var() / (len(ratios) - 1)
    shrunk = 1 + max(0.0, 1 - chance2 / off**2) * off
    return max(np.clip(shrunk, LEAST_LONG, MOST_LONG), ROUNDING / noise2)


def cross_covariance(points, covariance, fits):
    """Each corner's covariances with the others on its edges, summed: the parts of the edges that both discs hold."""
    n, radius = len(points), fits.radius_px
    normals = np.stack([-np.sin(fits.edges_rad), np.cos(fits.edges_rad)], axis=-1)
    sigma = np.sqrt(np.einsum("nki,nij,nkj->nk", normals, covariance, normals))
    length = 2 * (radius - np.minimum(1.13 * fits.blur_px.mean(axis=1), MOST_CROSSING * radius))
    sums = np.zeros((n, 2))
    for i in range(n):
        for j in range(n):
            way = points[j] - points[i]
            apart = np.hypot(*way)
            shared = min(radius[i] + radius[j] - apart, 2 * min(radius[i], radius[j]))
            if i == j or not shared > 0 or apart < LEAST_APART_PX:
                continue
            for k in (0, 1):
                for m in (0, 1):
                    if max(abs(normals[i, k] @ way), abs(normals[j, m] @ way)) <= OFF_LINE * apart:
                        sums[i, k] += shared / np.sqrt(length[i] * length[j]) * sigma[i, k] * sigma[j, m]
    back = np.linalg.inv(np.where(np.isfinite(normals), normals, np.eye(2)))
    return np.einsum("nik,nk,njk->nij", back, sums, back)


def sampling_covariance(fits):
    """Covariance of the bias that pixels leave which are coarser than the edge is blurred, px^2."""
    slant = np.abs(np.sin(2 * fits.edges_rad)) / 2  # of the angle to the nearer of the pixels' axes, nearly
    crossed = 1 + (2 * fits.radius_px[:, None] * slant) ** 2
    bias = np.minimum(0.038 * np.exp(-12.5 * (fits.blur_px - 0.29)), 0.05) / crossed
    normals = np.stack([-np.sin(fits.edges_rad), np.cos(fits.edges_rad)], axis=-1)
    return np.einsum("nk,nki,nkj->nij", bias**2, normals, normals)


def share_slope(points, slope, joint, is_sound):
    """Positions given what the other corners say about the light's slope (relative, per px)."""
    points, covariance = points.copy(), joint[:, :2, :2].copy()
    if is_sound.sum() < MIN_CORNERS_TO_POOL:
        return points, covariance
    basis = np.column_stack([points - np.mean(points[is_sound], axis=0), np.ones(len(points))])
    basis[:, :2] /= np.std(points[is_sound])
    spread2 = LEAST_SLOPE_SPREAD**2
    predicted, of_prediction = slope.copy(), np.zeros_like(slope)
    for axis in (0, 1):
        own = joint[is_sound, 2 + axis, 2 + axis]
        X, y = basis[is_sound], slope[is_sound, axis]
        for _ in range(3):
            w = 1 / (own + spread2)
            inverse = np.linalg.inv(X.T @ (w[:, None] * X))
            coefficients = inverse @ (X.T @ (w * y))
            scatter = 1.4826 * np.median(np.abs(y - X @ coefficients) * np.sqrt(w))
            if scatter < 1.1:
                break
            spread2 = (scatter**2 - 1) * float(np.median(own + spread2)) + spread2
        predicted[:, axis] = basis @ coefficients
        of_prediction[:, axis] = np.einsum("ni,ij,nj->n", basis, inverse, basis)
    ok, off = is_sound, predicted - slope
    total = joint[:, 2:, 2:].copy()  # of the two slopes' distance from what the others say
    for axis in (0, 1):
        own = total[:, axis, axis] + of_prediction[:, axis] + spread2
        total[:, axis, axis] = np.maximum(own, (off[:, axis] / FAR_SLOPE) ** 2)
    gain = joint[ok, :2, 2:] @ np.linalg.inv(total[ok])
    points[ok] += np.einsum("nij,nj->ni", gain, off[ok])
    covariance[ok] -= gain @ joint[ok, 2:, :2]
    return points, covariance
