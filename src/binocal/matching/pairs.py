"""One pair of images to its matches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.evidence.point_matches import PointMatches
from binocal.kernels.template_match import match_templates
from binocal.matching.features import RATIO, as_bytes, find_features, match_features
from binocal.matching.sharpness import pair_spreads_px
from binocal.shapes import Bool, Float

MIN_LIKENESS = 0.9
MAX_SHIFT_PX = 2.5  # of a feature's own place by its window
MAX_RETURN_PX = 0.3  # of a window matched there and back
FEW_MATCHES = 100  # fewer whose windows agree: the features' own places serve, too


@dataclass(frozen=True, slots=True)
class MatchOptions:
    """How many features are sought in an image, and how their descriptors and windows are compared."""

    n_features: int = 1500
    ratio: float = RATIO
    half: int = 9
    """Windows are 2 half + 1 pixels wide."""


@dataclass(frozen=True, slots=True, eq=False)
class PairMatches:
    """The matches of a pair, and what its images are like, left first: features found, and the spread of edges around them, pixels.

    ``n_mirrored`` is how many features match where one image is mirrored; sought only where few match as they are.
    """

    matches: PointMatches
    n_features: tuple[int, int]
    edge_spread_px: tuple[float, float]
    n_mirrored: int = 0


def match_pair(left: ndarray, right: ndarray, name: str, options: MatchOptions | None = None) -> PairMatches:
    """The matches of a pair of grey images (h, w), uint8 or uint16.

    Features place them to a fifth of a pixel; windows fitted by least squares to a twentieth (:mod:`.kernels.template_match`).
    Those whose windows do not agree are left out, unless few are left.
    """
    options = options or MatchOptions()
    first, second = (find_features(as_bytes(image), options.n_features) for image in (left, right))
    found = match_features(first, second, options.ratio)
    left_px, right_px = first.points_px[found[:, 0]], second.points_px[found[:, 1]]
    spread = pair_spreads_px((left, right), (first.points_px, second.points_px), (left_px, right_px))
    refined, agrees = _refined(left, right, left_px, right_px, options.half)
    if agrees.sum() >= FEW_MATCHES:
        left_px, right_px = left_px[agrees], refined[agrees]
    else:
        right_px = np.where(agrees[:, None], refined, right_px)
    sizes = [(image.shape[1], image.shape[0]) for image in (left, right)]
    matches = PointMatches(left_px, right_px, np.zeros(len(left_px), dtype=int), (name,), sizes[0], sizes[1])
    n_mirrored = 0
    if len(matches) < FEW_MATCHES:
        mirrored = find_features(np.ascontiguousarray(as_bytes(right)[:, ::-1]), options.n_features)
        n_mirrored = len(match_features(first, mirrored, options.ratio))
    return PairMatches(matches, (len(first.points_px), len(second.points_px)), spread, n_mirrored)


def _refined(
    left: ndarray, right: ndarray, left_px: Float[ndarray, "n 2"], right_px: Float[ndarray, "n 2"], half: int
) -> tuple[Float[ndarray, "n 2"], Bool[ndarray, "n"]]:
    """Where the windows around the left points lie in the right image, and whether they come back from there."""
    shown, other = (np.ascontiguousarray(image, dtype=np.float32) for image in (left, right))
    there = match_templates(shown, other, left_px, right_px, half=half)
    is_found = there.is_converged & (there.likeness > MIN_LIKENESS)
    is_found &= np.linalg.norm(there.points_px - right_px, axis=1) < MAX_SHIFT_PX
    points, warp = (
        np.where(is_found[:, None], there.points_px, right_px),
        np.where(is_found[:, None, None], there.warp, np.eye(2)),
    )
    back = match_templates(other, shown, points, left_px, np.linalg.inv(warp), half=half)
    comes_back = back.is_converged & (np.linalg.norm(back.points_px - left_px, axis=1) < MAX_RETURN_PX)
    return points, is_found & comes_back
