"""Markers that are read well and are none of the board's: on a tool, on another board, or decoded wrongly.

One such marker lies anywhere, far from where its id belongs, and least squares over all markers would fold the board.
Whether markers belong together is therefore asked of small groups, whose homography no lens bends much: the board is the
largest set in which every marker lies where those beside it put it, and the markers that lie where the lens puts them by these.
"""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.detection.finding.planes import apply_homography, expected_points, fit_homography
from binocal.shapes import Bool, Float

MOST_SEEDS = 24  # groups that are tried: with half of the markers stray, a sixth of the groups is still clean
GROUP = 3  # markers beside each other: 12 corners fix a homography well enough for the next few squares
# How far a marker may lie from where a group puts it, in its own sides: at least, for each marker pitch of the way, and at most.
# True ones are off by 0.3 in the next square and by half a side four squares away; a stray one by its distance from home.
MAX_OFF, MAX_OFF_PER_PITCH, MOST_OFF = 0.6, 0.3, 2.0
MIN_SHARE_AGREEING = (
    0.6  # of the markers: with fewer the board given is more likely wrong than so many markers are stray
)
MIN_AGREEING = 3  # of two markers neither is more credible than the other


def find_strays(
    places: Float[ndarray, "m 4 2"], quads_px: Float[ndarray, "m 4 2"], size_wh: tuple[int, int]
) -> Bool[ndarray, "m"]:
    """Which markers lie elsewhere than most of the others put them; all of them where no majority agrees.

    ``places`` are the markers' corners on the board by their ids, ``quads_px`` the same corners in the image, whose width and
    height are ``size_wh``.
    """
    everywhere = np.ones(len(places), bool)
    if len(places) < MIN_AGREEING:
        return everywhere
    markers = _Markers(places, quads_px)
    seeds = np.unique(np.linspace(0, len(places) - 1, min(MOST_SEEDS, len(places))).round().astype(int))
    best = max((markers.agreeing_with(int(seed)) for seed in seeds), key=np.count_nonzero)
    agreeing = markers.grown(best)
    if np.count_nonzero(agreeing) < max(MIN_AGREEING, MIN_SHARE_AGREEING * len(places)):
        return everywhere
    return ~agreeing if agreeing.all() else _off_lens(markers, ~agreeing, size_wh)


def _off_lens(markers: _Markers, is_stray: Bool[ndarray, "m"], size_wh: tuple[int, int]) -> Bool[ndarray, "m"]:
    """Those of the strays that the image's own lens puts elsewhere too: large markers near the rim of a wide lens are none."""
    for _ in range(np.count_nonzero(is_stray)):
        known = np.where(is_stray[:, None, None], np.nan, markers.quads_px).reshape(-1, 2)
        side_px = float(np.median(markers.side_px[~is_stray]))
        expected = expected_points(markers.places.reshape(-1, 2), known, side_px, size_wh).reshape(-1, 4, 2)
        off_px = np.linalg.norm(expected - markers.quads_px, axis=-1).max(axis=1)
        is_found = is_stray & (off_px < MAX_OFF * markers.side_px)
        if not is_found.any():
            break
        is_stray = is_stray & ~is_found
    return is_stray


def stray_note(n_stray: int, word: str) -> str:
    """What a careful reader should know of an image with strays; ``word`` is what the board's kind calls its markers."""
    return (
        f"a {word} lies elsewhere than its number does on the board (misread, or none of the board's) and was left out"
        if n_stray == 1
        else f"{n_stray} {word}s lie elsewhere than their numbers do on the board (misread, or none of the board's) and were left out"
    )


class _Markers:
    """Markers on the board and in the image, with their distances on the board in pitches of neighbouring markers."""

    def __init__(self, places: Float[ndarray, "m 4 2"], quads_px: Float[ndarray, "m 4 2"]) -> None:
        self.places, self.quads_px = places, quads_px
        centres = places.mean(axis=1)
        apart = np.linalg.norm(centres[:, None] - centres, axis=-1)
        nearest = np.where(np.eye(len(places), dtype=bool), np.inf, apart).min(axis=1)
        self.pitches = apart / np.median(nearest)
        diagonals = quads_px[:, 2] - quads_px[:, 0], quads_px[:, 3] - quads_px[:, 1]
        area = 0.5 * np.abs(diagonals[0][:, 0] * diagonals[1][:, 1] - diagonals[0][:, 1] * diagonals[1][:, 0])
        self.side_px = np.sqrt(np.maximum(area, 1.0))

    def agreeing_with(self, seed: int) -> Bool[ndarray, "m"]:
        """Which markers lie where a marker and the two nearest to it on the board put them, the nearest in turn replaced."""
        order = np.argsort(self.pitches[seed], kind="stable")
        groups = [order[:GROUP], np.r_[order[:1], order[2 : GROUP + 1]], np.r_[order[:2], order[3 : GROUP + 1]]]
        return max((self._near(group) for group in groups), key=np.count_nonzero)

    def grown(self, members: Bool[ndarray, "m"]) -> Bool[ndarray, "m"]:
        """With the markers that lie where the nearest members put them, again and again, and without members that do not."""
        for _ in range(len(members)):
            again = np.array([self._is_near(i, members) for i in range(len(members))])
            if np.array_equal(again, members) or np.count_nonzero(again) < np.count_nonzero(members):
                return again & members if np.count_nonzero(again) < np.count_nonzero(members) else members
            members = again
        return members

    def _is_near(self, i: int, members: Bool[ndarray, "m"]) -> bool:
        others = np.nonzero(members)[0]
        others = others[others != i]
        group = others[np.argsort(self.pitches[i, others], kind="stable")[: GROUP + 1]]
        return len(group) >= 2 and bool(self._near(group)[i])

    def _near(self, group: ndarray) -> Bool[ndarray, "m"]:
        """Which markers lie where the homography of a group puts them, seen from the front."""
        H = fit_homography(self.places[group].reshape(-1, 2), self.quads_px[group].reshape(-1, 2))
        w = self.places @ H[2, :2] + H[2, 2]
        is_front = (w * w[group[0], 0] > 0).all(axis=1)
        if not np.isfinite(H).all() or np.linalg.det(H) * w[group[0], 0] <= 0:
            return np.zeros(len(self.places), bool)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            off_px = np.linalg.norm(apply_homography(H, self.places) - self.quads_px, axis=-1).max(axis=1)
        pitches = self.pitches[:, group].min(axis=1)
        limit = np.minimum(MAX_OFF + MAX_OFF_PER_PITCH * pitches, MOST_OFF) * self.side_px
        return is_front & (off_px < limit)
