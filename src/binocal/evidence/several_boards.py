"""Views of several boards: which points are of one board, and which boards are the same from one pair of images to the next."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.evidence.detections import Detections
from binocal.shapes import Bool, Int

LEAST_VIEWS = 4  # of a board, for its shape to be asked for


def boards_from_shot_to_shot(views: Detections) -> Int[ndarray, "n"]:
    """Of each point its board, counted from 0; -1 where the board may be another one in each pair of images, or few views show it.

    Points that a view shows together are of one board. Of boards that a pair shows twice or more nobody knows which is which in the
    next pair, and a board in a single pair has but one view.
    """
    is_seen = views.left_is_seen | views.right_is_seen
    shots = np.arange(views.n_views) if views.shots is None else np.array(views.shots)
    labels = np.full(is_seen.shape[1], -1)
    n_boards = 0
    for points, shows in _boards(is_seen):
        own = shots[shows]
        if len(own) >= LEAST_VIEWS and len(np.unique(own)) == len(own):
            labels[points] = n_boards
            n_boards += 1
    return labels


def _boards(is_seen: Bool[ndarray, "views n"]) -> list[tuple[Bool[ndarray, "n"], Bool[ndarray, "views"]]]:
    """Points that views show together, and those views."""
    left = is_seen.any(axis=0)
    found = []
    while left.any():
        points = np.zeros_like(left)
        points[np.argmax(left)] = True
        while True:
            shows = is_seen[:, points].any(axis=1)
            grown = is_seen[shows].any(axis=0)
            if grown.sum() == points.sum():
                break
            points = grown
        found.append((points, shows))
        left &= ~points
    return found
