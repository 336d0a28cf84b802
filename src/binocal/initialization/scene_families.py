"""Families of parallel lines in images without a board, and the focal lengths at which two of them stand at right angles.

An image's vanishing points are found one after the other, each the best of many crossings of two segments, until what is left is
explained by chance. Then focal lengths compete: at each, every image has its best two orthogonal families, the third follows, and
all of its segments are evidence. The principal point is taken for the prior's here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy import ndarray

from binocal.geometry.vanishing import PencilForms
from binocal.initialization.vanishing_points import conic_rows
from binocal.shapes import Bool, Float

CROSSINGS = 800  # of two segments, of which each vanishing point is the best; 5 % in the family give two of them
MAX_FAMILIES = 6
POLISHING = 4
SURE = 10.0  # log odds that a family is not by chance, beyond the number of crossings that it was chosen from
MIN_IN_FAMILY = 6
FOCAL_STEPS = np.geomspace(0.25, 12.0, 120)  # in half diagonals: 152 to 10 degrees across the diagonal, 3 % a step
MAX_SKEW = np.sin(np.radians(4.0))  # of two families taken for orthogonal at the nearest step
SAME_LINE_PX, SAME_LINE_RAD = 8.0, np.radians(2.0)
"""Both edges of a bar and the pieces of a broken edge are one line of the scene."""


@dataclass(frozen=True, slots=True, eq=False)
class Family:
    """A vanishing point (homogeneous, unit length), the log odds of its evidence, and how many segments point to it."""

    point: Float[ndarray, "3"]
    log_odds: float
    n_segments: int


@dataclass(frozen=True, slots=True, eq=False)
class FrameAt:
    """The best orthogonal frame of an image at a focal length, and the log odds that it explains.

    ``counts`` says which of its three directions are those of families that were found by themselves. The third one is free to turn
    to wherever lines happen to meet as the focal length changes, and would then tell a wrong one.
    """

    R_camera_scene: Float[ndarray, "3 3"]
    counts: Bool[ndarray, "3"]
    log_odds: float


def distinct_lines(ends_px: Float[ndarray, "n 2 2"]) -> Bool[ndarray, "n"]:
    """Segments that lie on no longer segment's line, so that each line of the scene counts once."""
    along = ends_px[:, 1] - ends_px[:, 0]
    length = np.linalg.norm(along, axis=1)
    along = along / length[:, None]
    is_kept = np.zeros(len(ends_px), dtype=bool)
    for i in np.argsort(-length):
        kept = np.flatnonzero(is_kept)
        if len(kept):
            turn = np.abs(along[kept, 0] * along[i, 1] - along[kept, 1] * along[i, 0])
            away = ends_px[i].mean(axis=0) - ends_px[kept].mean(axis=1)
            beside = np.abs(away[:, 0] * along[kept, 1] - away[:, 1] * along[kept, 0])
            if np.any((turn < np.sin(SAME_LINE_RAD)) & (beside < SAME_LINE_PX)):
                continue
        is_kept[i] = True
    return is_kept


def find_families(forms: PencilForms, rng: np.random.Generator) -> list[Family]:
    """Families of one image, the surest first, at most six.

    A family is taken where chance would give its evidence less often than exp(-10) over all crossings of two segments.
    """
    left = np.ones(len(forms.value), dtype=bool)
    found: list[Family] = []
    n = len(forms.value)
    least = SURE + np.log(max(n * (n - 1) / 2, 1.0))
    while len(found) < MAX_FAMILIES and left.sum() >= MIN_IN_FAMILY:
        part = forms.select(left)
        point, evidence = _best_point(part, rng)
        is_own = np.abs(part.distances(point[None])[0]) < 3.0
        # the two segments that a crossing is made of meet it always: their evidence is left out
        log_odds = float(evidence.sum() - np.sort(evidence)[-2:].sum())
        if log_odds < least or is_own.sum() < MIN_IN_FAMILY:
            break
        found.append(Family(point, log_odds, int(is_own.sum())))
        left[np.flatnonzero(left)[is_own]] = False
    return found


def _best_point(forms: PencilForms, rng: np.random.Generator) -> tuple[Float[ndarray, "3"], Float[ndarray, "n"]]:
    """The crossing with most evidence, polished, and every segment's evidence for it."""
    n = len(forms.value)
    share = 1 / forms.turn_sigma_rad
    pairs = rng.choice(n, size=(CROSSINGS, 2), p=share / share.sum())
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    points = np.cross(forms.value[pairs[:, 0]], forms.value[pairs[:, 1]])
    size = np.linalg.norm(points, axis=1)
    points = points[size > 0] / size[size > 0, None]
    total = forms.evidence(forms.distances(points) ** 2, 1).sum(axis=1)
    best, most = points[int(total.argmax())], float(total.max())
    for _ in range(POLISHING):
        r = forms.distances(best[None])[0]
        variance = np.einsum("i,nij,j->n", best, forms.variance, best)
        weights = np.exp(-0.5 * np.minimum(r**2, 50.0)) / np.maximum(variance, 1e-300)
        scaled = forms.value * np.sqrt(weights)[:, None]
        point = np.linalg.svd(scaled / np.linalg.norm(scaled, axis=1).max(), full_matrices=False)[2][-1]
        gained = float(forms.evidence(forms.distances(point[None]) ** 2, 1).sum())
        if gained <= most:
            break
        best, most = point, gained
    return best, forms.evidence(forms.distances(best[None]) ** 2, 1)[0]


def focal_steps(
    families: Sequence[Sequence[Family]], centre_px: Float[ndarray, "2"], half_diagonal_px: float
) -> Float[ndarray, "k"]:
    """Focal lengths to try, pixels: a fine scale, and those at which two families of an image are orthogonal exactly."""
    shift = np.array([[1, 0, -centre_px[0]], [0, 1, -centre_px[1]], [0, 0, 1]])
    exact = []
    for own in families:
        for a, b in combinations(own, 2):
            row = conic_rows(shift @ a.point, shift @ b.point)  # eq 10: f² = -(x x' + y y') / (w w')
            if abs(row[5]) > 0 and -(row[0] + row[2]) / row[5] > 0:
                exact.append(float(np.sqrt(-(row[0] + row[2]) / row[5])))
    scale = half_diagonal_px * FOCAL_STEPS
    inside = [f for f in exact if scale[0] <= f <= scale[-1]]
    return np.sort(np.r_[scale, inside])


def best_frame(
    families: Sequence[Family], forms: PencilForms, focal_px: float, centre_px: Float[ndarray, "2"]
) -> FrameAt | None:
    """The orthogonal frame through two of the families that explains most; None where no two are orthogonal."""
    K = np.array([[focal_px, 0, centre_px[0]], [0, focal_px, centre_px[1]], [0, 0, 1]])
    directions = np.array([np.linalg.solve(K, family.point) for family in families]).reshape(-1, 3)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    best: FrameAt | None = None
    for i, j in combinations(range(len(directions)), 2):
        if abs(float(directions[i] @ directions[j])) > MAX_SKEW:
            continue
        R = _frame(directions[i], directions[j])
        is_third_found = bool((np.abs(directions @ R[:, 2]) > np.sqrt(1 - MAX_SKEW**2)).any())
        counts = np.array([True, True, is_third_found])
        r2 = (forms.distances((K @ R).T[counts]) ** 2).min(axis=0)
        log_odds = float(forms.evidence(r2, int(counts.sum())).sum())
        if best is None or log_odds > best.log_odds:
            best = FrameAt(R, counts, log_odds)
    return best


def _frame(first: Float[ndarray, "3"], second: Float[ndarray, "3"]) -> Float[ndarray, "3 3"]:
    """The rotation whose first two columns are nearest to two directions, the third at right angles to both."""
    third = np.cross(first, second)
    third /= np.linalg.norm(third)
    u, _, vt = np.linalg.svd(np.stack([first, second], axis=1), full_matrices=False)
    near = u @ vt
    return np.column_stack([near, third])
