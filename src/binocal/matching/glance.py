"""A cheap look at a pair of images: where it has things, and how far apart the cameras see them; to a pixel or two."""

from __future__ import annotations

import cv2
import numpy as np
from numpy import ndarray

from binocal.evidence.point_matches import PointMatches
from binocal.matching.features import as_bytes

MOST_SIDE_PX = 640.0  # of the reduced images
N_FEATURES = 400
MOST_BITS = 50  # by which ORB's descriptors of 256 bits may differ


def glance_at_pair(left: ndarray, right: ndarray, name: str) -> PointMatches:
    """A few hundred matches of a pair of grey images (h, w), of small images and binary features; some are wrong.

    Enough to tell which of many pairs say most of a pose, in some ten milliseconds; never to be solved for a result: features lie on
    the small images' pixels. Source: Rublee et al. 2011, "ORB".
    """
    points, descriptors = zip(*(_features(image) for image in (left, right)), strict=True)
    sizes = [(image.shape[1], image.shape[0]) for image in (left, right)]
    found = np.zeros((0, 2), dtype=int)
    if all(one is not None for one in descriptors):
        matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(*descriptors)
        found = np.array([(m.queryIdx, m.trainIdx) for m in matches if m.distance <= MOST_BITS], dtype=int).reshape(
            -1, 2
        )
    pair = np.zeros(len(found), dtype=int)
    return PointMatches(points[0][found[:, 0]], points[1][found[:, 1]], pair, (name,), sizes[0], sizes[1])


def _features(image: ndarray) -> tuple[ndarray, ndarray | None]:
    """Places in the image as it is, and descriptors, of the reduced image."""
    scale = min(1.0, MOST_SIDE_PX / max(image.shape))
    small = as_bytes(image)
    if scale < 1:
        small = cv2.resize(small, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    points, descriptors = cv2.ORB.create(nfeatures=N_FEATURES, nlevels=4).detectAndCompute(small, None)
    grow = np.array(image.shape[1::-1]) / small.shape[1::-1]
    places = np.array([p.pt for p in points], dtype=float).reshape(-1, 2)
    return (places + 0.5) * grow - 0.5, descriptors if len(points) else None
