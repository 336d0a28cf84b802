"""Sub-pixel corners in windows that never reach a neighbouring corner, and how far they can be trusted."""

from __future__ import annotations

import cv2
import numpy as np
from numpy import ndarray

from binocal.detection.measuring.corner_fit import fit_corners
from binocal.kernels.corner_fits import BoardPlaces
from binocal.shapes import Bool, Float, Int

_STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 1e-3)
WINDOW_PER_SPACING = 0.38  # half-width; the window's diagonal then ends at 0.54 of the way to the nearest corner
LEAST_HALF_WINDOW_PX = 2
LARGEST_HALF_WINDOW_PX = 11  # beyond it lens curvature costs more than the additional edge length gains

EFFICIENCY_LOSS = (
    3.0  # cornerSubPix over the bound; 2.6 to 3.7 on simulated corners with blur 0.6 to 1.5 px, noise 1 to 5
)
FLOOR_PX = 0.015  # its bias on exact corners
# What cornerSubPix is off by where paper saturates by far, and the dark squares lie apart: 0.03 to 0.08 px on rendered boards, exposed
# 2 to 6 times too long, with blurs of 0.6 to 1.5 px. The corner fit knows of it (corner_fit.hpp).
BURNT_OUT_PX = 0.06
BURNT_OUT_SHARE = 0.2  # of a corner's window at the top of the range, for it to be so

# Of an image's corners beside markers, that the model must fail for cornerSubPix to be asked: on rendered boards the single ones
# it failed, 1 to 10 %, were off by 0.2 to 2.3 px; where a camera's sharpening defeats it, it fails 8 to 70 %.
LEAST_UNFITTED_SHARE = 0.12


def measure_corners(
    grey: ndarray,
    points_px: Float[ndarray, "n 2"],
    board: BoardPlaces,
    reach_px: Float[ndarray, "n"],
    strip_px: Float[ndarray, "n"] | None = None,
    *,
    per_reach: float = WINDOW_PER_SPACING,
    may_be_cut: bool = False,
) -> tuple[Float[ndarray, "n 2"], Float[ndarray, "n 2 2"], Float[ndarray, "n 2 2"]]:
    """Corners, covariances and cross-covariances by the maximum-likelihood fit, from starts within some pixels.

    The last are each corner's covariances with all others, summed (:class:`binocal.detection.measuring.corner_fit.FittedCorners`).

    See :func:`binocal.detection.measuring.corner_fit.fit_corners` for ``reach_px`` and ``strip_px``. Where no saddle can be fitted
    from the start it is tried again from cornerSubPix's corner, whose half-window is ``per_reach`` times the reach; where
    that fails too (squares hardly wider than the blur) cornerSubPix's corner is taken, with its own, larger, covariance;
    but not where ``strip_px`` bounds what is printed beside it and the paper is burnt out, which spreads one over the other, or
    where nearly all others of the image are fitted: what hides such a corner in part, a hand or a marker, moves cornerSubPix's too.
    So does the image's border, which cuts corners of boards that ``may_be_cut``: off by up to 13 px, with a sigma of 0.03.
    A corner whose surroundings contradict the model (covered, glare) is NaN.
    """
    fitted = fit_corners(grey, points_px, reach_px, strip_px, board=board)
    is_open = ~np.isfinite(fitted.misfit) & np.isfinite(points_px[:, 0]) & np.isfinite(reach_px)
    if not is_open.any():
        return fitted.points_px, fitted.covariance_px2, fitted.cross_covariance_px2
    rough = np.where(is_open[:, None], points_px, np.nan)
    again = refine_corners(grey, rough, reach_px, per_spacing=per_reach)
    start = np.where(np.isfinite(again), again, points_px)
    fitted = fit_corners(grey, start, reach_px, strip_px, board=board)
    points, covariance, cross = (
        a.copy() for a in (fitted.points_px, fitted.covariance_px2, fitted.cross_covariance_px2)
    )
    is_plain = np.isfinite(again[:, 0]) & ~np.isfinite(fitted.misfit)
    if strip_px is not None:
        is_plain &= ~_are_burnt_out(grey, again, reach_px, per_reach)
        # Its least window reaches into the markers of squares of 10 px: off by 0.2 to 0.9 px there, with a sigma of 0.08.
        is_plain &= ~(per_reach * reach_px < LEAST_HALF_WINDOW_PX)
    n_fitted = int(np.isfinite(fitted.misfit).sum())
    if (strip_px is not None or may_be_cut) and is_plain.sum() < LEAST_UNFITTED_SHARE * (is_plain.sum() + n_fitted):
        is_plain[:] = False
    if is_plain.any():
        points[is_plain] = again[is_plain]
        covariance[is_plain] = corner_covariance(grey, again, reach_px, per_spacing=per_reach)[is_plain]
        cross[is_plain] = 0.0  # its window ends half way to the next corner
    return points, covariance, cross


def refine_corners(
    grey: ndarray,
    points_px: Float[ndarray, "n 2"],
    spacing_px: Float[ndarray, "n"],
    *,
    per_spacing: float = WINDOW_PER_SPACING,
) -> Float[ndarray, "n 2"]:
    """Corners to sub-pixels: their window's gradients are orthogonal to the way from them (Förstner), by cornerSubPix.

    ``grey`` is (h, w), uint8, uint16 or float32. ``spacing_px`` is the distance to the nearest other corner. A corner
    that leaves its own window, or whose window leaves the image, is NaN.
    """
    if grey.dtype == np.uint16:
        grey = grey.astype(np.float32)
    points_px = np.asarray(points_px, dtype=float)
    refined = np.full(points_px.shape, np.nan)
    usable, half = _half_windows(points_px, spacing_px, per_spacing)
    height, width = grey.shape
    edge = np.minimum(points_px, np.array([width, height]) - 1 - points_px).min(axis=1)
    usable &= np.nan_to_num(edge, nan=-1) >= half + 1
    for size in np.unique(half[usable]):
        index = np.nonzero(usable & (half == size))[0]
        start = np.ascontiguousarray(points_px[index], dtype=np.float32).reshape(-1, 1, 2)
        end = cv2.cornerSubPix(grey, start.copy(), (int(size), int(size)), (-1, -1), _STOP).reshape(-1, 2).astype(float)
        moved = np.abs(end - points_px[index]).max(axis=1)
        # cornerSubPix returns the start itself where it fails to stay in its window.
        refined[index] = np.where(((moved > 0) & (moved <= max(size, 2)))[:, None], end, np.nan)
    return refined


def _half_windows(
    points_px: Float[ndarray, "n 2"], spacing_px: Float[ndarray, "n"], per_spacing: float
) -> tuple[Bool[ndarray, "n"], Int[ndarray, "n"]]:
    """Which points have a window, and half its width in pixels."""
    usable = np.isfinite(points_px[:, 0]) & np.isfinite(spacing_px)
    half = np.zeros(len(points_px), int)
    half[usable] = np.clip(np.floor(per_spacing * spacing_px[usable]), LEAST_HALF_WINDOW_PX, LARGEST_HALF_WINDOW_PX)
    return usable, half


def estimate_noise_dn(grey: ndarray) -> float:
    """Standard deviation of the pixel noise, grey levels, at least what rounding alone gives.

    Median absolute response of Immerkær's (1996) Laplacian difference mask, which is blind to shading and straight
    edges. What is clipped, at either end, shows no noise and has no say: it may be most of the image.
    """
    rows = max(1, grey.shape[0] // 240)
    band = grey.astype(np.float32)
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    response = cv2.filter2D(band, cv2.CV_32F, mask)[1:-1:rows, 1:-1:rows]
    least, most, _, _ = cv2.minMaxLoc(grey)
    inside = grey[1:-1:rows, 1:-1:rows]
    response = response[(inside > least) & (inside < most)]
    if response.size == 0:
        return 0.3
    return max(0.3, float(np.median(np.abs(response))) / (0.6745 * 6))


def corner_covariance(
    grey: ndarray,
    points_px: Float[ndarray, "n 2"],
    spacing_px: Float[ndarray, "n"],
    *,
    per_spacing: float = WINDOW_PER_SPACING,
) -> Float[ndarray, "n 2 2"]:
    """Isotropic covariance of each refined corner, px^2, from the noise and the gradients in its window.

    NaN where it is NaN.
    The image-level bound noise^2 inverse(sum g g^T) is widened to what cornerSubPix reaches, with a floor for its bias,
    and another one where the paper about the corner saturates.
    """
    variance = np.full(len(points_px), np.nan)
    noise_dn = estimate_noise_dn(grey)
    usable, half = _half_windows(points_px, spacing_px, per_spacing)
    size_wh = np.array(grey.shape[::-1])
    for size in np.unique(half[usable]):
        index = np.nonzero(usable & (half == size))[0]
        centre = np.clip(np.rint(points_px[index]).astype(int), size + 1, size_wh - size - 2)
        reach = np.arange(-size - 1, size + 2)
        patch = grey[(centre[:, 1, None] + reach)[:, :, None], (centre[:, 0, None] + reach)[:, None, :]].astype(float)
        gx = 0.5 * (patch[:, 1:-1, 2:] - patch[:, 1:-1, :-2])
        gy = 0.5 * (patch[:, 2:, 1:-1] - patch[:, :-2, 1:-1])
        pure_noise = 0.5 * noise_dn**2 * (2 * size + 1) ** 2  # what noise alone adds to the sums
        xx = np.maximum((gx * gx).sum(axis=(1, 2)) - pure_noise, 1e-6)
        yy = np.maximum((gy * gy).sum(axis=(1, 2)) - pure_noise, 1e-6)
        determinant = np.maximum(xx * yy - (gx * gy).sum(axis=(1, 2)) ** 2, 1e-6 * xx * yy)
        bound = noise_dn**2 * 0.5 * (xx + yy) / determinant
        variance[index] = np.minimum(EFFICIENCY_LOSS**2 * bound + FLOOR_PX**2, (0.5 * size) ** 2)
    variance[_are_burnt_out(grey, points_px, spacing_px, per_spacing)] += BURNT_OUT_PX**2
    return variance[:, None, None] * np.where(np.isfinite(variance)[:, None, None], np.eye(2), np.nan)


def _top_of(grey: ndarray) -> float:
    """The top of the range: 254 of 8 bits, else the image's greatest value."""
    return 254 if grey.dtype == np.uint8 else cv2.minMaxLoc(grey)[1]


def _are_burnt_out(
    grey: ndarray, points_px: Float[ndarray, "n 2"], spacing_px: Float[ndarray, "n"], per_spacing: float
) -> Bool[ndarray, "n"]:
    """At which points much of the window is at the top of the range."""
    usable, half = _half_windows(points_px, spacing_px, per_spacing)
    top = _top_of(grey)
    height, width = grey.shape
    are_burnt_out = np.zeros(len(points_px), bool)
    for i in np.nonzero(usable)[0]:
        x, y = np.rint(points_px[i]).astype(int)
        window = grey[
            max(y - half[i], 0) : min(y + half[i] + 1, height), max(x - half[i], 0) : min(x + half[i] + 1, width)
        ]
        are_burnt_out[i] = window.size > 0 and np.mean(window >= top) > BURNT_OUT_SHARE
    return are_burnt_out
