"""Views that are one image: counted once, however often they were given."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.evidence import Detections
from binocal.shapes import Bool, Int


def first_of_copies(detections: Detections) -> Int[ndarray, "views"]:
    """For each view the first one with exactly its corners in both cameras: itself, unless it is a copy."""
    seen: dict[bytes, int] = {}
    first = np.empty(detections.n_views, dtype=int)
    for view in range(detections.n_views):
        key = detections.left_px[view].tobytes() + detections.right_px[view].tobytes()
        first[view] = seen.setdefault(key, view)
    return first


def different_poses(detections: Detections, limit_px: float) -> Bool[ndarray, "views"]:
    """Which views show the board elsewhere than every view before them: their corners differ by more than a limit (RMS)."""
    px = np.concatenate([detections.left_px, detections.right_px], axis=1)
    px, known = px.reshape(len(px), -1), np.isfinite(px).reshape(len(px), -1)
    filled = np.where(known, px, 0.0)
    counts = np.maximum(known.sum(axis=1), 1)
    centre, height = filled.sum(axis=1) / counts, filled[:, 1::2].sum(axis=1) / counts
    is_new = np.ones(len(px), dtype=bool)
    order = np.argsort(centre, kind="stable")
    for rank, view in enumerate(order):
        for other in order[:rank][::-1]:
            if centre[view] - centre[other] > limit_px:
                break
            if abs(height[view] - height[other]) > limit_px:
                continue
            both = known[view] & known[other]
            if both.any() and np.mean((px[view] - px[other])[both] ** 2) < limit_px**2:
                is_new[max(view, other)] = False
    return is_new
