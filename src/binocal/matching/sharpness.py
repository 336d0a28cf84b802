"""How wide the edges of an image are, and those of two images of the same things."""

from __future__ import annotations

import cv2
import numpy as np
from numpy import ndarray

from binocal.shapes import Float

SMOOTHING_PX = 0.7  # against noise
HALF = 9
NOISE_GRADIENT, NOISE_CURVATURE = 0.0998, 0.0731
"""What noise of unit variance adds to the mean squares of a smoothed image's gradient and second derivatives."""
CURVE_OF_NOISE = 6.0  # standard deviation of the mask that noise is measured by, for unit noise
MIN_SHARED = 20  # things seen by both, for their edges to be compared one by one


def edge_spreads_px(image: ndarray, points_px: Float[ndarray, "n 2"]) -> Float[ndarray, "n"]:
    """Standard deviation of the edges around each point of a grey image, pixels.

    An edge blurred by a Gaussian of standard deviation s has a gradient whose energy is 2 s² times that of its derivative. Sharp
    images show 0.9 to 1.2, the smoothing included. What the image's noise adds to both is taken out, else dark and noisy images
    would seem sharp.
    """
    grey = np.asarray(image, dtype=np.float32)
    smooth = cv2.GaussianBlur(grey, (0, 0), SMOOTHING_PX)
    by_x, by_y = (cv2.Sobel(smooth, cv2.CV_32F, *order, ksize=3, scale=1 / 8) for order in ((1, 0), (0, 1)))
    by_xx, by_xy = (cv2.Sobel(by_x, cv2.CV_32F, *order, ksize=3, scale=1 / 8) for order in ((1, 0), (0, 1)))
    by_yy = cv2.Sobel(by_y, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8)
    size = (2 * HALF + 1, 2 * HALF + 1)
    first = cv2.boxFilter(by_x**2 + by_y**2, -1, size)
    second = cv2.boxFilter(by_xx**2 + 2 * by_xy**2 + by_yy**2, -1, size)
    place = np.clip(np.round(points_px).astype(int), 0, np.array(image.shape[1::-1]) - 1)
    noise2 = _noise_sigma(grey) ** 2
    gradient, curvature = (values[place[:, 1], place[:, 0]].astype(float) for values in (first, second))
    left = np.maximum(gradient - NOISE_GRADIENT * noise2, 0.0)
    return np.sqrt(left / np.maximum(curvature - NOISE_CURVATURE * noise2, 1e-12 + 0.1 * curvature) / 2)


def pair_spreads_px(
    images: tuple[ndarray, ndarray],
    features_px: tuple[Float[ndarray, "m 2"], Float[ndarray, "k 2"]],
    shared_px: tuple[Float[ndarray, "n 2"], Float[ndarray, "n 2"]],
) -> tuple[float, float]:
    """Spread of the edges of two grey images, pixels, compared at what both show, whatever their gain and brightness.

    Where they share too little, each at its own features, which may be those of other textures; NaN where there are none.
    """
    if len(shared_px[0]) >= MIN_SHARED:
        left, right = (edge_spreads_px(image, px) for image, px in zip(images, shared_px, strict=True))
        typical = float(np.median(left))
        return typical, typical * float(np.median(right / np.maximum(left, 1e-6)))
    own = [edge_spreads_px(image, px) for image, px in zip(images, features_px, strict=True)]
    left_px, right_px = (float(np.median(spreads)) if len(spreads) else float("nan") for spreads in own)
    return left_px, right_px


def _noise_sigma(grey: ndarray) -> float:
    """Standard deviation of an image's noise, as its smooth parts have it: Immerkaer 1996, with a median for his mean."""
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    return float(np.median(np.abs(cv2.filter2D(grey, -1, mask)))) / CURVE_OF_NOISE / 0.6745
