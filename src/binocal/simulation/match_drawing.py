"""How simulated matches come about: points on surfaces that both cameras see, and the ways in which matching goes wrong.

Wrong matches are so by chance, which no pose explains, or all in one way, which another pose may explain better than the truth does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.geometry import SE3, so3
from binocal.shapes import Bool, Float, Int
from binocal.simulation.surroundings import ScenePlanes

WRONG_KINDS = ("uniform", "window", "row", "slope", "moving")
"""Anywhere in the image; anywhere near the right place; in one region some periods off along the row (a fence, windows, level with the
rig to a degree); in one region all off by one sloping shift (stairs, a railing); an object that moved between the exposures. The last
three come with the noise of right matches."""
RIGHT, ABSENT = -1, -2
_ROUNDS = 12  # of drawing points until both cameras see them; what is left then stays absent


def draw_kinds(
    wanted: Bool[ndarray, "problems n"],
    share: Float[ndarray, "problems"],
    names: Sequence[str],
    rng: np.random.Generator,
) -> Int[ndarray, "problems n"]:
    """What each match is: ``RIGHT``, an index into ``WRONG_KINDS``, or ``ABSENT``. Exact shares, in random order."""
    n_problems, n = wanted.shape
    order = np.argsort(np.argsort(np.where(wanted, rng.random((n_problems, n)), 2.0), axis=1), axis=1)
    is_wrong = order < np.rint(share * wanted.sum(axis=1))[:, None]
    kinds = np.where(wanted, RIGHT, ABSENT)
    if len(names):
        index = np.array([WRONG_KINDS.index(name) for name in names])
        bounds = np.cumsum(rng.dirichlet(np.ones(len(names)), n_problems), axis=1)
        drawn = (rng.random((n_problems, n, 1)) > bounds[:, None]).sum(axis=2)
        kinds = np.where(is_wrong, index[np.minimum(drawn, len(names) - 1)], kinds)
    return kinds


@dataclass(frozen=True, slots=True, eq=False)
class MatchDrawer:
    """What the matches of a batch are drawn from. ``unproject`` and ``project`` take the indices of problems first."""

    unproject: Callable[[ndarray, ndarray], ndarray]
    project: Callable[[ndarray, ndarray], ndarray]
    T_right_left: SE3
    left_size_wh: Int[ndarray, "problems 2"]
    right_size_wh: Int[ndarray, "problems 2"]
    planes: ScenePlanes
    noise_px: Float[ndarray, "problems"]

    def draw(
        self, kinds: Int[ndarray, "problems n"], rng: np.random.Generator
    ) -> tuple[Float[ndarray, "problems n 2"], Float[ndarray, "problems n 2"], Bool[ndarray, "problems n"]]:
        """Left and right pixels, drawn until both cameras see them, and which are there."""
        structure = WrongStructure.drawn(len(kinds), rng)
        left, right = np.zeros((*kinds.shape, 2)), np.zeros((*kinds.shape, 2))
        is_present = np.zeros(kinds.shape, dtype=bool)
        for _ in range(_ROUNDS):
            which, place = np.nonzero((kinds != ABSENT) & ~is_present)
            if not which.size:
                break
            shown, seen = self._candidates(which, kinds[which, place], structure, rng)
            inside = (np.abs(shown - (self.left_size_wh[which] - 1) / 2) <= self.left_size_wh[which] / 2).all(axis=1)
            inside &= (np.abs(seen - (self.right_size_wh[which] - 1) / 2) <= self.right_size_wh[which] / 2).all(axis=1)
            which, place = which[inside], place[inside]
            left[which, place], right[which, place], is_present[which, place] = shown[inside], seen[inside], True
        return left, right, is_present

    def _candidates(
        self, which: Int[ndarray, "k"], kind: Int[ndarray, "k"], structure: WrongStructure, rng: np.random.Generator
    ) -> tuple[Float[ndarray, "k 2"], Float[ndarray, "k 2"]]:
        """Points of problems ``which`` as both cameras would show them; NaN where one does not."""
        of = {name: kind == index for index, name in enumerate(WRONG_KINDS)}
        place = rng.random((len(which), 2))
        is_regional = of["row"] | of["slope"] | of["moving"]
        regional = structure.corner[which] + structure.extent[which] * place
        left = np.where(is_regional[:, None], regional, place) * self.left_size_wh[which] - 0.5
        rays = self.unproject(which, left)
        reach = self.planes.draw_m(which, rays, rng)
        nearer = self.planes.surface_m(which, rays) * structure.object_share[which]
        reach = np.where(of["moving"], nearer * rng.uniform(0.95, 1.05, len(which)), reach)
        reach = np.where(np.isfinite(reach), reach, np.nan)  # rays that meet nothing show nothing
        T = self.T_right_left
        periods = rng.integers(1, 4, len(which)) * rng.choice([-1, 1], len(which))
        moved = (periods * of["row"] * structure.period[which])[:, None] * self._level(structure)[which]
        moved += of["moving"][:, None] * structure.motion[which]
        points = reach[:, None] * (rays + moved)
        points = np.einsum("nij,nj->ni", T.R[which], points) + T.t[which]
        right = self.project(which, points)
        width = self.right_size_wh[which, :1]
        near = structure.window[which, None] * rng.uniform(-1, 1, (len(which), 2))
        for name, shift in (("window", near), ("slope", structure.shift[which])):
            right = np.where(of[name][:, None], right + shift * width, right)
        anywhere = rng.random((len(which), 2)) * self.right_size_wh[which] - 0.5
        right = np.where(of["uniform"][:, None], anywhere, right)
        noise = self.noise_px[which, None, None] * rng.standard_normal((len(which), 2, 2))
        return left + noise[:, 0], right + noise[:, 1]

    def _level(self, structure: WrongStructure) -> Float[ndarray, "problems 3"]:
        """The direction in which things repeat: that from the left to the right camera, left frame, a little tilted."""
        T = self.T_right_left
        along = np.einsum("nji,nj->ni", T.R, T.t)
        along /= -np.linalg.norm(along, axis=1, keepdims=True)
        return np.einsum("nij,nj->ni", so3.exp(structure.tilt_rad), along)


@dataclass(frozen=True, slots=True, eq=False)
class WrongStructure:
    """What the wrong matches of one problem have in common. Lengths are shares of the image's width, or of its sides for regions."""

    corner: Float[ndarray, "problems 2"]
    extent: Float[ndarray, "problems 2"]
    window: Float[ndarray, "problems"]
    period: Float[ndarray, "problems"]
    """In distances of what repeats."""
    tilt_rad: Float[ndarray, "problems 3"]
    shift: Float[ndarray, "problems 2"]
    object_share: Float[ndarray, "problems"]
    """The distance of the moving object, as a share of what is behind it."""
    motion: Float[ndarray, "problems 3"]
    """Between the exposures, in distances of the object."""

    @staticmethod
    def drawn(n: int, rng: np.random.Generator) -> WrongStructure:
        """Regions of 0.15 to 0.5 of the image's sides, shifts of 1 to 10 % of its width."""
        extent = rng.uniform(0.15, 0.5, (n, 2))
        angle = np.radians(rng.uniform(10, 80, n)) + np.pi / 2 * rng.integers(4, size=n)
        shift = rng.uniform(0.02, 0.1, n)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        motion = rng.standard_normal((n, 3))
        motion *= (rng.uniform(0.01, 0.05, n) / np.linalg.norm(motion, axis=1))[:, None]
        return WrongStructure(
            (1 - extent) * rng.random((n, 2)),
            extent,
            rng.uniform(0.01, 0.05, n),
            rng.uniform(0.01, 0.05, n),
            np.radians(1.0) * rng.standard_normal((n, 3)),
            shift,
            rng.uniform(0.3, 0.9, n),
            motion,
        )
