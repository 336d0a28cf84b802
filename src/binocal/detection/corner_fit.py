"""Corners by a maximum-likelihood fit of a blurred saddle to the raw picture, each with its covariance.

The model and the fit are :mod:`binocal.native`'s (``corner_fit.hpp`` states them). Here the fits of one picture are made
one estimate: they share the pixels' noise, and the light's slope, which is smooth across a board.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray

from binocal import native

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

MIN_CORNERS_TO_POOL = 12  # below it a fit of the light's slope to position (3 numbers an axis) gains nothing
LEAST_SLOPE_SPREAD = 2e-5  # 1/px; what paper and lens do on a board's scale even in even light
NOISE_SPREAD = 1.3  # noise variance over the picture's median that dark and bright pixels, or JPEG, explain
MAX_MISFIT = 0.1  # of the contrast: odd residuals beyond it are an occlusion or a glare, not a corner


@dataclass(frozen=True, slots=True, eq=False)
class FittedCorners:
    """Corners and covariances, NaN where no saddle could be fitted.

    ``misfit`` is the variance of the residuals' odd part over the picture's noise: 1 where the model holds.
    ``blur_px`` are the two edges' blurs (Gaussian sigma, pixel integration taken out), ``contrast_dn`` bright minus dark.
    """

    points_px: Float[ndarray, "n 2"]
    covariance_px2: Float[ndarray, "n 2 2"]
    noise_dn: float
    misfit: Float[ndarray, "n"]
    blur_px: Float[ndarray, "n 2"]
    contrast_dn: Float[ndarray, "n"]


def fit_corners(
    grey: ndarray,
    points_px: Float[ndarray, "n 2"],
    reach_px: Float[ndarray, "n"],
    strip_px: Float[ndarray, "n"] | None = None,
    *,
    board_xy: Float[ndarray, "n 2"] | None = None,
) -> FittedCorners:
    """Fit the corner model around each point of a picture (h, w), uint8, uint16 or float32.

    ``reach_px`` is the distance to the nearest edge that is not the corner's own: the fit takes a disc of 0.85 of it, at
    most 14 px and at least 2.5, less where the blur carries that edge in. ``strip_px`` limits it to bands along the
    corner's edges, where squares are not plain. Starts must lie within half the reach (at least 1.5 px); a corner that
    has no room inside the picture, or shows no saddle, is NaN. With the corners' places on the board, whose axes its
    edges follow, the lens's bending of the edges is taken out.
    """
    points_px = np.asarray(points_px, dtype=float)
    strip = np.full(len(points_px), np.inf) if strip_px is None else strip_px
    fits = native.fit_corners(grey, points_px, reach_px, strip)
    contrast = np.abs(fits.contrast_dn)
    is_fitted = np.isfinite(fits.points_px[:, 0])
    noise2 = (
        max(float(np.median(fits.odd_variance[is_fitted])), 1 / 12) if is_fitted.any() else np.nan
    )  # 1/12: rounding
    misfit = fits.odd_variance / noise2
    is_fitted &= ~(np.sqrt(np.maximum(fits.odd_variance - noise2, 0)) > MAX_MISFIT * contrast)
    joint = fits.joint_covariance * (noise2 * np.maximum(1, misfit / NOISE_SPREAD))[:, None, None]
    points, covariance = _share_slope(fits.points_px, fits.light_slope, joint, is_fitted & (misfit < 2))
    if board_xy is not None:
        points -= _bending_shift(board_xy, points, fits, is_fitted & (misfit < 2))
    covariance += _sampling_covariance(fits)
    points[~is_fitted] = np.nan
    covariance[~is_fitted] = np.nan
    blur = np.sqrt(np.maximum(fits.blur_px**2 - 1 / 12, 0))
    return FittedCorners(points, covariance, float(np.sqrt(noise2)), misfit, blur, contrast)


def _bending_shift(
    board_xy: Float[ndarray, "n 2"],
    points: Float[ndarray, "n 2"],
    fits: native.CornerFits,
    is_sound: Bool[ndarray, "n"],
) -> Float[ndarray, "n 2"]:
    """How far straight edges fitted to bent ones lie from the corner, pixels: up to 0.002 px in an ordinary lens.

    An edge of curvature k lies k t^2 / 2 from its tangent at t px from the corner; the fit takes the mean over its reach.
    The curvature along the board's axes follows from a polynomial of the picture in the board's coordinates.
    """
    n = int(is_sound.sum())
    degree = 4 if n >= 40 else 3 if n >= 24 else 2 if n >= 12 else 0
    if not degree:
        return np.zeros_like(points)
    xy = (board_xy - board_xy[is_sound].mean(axis=0)) / np.abs(board_xy - board_xy[is_sound].mean(axis=0)).max()
    powers = [(i, k - i) for k in range(degree + 1) for i in range(k + 1)]

    def basis(dx: int, dy: int) -> ndarray:
        """Derivatives of the polynomial's terms, ``dx`` times along x and ``dy`` times along y."""
        columns = []
        for i, j in powers:
            factor = np.prod([i - k for k in range(dx)]) * np.prod([j - k for k in range(dy)])
            columns.append(factor * xy[:, 0] ** max(i - dx, 0) * xy[:, 1] ** max(j - dy, 0))
        return np.stack(columns, axis=-1)

    coefficients = np.linalg.lstsq(basis(0, 0)[is_sound], points[is_sound], rcond=None)[0]
    blur = fits.blur_px.mean(axis=1)
    mean_t2 = (
        fits.radius_px**2 / 3 / np.maximum(1 - 1.13 * blur / fits.radius_px, 0.3)
    )  # the blurred crossing tells little
    normals, offsets = [], []
    for along, twice in (((1, 0), (2, 0)), ((0, 1), (0, 2))):
        tangent, second = basis(*along) @ coefficients, basis(*twice) @ coefficients
        length2 = np.maximum((tangent**2).sum(axis=1), 1e-12)
        normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1) / np.sqrt(length2)[:, None]
        normals.append(normal)
        offsets.append(0.5 * (normal * second).sum(axis=1) / length2 * mean_t2)
    (a, b), (c, d) = (normals[0].T, normals[1].T)
    determinant = a * d - b * c
    determinant = np.where(np.abs(determinant) > 0.1, determinant, np.nan)
    shift = np.stack([d * offsets[0] - b * offsets[1], a * offsets[1] - c * offsets[0]], axis=-1) / determinant[:, None]
    return np.nan_to_num(shift)


def _sampling_covariance(fits: native.CornerFits) -> Float[ndarray, "n 2 2"]:
    """Covariance of the bias that pixels leave which are coarser than the edge is blurred, px^2.

    Without blur an edge along the pixels' rows changes one grey value only, and how much the pixel's shape is not a
    Gaussian's: measured on rendered boards parallel to the rows, .038, .022, .0074, .0028 px at blurs (pixel integration
    included) of .295, .347, .42, .50. An edge that crosses a row within the disc averages it away.
    """
    slant = np.abs(np.sin(2 * fits.edges_rad)) / 2  # of the angle to the nearer of the pixels' axes, nearly
    crossed = 1 + (2 * fits.radius_px[:, None] * slant) ** 2
    bias = np.minimum(0.038 * np.exp(-12.5 * (fits.blur_px - 0.29)), 0.05) / crossed
    normals = np.stack([-np.sin(fits.edges_rad), np.cos(fits.edges_rad)], axis=-1)
    return np.einsum("nk,nki,nkj->nij", bias**2, normals, normals)


def _share_slope(
    points: Float[ndarray, "n 2"],
    slope: Float[ndarray, "n 2"],
    joint: Float[ndarray, "n 4 4"],
    is_sound: Bool[ndarray, "n"],
) -> tuple[Float[ndarray, "n 2"], Float[ndarray, "n 2 2"]]:
    """Positions given what the other corners say about the light's slope (relative, per px).

    A slope of the light is correlated with the position (at a blur of 3 px it costs the corner a factor 1.4), and is
    linear in the picture on a board's scale. The conditional mean and covariance of a Gaussian do the rest. The slopes'
    scatter beyond their own covariance, which shadows and glare raise, widens the prediction.
    """
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
    ok = np.isfinite(points[:, 0])
    prior = np.zeros((len(points), 2, 2))
    prior[:, [0, 1], [0, 1]] = of_prediction + spread2
    gain = joint[ok, :2, 2:] @ np.linalg.inv(joint[ok, 2:, 2:] + prior[ok])
    points[ok] += np.einsum("nij,nj->ni", gain, predicted[ok] - slope[ok])
    covariance[ok] -= gain @ joint[ok, 2:, :2]
    return points, covariance
