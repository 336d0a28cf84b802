"""What a relative pose from matches is good for: regions of the images drawn again, and what the intrinsics are uncertain by.

Errors of matches are alike within a region of the images (a lens that its model does not follow, a surface, a repeated structure);
the noise of single matches is 10 to 60 times too small an error. So whole regions are drawn, each through all pairs. And the
intrinsics that were held have errors of their own, which go straight into the pose. Source: Efron & Tibshirani 1993 (block
bootstrap), one Newton step for each draw; the implicit function theorem for the intrinsics.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.cameras import Camera
from binocal.shapes import Float, Int
from binocal.solvers.epipolar import EpipolarEquations, EpipolarProblem
from binocal.solvers.relative_pose import RelativePose

REGIONS = (4, 3)  # columns and rows of the left image
DRAWS = 400
LEAST_OF_A_PAIR = 20  # matches that have a part, for its own pose to be asked for
STEP_SHARE = 0.5  # of a standard deviation of an intrinsic, either way, for its derivative


def regions_of(left_px: Float[ndarray, "n 2"], size_wh: tuple[int, int]) -> Int[ndarray, "n"]:
    """Which region of the left image each match lies in."""
    place = np.floor(left_px / np.array(size_wh) * REGIONS).astype(int)
    place = np.clip(place, 0, np.array(REGIONS) - 1)
    return place[:, 1] * REGIONS[0] + place[:, 0]


def covariance_by_regions(
    equations: EpipolarEquations, regions: Int[ndarray, "n"], rng: np.random.Generator
) -> Float[ndarray, "5 5"]:
    """Covariance of the five unknowns from draws of whole regions, the kernel's weights held."""
    _, draws = draws_of_regions(equations.jacobian, equations.weights, equations.residuals_px, regions, rng)
    n_regions = len(np.unique(regions))
    return draws.T @ draws / DRAWS * (n_regions / max(n_regions - 1, 1))


def covariance_between_pairs(equations: EpipolarEquations, pair: Int[ndarray, "n"]) -> Float[ndarray, "5 5"] | None:
    """Covariance of the five unknowns from how pairs pull at their common minimum (delete-one-pair jackknife, one Newton step each).

    It counts what a pair's matches have in common: exposures that are apart on a moving car, a rig that flexes. None with one pair.
    """
    present = np.unique(pair[equations.weights > 0])
    if len(present) < 2:
        return None
    J, w, r = equations.jacobian, equations.weights, equations.residuals_px
    own = [pair == k for k in present]
    H = np.stack([J[k].T @ (w[k, None] * J[k]) for k in own])
    g = np.stack([-J[k].T @ (w[k] * r[k]) for k in own])
    size = np.sqrt(np.maximum(np.diagonal(H.sum(axis=0)), 1e-300))
    H, g = H / size[:, None] / size, g / size
    ridge = 1e-9 * np.eye(5)
    without = np.linalg.solve(H.sum(axis=0) - H + ridge, (g.sum(axis=0) - g)[..., None])[..., 0] / size
    away = without - without.mean(axis=0)
    share = (len(present) - 1) / len(present)
    return share * away.T @ away


@dataclass(frozen=True, slots=True)
class PairsApart:
    """How much of the residuals a pose for each pair would take away: RMS in pixels, and over what errors alike in a region explain."""

    apart_px: float
    share: float
    over_regions: float


def pairs_apart(equations: EpipolarEquations, pair: Int[ndarray, "n"], regions: Int[ndarray, "n"]) -> PairsApart | None:
    """Whether pairs pull at their common minimum by more than their matches err, regions of each pair apart; None with one pair.

    To first order, the kernel's weights held: a pair's own pose takes g' H^-1 g off its squared residuals, of which the scatter of
    its regions' gradients at its own minimum explains the trace of H^-1 S.
    """
    J, w, r = equations.jacobian, equations.weights, equations.residuals_px
    taken = explained = 0.0
    n_pairs = 0
    for k in np.unique(pair[w > 0]):
        own = (pair == k) & (w > 0)
        if own.sum() < LEAST_OF_A_PAIR:
            continue
        n_pairs += 1
        root = np.sqrt(w[own])
        basis, _ = np.linalg.qr(root[:, None] * J[own] / np.maximum(np.linalg.norm(J[own], axis=0), 1e-300))
        residuals = root * r[own]
        pulls = basis.T @ residuals
        left = residuals - basis @ pulls
        present, place = np.unique(regions[own], return_inverse=True)
        scores = np.zeros((len(present), 5))
        np.add.at(scores, place, basis * left[:, None])
        taken += float(pulls @ pulls)
        explained += float((scores**2).sum()) * len(present) / max(len(present) - 1, 1)
    if n_pairs < 2:
        return None
    total = float(w @ r**2)
    beyond = max(taken - explained, 0.0)
    return PairsApart(float(np.sqrt(beyond / w.sum())), beyond / max(total, 1e-300), taken / max(explained, 1e-300))


def draws_of_regions(
    J: Float[ndarray, "n q"],
    weights: Float[ndarray, "n"],
    residuals_px: Float[ndarray, "n"],
    regions: Int[ndarray, "n"],
    rng: np.random.Generator,
) -> tuple[Float[ndarray, "q"], Float[ndarray, "d q"]]:
    """The Gauss-Newton step of all matches, and those of draws of whole regions."""
    present = np.unique(regions)
    parts = [(J[regions == k], weights[regions == k], residuals_px[regions == k]) for k in present]
    H = np.stack([A.T @ (w[:, None] * A) for A, w, _ in parts])
    g = np.stack([-A.T @ (w * r) for A, w, r in parts])
    size = np.sqrt(np.maximum(np.diagonal(H.sum(axis=0)), 1e-300))
    H, g = H / size[:, None] / size, g / size
    ridge = 1e-9 * np.eye(J.shape[1])
    counts = rng.multinomial(len(present), np.full(len(present), 1 / len(present)), size=DRAWS).astype(float)
    steps = np.linalg.solve(np.einsum("dk,kij->dij", counts, H) + ridge, (counts @ g)[..., None])[..., 0] / size
    return np.linalg.solve(H.sum(axis=0) + ridge, g.sum(axis=0)) / size, steps


def covariance_of_noise(
    equations: EpipolarEquations, noise_px: Float[ndarray, "*batch"] | float
) -> Float[ndarray, "*batch 5 5"]:
    """What independent noise of the matches leaves: a lower bound."""
    H = equations.information
    size = np.sqrt(np.maximum(np.diagonal(H, axis1=-2, axis2=-1), 1e-300))
    outer = size[..., :, None] * size[..., None, :]
    return np.linalg.inv(H / outer + 1e-12 * np.eye(5)) / outer * np.asarray(noise_px)[..., None, None] ** 2


def slopes_by_intrinsics(
    problem_of: Callable[[tuple[Camera, Camera]], EpipolarProblem],
    cameras: tuple[Camera, Camera],
    estimate: RelativePose,
    sigma: Float[ndarray, "p"],
    n_matches: int,
) -> Float[ndarray, "n p"]:
    """Derivatives of the residuals by the parameters of both cameras, left first; 0 for those without a standard deviation.

    ``problem_of`` gives the problem of the same matches with other cameras.
    """
    n_left = len(cameras[0].parameters)
    slopes = np.zeros((n_matches, len(sigma)))
    for k in np.flatnonzero(sigma > 0):
        side, place = (0, k) if k < n_left else (1, k - n_left)
        step, ends = STEP_SHARE * sigma[k], []
        for sign in (1.0, -1.0):
            moved = cameras[side].parameters.copy()
            moved[place] += sign * step
            other = Camera(cameras[side].model, cameras[side].size_wh, moved)
            ends.append(problem_of((other, cameras[1]) if side == 0 else (cameras[0], other)).residuals_px(estimate))
        slope = (ends[0] - ends[1]) / (2 * step)
        slopes[:, k] = np.where(np.isfinite(slope), slope, 0.0)
    return slopes


def steps_by_intrinsics(equations: EpipolarEquations, slopes: Float[ndarray, "n p"]) -> Float[ndarray, "5 p"]:
    """By how much the five unknowns move for one unit of each parameter of the cameras (the implicit function theorem)."""
    H = equations.information
    size = np.sqrt(np.maximum(np.diagonal(H), 1e-300))
    inverse = np.linalg.inv(H / np.outer(size, size) + 1e-12 * np.eye(5)) / np.outer(size, size)
    return -inverse @ (equations.jacobian * equations.weights[:, None]).T @ slopes
