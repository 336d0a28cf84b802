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
    px = np.concatenate([detections.left_px, detections.right_px], axis=1).reshape(detections.n_views, -1)
    is_new = np.ones(len(px), dtype=bool)
    centre = np.nanmean(np.where(np.isfinite(px), px, np.nan), axis=1) if px.size else np.zeros(len(px))
    order = np.argsort(centre, kind="stable")
    for rank, view in enumerate(order):
        for other in order[max(rank - len(order), 0) : rank][::-1]:
            if centre[view] - centre[other] > limit_px:
                break
            difference = px[view] - px[other]
            known = np.isfinite(difference)
            if known.any() and np.sqrt(np.mean(difference[known] ** 2)) < limit_px:
                is_new[max(view, other)] = False
    return is_new
