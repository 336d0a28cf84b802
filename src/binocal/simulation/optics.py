"""Blur by lens and motion, on grids of any fineness."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.shapes import Float


@dataclass(frozen=True, slots=True)
class BlurKernel:
    """A blur in pixels: a Gaussian, a disc and a straight motion, one after the other."""

    gaussian_px: float
    disc_px: float
    motion_px: tuple[float, float]

    @property
    def reach_px(self) -> int:
        """Pixels to each side that it takes light from; 4.5 sigma leaves out 7e-6 of a Gaussian, 0.001 grey levels."""
        reach = 4.5 * self.gaussian_px + self.disc_px + max(abs(self.motion_px[0]), abs(self.motion_px[1])) / 2
        return int(np.ceil(reach)) + 1

    def without(self, variance_px2: float) -> BlurKernel:
        """What is left to do when a Gaussian of that variance has acted already."""
        return replace(self, gaussian_px=float(np.sqrt(max(self.gaussian_px**2 - variance_px2, 0.0))))


def blur_kernel(blur_px: float, kind: str, motion_px: tuple[float, float], *, least_px: float) -> BlurKernel:
    """The blur of a lens (Gaussian sigma, or disc radius) and a motion; the Gaussian is at least ``least_px``."""
    gaussian, disc = (max(blur_px, least_px), 0.0) if kind == "gaussian" else (least_px, blur_px)
    return BlurKernel(gaussian, disc, (float(motion_px[0]), float(motion_px[1])))


def blur_image(image: Float[ndarray, "h w"], kernel: BlurKernel, *, scale: int) -> Float[ndarray, "h w"]:
    """The image, sampled ``scale`` times per pixel, after the blur. Edges repeat outward."""
    import cv2

    if kernel.gaussian_px > 0:
        sigma = kernel.gaussian_px * scale
        taps = 2 * int(np.ceil(4.5 * sigma)) + 1
        image = cv2.GaussianBlur(image, (taps, taps), sigma, borderType=cv2.BORDER_REPLICATE)
    if kernel.disc_px > 0:
        image = cv2.filter2D(image, -1, _disc(kernel.disc_px * scale), borderType=cv2.BORDER_REPLICATE)
    if any(kernel.motion_px):
        image = cv2.filter2D(image, -1, _line(np.array(kernel.motion_px) * scale), borderType=cv2.BORDER_REPLICATE)
    return image


def _disc(radius: float) -> Float[ndarray, "k k"]:
    """Uniform disc: the share of each sample's cell that it covers, by 16 x 16 points per cell."""
    n = int(np.ceil(radius + 0.5))
    points = (np.arange((2 * n + 1) * 16) + 0.5) / 16 - n - 0.5
    inside = (points[:, None] ** 2 + points**2 <= radius**2).astype(float)
    weights = inside.reshape(2 * n + 1, 16, 2 * n + 1, 16).sum(axis=(1, 3))
    if weights.sum() == 0:  # a disc smaller than the points' spacing blurs nothing
        weights[n, n] = 1
    return (weights / weights.sum()).astype(np.float32)


def _line(motion: Float[ndarray, "2"]) -> Float[ndarray, "k k"]:
    """Straight line centred on the middle sample, its points shared linearly by the four samples around them."""
    n = int(np.ceil(np.abs(motion).max() / 2)) + 1
    count = 16 * n + 1
    share = (np.arange(count) + 0.5) / count - 0.5
    x, y = n + share * motion[0], n + share * motion[1]
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    s, t = x - column, y - row
    weights = np.zeros((2 * n + 2, 2 * n + 2))
    for i, j, w in ((0, 0, (1 - s) * (1 - t)), (0, 1, s * (1 - t)), (1, 0, (1 - s) * t), (1, 1, s * t)):
        np.add.at(weights, (row + i, column + j), w)
    return (weights[: 2 * n + 1, : 2 * n + 1] / count).astype(np.float32)
