"""SIFT features and which of them match: RootSIFT, each other's nearest, and clearly nearer than the next."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy import ndarray

from binocal.shapes import Float, Float32, Int, UInt8

RATIO = 0.8  # of the distances to the nearest and the next; without the test half of the matches and more are wrong
CONTRAST = 0.02  # SIFT's own threshold is twice that, which leaves dark and hazy images without features


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """Places in an image and their RootSIFT descriptors (unit length)."""

    points_px: Float[ndarray, "n 2"]
    descriptors: Float32[ndarray, "n 128"]


def find_features(image: UInt8[ndarray, "h w"], n_features: int) -> Features:
    """The strongest features of a grey image, at most so many.

    Source: Lowe 2004; Arandjelovic & Zisserman 2012 for the root of the descriptors.
    """
    sift = cv2.SIFT.create(nfeatures=n_features, contrastThreshold=CONTRAST, enable_precise_upscale=True)
    points, descriptors = sift.detectAndCompute(image, None)
    if descriptors is None or not points:
        return Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
    total = np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-12)
    return Features(np.array([p.pt for p in points], dtype=float), np.sqrt(descriptors / total).astype(np.float32))


def match_features(left: Features, right: Features, ratio: float = RATIO) -> Int[ndarray, "n 2"]:
    """Indices of left and right features that are each other's nearest, by clearly less than to the next."""
    if min(len(left.descriptors), len(right.descriptors)) < 2:
        return np.zeros((0, 2), dtype=int)
    likeness = left.descriptors @ right.descriptors.T  # distance² = 2 - 2 likeness
    best = likeness.argmax(axis=1)
    rows = np.arange(len(best))
    nearest = likeness[rows, best]
    is_mutual = likeness.argmax(axis=0)[best] == rows
    likeness[rows, best] = -1.0
    following = likeness.max(axis=1)
    is_clear = np.maximum(1 - nearest, 0) < ratio**2 * np.maximum(1 - following, 0)
    found = np.flatnonzero(is_mutual & is_clear)
    return np.column_stack([found, best[found]])


def as_bytes(image: ndarray) -> ndarray:
    """As features are sought in: uint8, the full range of what deeper images show."""
    if image.dtype == np.uint8:
        return np.ascontiguousarray(image)
    low, high = np.percentile(image, (0.5, 99.5))
    return np.clip(255 * (image.astype(float) - low) / max(high - low, 1.0), 0, 255).astype(np.uint8)
