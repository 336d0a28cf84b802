"""Matches of scenes without a board, as matching would return them, with exact truth: many problems at once.

A share of them is wrong, in the ways in which matching goes wrong (:data:`binocal.simulation.match_drawing.WRONG_KINDS`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.cameras import Camera, StereoRig
from binocal.evidence.point_matches import PointMatches
from binocal.geometry import SE3, so3
from binocal.shapes import Bool, Float, Int
from binocal.simulation.match_drawing import RIGHT, WRONG_KINDS, MatchDrawer, draw_kinds
from binocal.simulation.surroundings import SURROUNDINGS, Range, draw_planes
from binocal.simulation.visibility import visible_px


@dataclass(frozen=True, slots=True)
class MatchDistribution:
    """A distribution of match problems. Ranges are uniform unless said otherwise."""

    families: tuple[str, ...] = ("street", "room", "far", "plane")
    focal_px: Range = (300.0, 1600.0)
    """Log-uniform; of both cameras within 1 %."""
    width_px: Range = (640.0, 2048.0)
    """Heights are 0.3 to 0.8 of it. Fields wider than 110 degrees do not come: the focal length is then longer."""
    noise_px: Range = (0.06, 1.0)
    """Log-uniform; standard deviation of each coordinate in each image."""
    n_matches: tuple[int, int] = (100, 300)
    wrong_share: Range = (0.0, 0.4)
    wrong_kinds: tuple[str, ...] = WRONG_KINDS
    """Mixed by random shares in each problem."""
    turn_deg: float = 3.0
    """Of the right camera against the left, one sigma about each axis."""
    is_forward: bool = False
    """One camera before the other, in place of side by side; the translation within 17 degrees of that in both cases."""

    def __post_init__(self) -> None:
        _check_names(self.families, SURROUNDINGS, "family")
        _check_names(self.wrong_kinds, WRONG_KINDS, "kind of wrong match")
        if not 0 <= self.wrong_share[0] <= self.wrong_share[1] <= 1:
            raise ValueError(f"wrong_share must be a range within 0 and 1; got {self.wrong_share}")
        if min(self.focal_px[0], self.width_px[0], self.noise_px[0]) <= 0 or self.n_matches[0] < 1:
            raise ValueError(f"focal lengths, widths, noise and numbers must be positive; got {self}")


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedMatches:
    """The matches of one problem, the rig that they come from and which are right."""

    rig: StereoRig
    matches: PointMatches
    is_right: Bool[ndarray, "n"]
    noise_px: float


@dataclass(frozen=True, slots=True, eq=False)
class MatchProblems:
    """A batch of problems: pinhole cameras, padded matches, the truth. Absent matches are 0 and not right.

    ``left_parameters`` and ``right_parameters`` are those of a brown4 :class:`binocal.cameras.Camera` without distortion;
    ``T_right_left`` is in metres.
    """

    left_parameters: Float[ndarray, "problems 9"]
    right_parameters: Float[ndarray, "problems 9"]
    size_wh: Int[ndarray, "problems 2"]
    T_right_left: SE3
    left_px: Float[ndarray, "problems n 2"]
    right_px: Float[ndarray, "problems n 2"]
    is_present: Bool[ndarray, "problems n"]
    is_right: Bool[ndarray, "problems n"]
    noise_px: Float[ndarray, "problems"]

    def __len__(self) -> int:
        """How many problems."""
        return len(self.left_px)

    def problem(self, index: int) -> SimulatedMatches:
        """One of them, as evidence."""
        width, height = (int(n) for n in self.size_wh[index])
        left, right = (
            Camera("brown4", (width, height), values[index]) for values in (self.left_parameters, self.right_parameters)
        )
        rig = StereoRig(left, right, self.T_right_left[index], True)
        here = self.is_present[index]
        points = self.left_px[index, here], self.right_px[index, here]
        return _as_evidence(rig, points, self.is_right[index, here], float(self.noise_px[index]))


def sample_match_problems(distribution: MatchDistribution, n_problems: int, rng: np.random.Generator) -> MatchProblems:
    """Problems of rigs and scenes drawn anew for each, intrinsics exact. Thousands take seconds."""
    names = [distribution.families[i] for i in rng.integers(len(distribution.families), size=n_problems)]
    families = [SURROUNDINGS[name] for name in names]
    width = np.rint(rng.uniform(*distribution.width_px, n_problems))
    size = np.stack([width, np.rint(width * rng.uniform(0.3, 0.8, n_problems))], axis=1).astype(int)
    focal = np.maximum(_log_uniform(distribution.focal_px, n_problems, rng), width / 2 / np.tan(np.radians(55.0)))
    parameters = np.zeros((2, n_problems, 9))
    parameters[:, :, :2] = (focal * rng.uniform(0.99, 1.01, (2, n_problems)))[..., None]
    parameters[:, :, 2:4] = (size - 1) / 2 + 0.015 * width[:, None] * rng.uniform(-1, 1, (2, n_problems, 2))
    along = so3.exp(np.radians(10.0) * rng.uniform(-1, 1, (n_problems, 3)))[:, :, 2 if distribution.is_forward else 0]
    low, high = np.array([family.baseline_m for family in families]).reshape(-1, 2).T
    turn = so3.exp(np.radians(distribution.turn_deg) * rng.standard_normal((n_problems, 3)))
    T_right_left = SE3(turn, -along * (low + (high - low) * rng.random(n_problems))[:, None])
    n_matches = rng.integers(distribution.n_matches[0], distribution.n_matches[1] + 1, n_problems)
    noise_px = _log_uniform(distribution.noise_px, n_problems, rng)
    share = rng.uniform(*distribution.wrong_share, n_problems)
    wanted = np.arange(max(n_matches, default=0)) < n_matches[:, None]
    kinds = draw_kinds(wanted, share, distribution.wrong_kinds, rng)

    def unproject(which: Int[ndarray, "k"], px: Float[ndarray, "k 2"]) -> Float[ndarray, "k 3"]:
        own = parameters[0, which]
        rays = np.concatenate([(px - own[:, 2:4]) / own[:, :2], np.ones((len(px), 1))], axis=1)
        return rays / np.linalg.norm(rays, axis=1, keepdims=True)

    def project(which: Int[ndarray, "k"], points: Float[ndarray, "k 3"]) -> Float[ndarray, "k 2"]:
        own = parameters[1, which]
        with np.errstate(all="ignore"):
            px = points[:, :2] / points[:, 2:] * own[:, :2] + own[:, 2:4]
        return np.where(points[:, 2:] > 0, px, np.nan)

    drawer = MatchDrawer(unproject, project, T_right_left, size, size, draw_planes(families, rng), noise_px)
    left_px, right_px, is_present = drawer.draw(kinds, rng)
    is_right = is_present & (kinds == RIGHT)
    return MatchProblems(
        parameters[0], parameters[1], size, T_right_left, left_px, right_px, is_present, is_right, noise_px
    )


def simulate_matches(
    rig: StereoRig,
    n_matches: int,
    rng: np.random.Generator,
    *,
    family: str = "street",
    noise_px: float = 0.1,
    wrong_share: float = 0.0,
    wrong_kinds: Sequence[str] = WRONG_KINDS,
) -> SimulatedMatches:
    """Matches of one pair of images of a rig, lenses included. Lengths are in baselines where the rig is not metric.

    Fewer than ``n_matches`` where the two cameras hardly see the same.

    Raises:
        ValueError: No such family or kind of wrong match, a share outside [0, 1], or negative noise.
    """
    _check_names((family,), SURROUNDINGS, "family")
    _check_names(wrong_kinds, WRONG_KINDS, "kind of wrong match")
    if not 0 <= wrong_share <= 1 or not noise_px >= 0:
        raise ValueError(f"wrong_share must be within 0 and 1, noise_px 0 or more; got {wrong_share}, {noise_px}")
    usual_m = float(np.mean(SURROUNDINGS[family].baseline_m))
    planes = draw_planes([SURROUNDINGS[family]], rng, 1.0 if rig.is_metric else rig.baseline_m / usual_m)
    kinds = draw_kinds(np.ones((1, n_matches), dtype=bool), np.array([wrong_share]), wrong_kinds, rng)
    T = rig.T_right_left
    drawer = MatchDrawer(
        lambda _, px: rig.left.unproject(px),
        lambda _, points: visible_px(rig.right, points),
        SE3(T.R[None], T.t[None]),
        np.array([rig.left.size_wh]),
        np.array([rig.right.size_wh]),
        planes,
        np.array([noise_px]),
    )
    left_px, right_px, is_present = drawer.draw(kinds, rng)
    here = is_present[0]
    return _as_evidence(rig, (left_px[0, here], right_px[0, here]), kinds[0, here] == RIGHT, noise_px)


def _as_evidence(
    rig: StereoRig, points_px: tuple[ndarray, ndarray], is_right: Bool[ndarray, "n"], noise_px: float
) -> SimulatedMatches:
    pair = np.zeros(len(is_right), dtype=int)
    matches = PointMatches(*points_px, pair, ("0",), rig.left.size_wh, rig.right.size_wh)
    return SimulatedMatches(rig, matches, is_right, noise_px)


def _log_uniform(limits: Range, n: int, rng: np.random.Generator) -> Float[ndarray, "n"]:
    low, high = np.log(limits)
    return np.exp(rng.uniform(low, high, n))


def _check_names(names: Iterable[str], known: Iterable[str], what: str) -> None:
    for name in names:
        if name not in known:
            raise ValueError(f"unknown {what} {name!r}; known: {', '.join(known)}")
