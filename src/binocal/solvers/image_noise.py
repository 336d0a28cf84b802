"""How noisy the corners of each image are: what a smooth map leaves of its residuals.

Blur, light and distance make corners of one image ten times noisier than those of another. Weighed alike, the noisy ones decide.
What is alike in an image (an unsynchronised pair, a bent board, a lens not yet found) is no noise: a polynomial takes it out, so
that the noise can be told after a few steps of the solve, and a view that contradicts the others does not pass for a noisy one.
A set in which images are alike is left as it is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.evidence import Detections
from binocal.shapes import Bool, Float, Int
from binocal.solvers import robust
from binocal.solvers.board_views import BundleEstimate, BundleProblem

DEGREE = 2  # of the polynomial
CORNERS_PER_COEFFICIENT = 1.5  # of which there are six; an image of fewer corners says nothing
TRIMMED = 3.5  # sigmas, a corner's distance
SURE_SIGMAS = 4.0  # by which the scatter of the images' noise must exceed chance
LEAST_SPREAD = 0.4  # of the logarithm of the noise: less costs less than 15 % of the precision
MIN_IMAGES = 6


@dataclass(frozen=True, slots=True, eq=False)
class ImageNoise:
    """Noise of one corner coordinate in each image, left then right, NaN where there are too few corners; degrees of freedom."""

    sigma_px: Float[ndarray, "2 views"]
    freedom: Float[ndarray, "2 views"]


def shrink(sigma: Float[ndarray, "*images"], freedom: Float[ndarray, "*images"]) -> Float[ndarray, "*images"] | None:
    """Each image's noise, drawn towards the typical one as far as chance explains it; None where they are all alike."""
    known = np.isfinite(sigma)
    if known.sum() < MIN_IMAGES:
        return None
    logs = np.log(np.maximum(sigma[known], robust.SCALE_FLOOR_PX))
    chance = 1 / (2 * freedom[known])  # variance of the logarithm of a standard deviation
    weights = 1 / chance
    mean = float(weights @ logs / weights.sum())
    excess = float(weights @ (logs - mean) ** 2) - (len(logs) - 1)
    spread2 = excess / float(weights.sum() - (weights**2).sum() / weights.sum())
    if excess < SURE_SIGMAS * np.sqrt(2 * (len(logs) - 1)) or spread2 < LEAST_SPREAD**2:
        return None
    weights = 1 / (chance + spread2)
    mean = float(weights @ logs / weights.sum())
    out = np.full(sigma.shape, np.nan)
    out[known] = np.exp(mean + spread2 / (spread2 + chance) * (logs - mean))
    return out


def with_image_noise(
    detections: Detections, problem: BundleProblem, estimate: BundleEstimate, r2_px2: tuple[ndarray, ...]
) -> Detections:
    """The detections with the noise of their images for covariances, where images differ; themselves where not.

    ``problem`` holds their corners, all weighed alike, ``r2_px2`` the squared residual lengths at the estimate.
    """
    if detections.has_covariances or _all_alike(problem, r2_px2):
        return detections
    noise = estimate_image_noise(problem, estimate)
    sigma_px = shrink(noise.sigma_px, noise.freedom)
    if sigma_px is None:
        return detections
    n = len(detections.object_points_m)
    left, right = (np.repeat(s2[:, None, None, None] * np.eye(2), n, axis=1) for s2 in sigma_px**2)
    return replace(detections, left_covariance_px2=left, right_covariance_px2=right)


def _all_alike(problem: BundleProblem, r2_px2: tuple[ndarray, ...]) -> bool:
    """Whether the images' mean squares differ by no more than noise that is all alike would make them."""
    counts = np.concatenate([c.is_seen.sum(axis=-1) for c in problem.cameras])
    totals = np.concatenate([np.where(np.isfinite(r2), r2, 0.0).sum(axis=-1) for r2 in r2_px2])
    known = (counts >= _least_corners()) & (totals > 0)
    return shrink(np.sqrt(totals[known] / (2 * counts[known])), 2.0 * counts[known]) is None


def estimate_image_noise(problem: BundleProblem, estimate: BundleEstimate) -> ImageNoise:
    """See the module; corners far off do not count."""
    sigma, freedom = [], []
    for camera, parameters, T in zip(problem.cameras, estimate.parameters, problem.camera_poses(estimate), strict=True):
        X, Y, Z = np.moveaxis(T.R @ problem.object_points + T.t[..., None], -2, 0)
        with np.errstate(all="ignore"):
            predicted = np.stack(camera.model.project(parameters, X, Y, Z), axis=-1)
        is_seen = camera.is_seen & np.isfinite(predicted).all(axis=-1)
        residuals = np.where(is_seen[..., None], camera.pixels.swapaxes(-1, -2) - predicted, 0.0)
        found = _left_by_polynomials(np.where(is_seen[..., None], predicted, 0.0), residuals, is_seen)
        sigma.append(found[0])
        freedom.append(found[1])
    return ImageNoise(np.stack(sigma), np.stack(freedom))


def _least_corners() -> float:
    return CORNERS_PER_COEFFICIENT * (DEGREE + 1) * (DEGREE + 2) / 2


def _left_by_polynomials(
    points: Float[ndarray, "images n 2"], residuals: Float[ndarray, "images n 2"], is_seen: Bool[ndarray, "images n"]
) -> tuple[Float[ndarray, "images"], Float[ndarray, "images"]]:
    """RMS of what polynomials leave of the residuals, and its degrees of freedom; corners far off are cut once."""
    weights = is_seen.astype(float)
    columns = _monomials(points, weights)
    n_columns = columns.shape[-1]
    left = residuals
    for _ in range(2):
        weighted = columns * weights[..., None]
        gram = columns.swapaxes(1, 2) @ weighted
        gram += (1e-9 + 1e-9 * np.trace(gram, axis1=1, axis2=2))[:, None, None] * np.eye(n_columns)
        left = residuals - columns @ np.linalg.solve(gram, weighted.swapaxes(1, 2) @ residuals)
        squares = np.vecdot(left, left)
        kept = weights * (squares < TRIMMED**2 * _typical2(squares, weights, n_columns)[:, None])
        if (kept == weights).all():
            break
        weights = kept
    counts = weights.sum(axis=1)
    is_enough = counts >= _least_corners()
    freedom = np.where(is_enough, 2 * (counts - n_columns), 0.0)
    sigma = np.sqrt((weights * np.vecdot(left, left)).sum(axis=1) / np.where(is_enough, freedom, np.nan))
    return sigma, freedom


def _typical2(
    squares: Float[ndarray, "images n"], weights: Float[ndarray, "images n"], n_columns: int
) -> Float[ndarray, "images"]:
    """Squared noise by each image's median, counted for what was fitted; infinite where nothing is left over."""
    counts = weights.sum(axis=1)
    ordered = np.sort(np.where(weights > 0, squares, np.inf), axis=1)
    middle: Int[ndarray, "images"] = np.maximum(counts.astype(int) - 1, 0) // 2
    median = np.take_along_axis(ordered, middle[:, None], axis=1)[:, 0]
    left_over = counts - n_columns
    with np.errstate(all="ignore"):
        typical2 = median / robust.MEDIAN_OF_RAYLEIGH**2 * counts / left_over
    return np.where((left_over > 0) & np.isfinite(typical2), typical2, np.inf)


def _monomials(
    points: Float[ndarray, "images n 2"], weights: Float[ndarray, "images n"]
) -> Float[ndarray, "images n c"]:
    """Products of powers up to the degree, of points centred and scaled to the seen ones."""
    total = np.maximum(weights.sum(axis=1), 1.0)[:, None, None]
    centred = points - (weights[..., None] * points).sum(axis=1, keepdims=True) / total
    reach = np.sqrt((weights[..., None] * centred**2).sum(axis=1, keepdims=True) / total)
    x, y = np.moveaxis(centred / np.maximum(reach, 1e-9), -1, 0)
    powers = [(np.ones_like(x), np.ones_like(y))]
    for _ in range(DEGREE):
        powers.append((powers[-1][0] * x, powers[-1][1] * y))
    columns = [powers[i][0] * powers[j][1] for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
    return np.where(weights[..., None] > 0, np.stack(columns, axis=-1), 0.0)
