"""Rotation and direction of translation between two cameras from points that both saw, intrinsics held.

The residual of a match is its signed Sampson distance in the pixels of the images as they are, lens included: by how much the
points must move, to first order, to lie on one epipolar plane. Five unknowns, two spheres' worth of which nothing else tells: the
scale of the translation has no part in it. Source: Sampson 1982; Hartley & Zisserman 2004, section 11.4.3, here with the
derivatives of rays by pixels in place of the pinhole's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.cameras import Camera
from binocal.evidence.point_matches import PointMatches
from binocal.geometry import so3
from binocal.shapes import Bool, Float
from binocal.solvers import robust
from binocal.solvers.relative_pose import PosePrior, PriorPull, RelativePose, tangents

NOISE_FLOOR_PX = 0.02  # no window is matched better; keeps matches on whole rows from passing for exact
MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """Unit rays of one camera's points, and their derivatives by the pixels."""

    directions: Float[ndarray, "*batch n 3"]
    by_pixel: Float[ndarray, "*batch n 3 2"]

    @staticmethod
    def of_points(camera: Camera, points_px: Float[ndarray, "n 2"]) -> Rays:
        """By central differences of half a pixel."""
        by_pixel = [camera.unproject(points_px + half) - camera.unproject(points_px - half) for half in 0.5 * np.eye(2)]
        return Rays(camera.unproject(points_px), np.stack(by_pixel, axis=-1))

    @property
    def is_finite(self) -> Bool[ndarray, "n"]:
        """Whether the lens model has a ray there."""
        with_slopes = np.concatenate([self.directions[..., None], self.by_pixel], axis=-1)
        return np.all(np.isfinite(with_slopes), axis=(-1, -2), keepdims=False)

    def select(self, index: ndarray) -> Rays:
        """Some of them."""
        return Rays(self.directions[index], self.by_pixel[index])


@dataclass(frozen=True, slots=True, eq=False)
class EpipolarEquations:
    """Residuals, weights and normal equations (see :class:`binocal.solvers.problem.Equations`)."""

    residuals_px: Float[ndarray, "*batch n"]
    jacobian: Float[ndarray, "*batch n 5"]
    weights: Float[ndarray, "*batch n"]
    cost_px2: Float[ndarray, "*batch"]
    counts: Float[ndarray, "*batch n"] | None = None
    pull: PriorPull | None = None

    @property
    def r2_px2(self) -> tuple[Float[ndarray, "*batch n"], ...]:
        """Squared residuals."""
        return (self.residuals_px**2,)

    def under(self, scale_px: Float[ndarray, "*batch"], kernel: robust.Kernel) -> EpipolarEquations:
        """The same residuals with the weights and cost of a kernel."""
        r2, scale = self.residuals_px**2, np.asarray(scale_px)[..., None]
        weights, costs = robust.weights(r2, scale, kernel), robust.costs(r2, scale, kernel)
        if self.counts is not None:
            weights, costs = self.counts * weights, self.counts * costs
        cost = np.asarray(costs.sum(axis=-1))
        if self.pull is None:
            return replace(self, weights=weights, cost_px2=cost)
        pull = replace(self.pull, scale_px=np.asarray(scale_px))
        return replace(self, weights=weights, cost_px2=cost + pull.cost_px2, pull=pull)

    def cost_under(self, scale_px: Float[ndarray, "*batch"], kernel: robust.Kernel) -> Float[ndarray, "*batch"]:
        """Robust cost of the same residuals under another scale of the kernel."""
        costs = robust.costs(self.residuals_px**2, np.asarray(scale_px)[..., None], kernel)
        cost = np.asarray((costs if self.counts is None else self.counts * costs).sum(axis=-1))
        return cost if self.pull is None else cost + replace(self.pull, scale_px=np.asarray(scale_px)).cost_px2

    @property
    def information(self) -> Float[ndarray, "*batch 5 5"]:
        """Of the unknowns, for unit noise, by the kernel's weights and the prior."""
        H = self.jacobian.swapaxes(-1, -2) @ (self.weights[..., None] * self.jacobian)
        return H if self.pull is None else H + self.pull.information_px2[..., None] * np.eye(5)

    @property
    def downhill(self) -> Float[ndarray, "*batch 5"]:
        """The negative gradient of the cost."""
        g = -np.einsum("...nk,...n->...k", self.jacobian, self.weights * self.residuals_px)
        return g if self.pull is None else g + self.pull.downhill_px2


@dataclass(frozen=True, slots=True, eq=False)
class EpipolarStep:
    """A step of the unknowns, and the fall of the cost that it predicts."""

    xi: Float[ndarray, "*batch 5"]
    predicted_px2: Float[ndarray, "*batch"]


@dataclass(frozen=True, slots=True, eq=False)
class EpipolarProblem:
    """Matches of a pair of cameras, or a batch of such sets (:class:`binocal.solvers.problem.Problem`).

    One set may be asked for a batch of estimates. ``scale_px``: the noise to assume; None: measured.
    """

    left: Rays
    right: Rays
    counts: Float[ndarray, "*batch n"] | None = None
    """How often each match counts, 0 for those that fill up the shorter sets of a batch; None: once."""
    scale_px: float | None = None
    prior: PosePrior | None = None

    @staticmethod
    def of_matches(cameras: tuple[Camera, Camera], matches: PointMatches) -> tuple[EpipolarProblem, Bool[ndarray, "n"]]:
        """The problem of the matches for which both lens models have rays, and which they are."""
        left, right = (Rays.of_points(c, p) for c, p in zip(cameras, (matches.left_px, matches.right_px), strict=True))
        is_seen = left.is_finite & right.is_finite
        return EpipolarProblem(left.select(is_seen), right.select(is_seen)), is_seen

    def n_matches(self, batch: tuple[int, ...]) -> Float[ndarray, "*batch"]:
        """How many matches there are, for each of a batch of estimates."""
        n = float(self.left.directions.shape[-2]) if self.counts is None else self.counts.sum(axis=-1)
        return np.broadcast_to(np.asarray(n), batch)

    def select(self, index: ndarray) -> EpipolarProblem:
        """Some of the matches of one set."""
        counts = None if self.counts is None else self.counts[index]
        return replace(self, left=self.left.select(index), right=self.right.select(index), counts=counts)

    def residuals_px(self, estimate: RelativePose) -> Float[ndarray, "*batch n"]:
        """Signed Sampson distances."""
        value, length, *_ = self._terms(so3.hat(estimate.t) @ estimate.R)
        return value / length

    def _terms(self, E: Float[ndarray, "*batch 3 3"]):  # type: ignore[no-untyped-def]
        """x_rᵀ E x_l, the length of its gradient by the pixels, and the gradients."""
        x, y = self.left.directions, self.right.directions
        plane, back = x @ E.swapaxes(-1, -2), y @ E
        value = np.einsum("...i,...i->...", y, plane)
        by_left = np.einsum("...i,...ik->...k", back, self.left.by_pixel)
        by_right = np.einsum("...i,...ik->...k", plane, self.right.by_pixel)
        squared = np.einsum("...k,...k->...", by_left, by_left) + np.einsum("...k,...k->...", by_right, by_right)
        return value, np.sqrt(np.maximum(squared, 1e-300)), by_left, by_right

    def residual_lengths2(self, estimate: RelativePose) -> tuple[Float[ndarray, "*batch n"], ...]:
        """Squared residuals."""
        return (self.residuals_px(estimate) ** 2,)

    def noise_estimate_px(self, r2_px2: tuple[ndarray, ...]) -> Float[ndarray, "*batch"]:
        """The noise to assume, or the median absolute residual as a standard deviation, floored."""
        if self.scale_px is not None:
            return np.full(r2_px2[0].shape[:-1], self.scale_px)
        r2 = r2_px2[0] if self.counts is None else np.where(self.counts > 0, r2_px2[0], np.nan)
        return np.asarray(np.maximum(MAD_TO_SIGMA * np.sqrt(np.nanmedian(r2, axis=-1)), NOISE_FLOOR_PX))

    def linearize(
        self, estimate: RelativePose, scale_px: Float[ndarray, "*batch"], kernel: robust.Kernel
    ) -> EpipolarEquations:
        """Residuals, their derivatives by the five unknowns, and the kernel's weights.

        The derivative by the unknowns is that by the nine elements of E times theirs.
        """
        value, length, by_left, by_right = self._terms(so3.hat(estimate.t) @ estimate.R)
        s = value / length
        x, y = self.left.directions, self.right.directions
        # ds = (y' dE x - s dlength) / length, length dlength = by_left . (y' dE dx) + by_right . (dy' dE x)
        across = x - np.einsum("...ik,...k->...i", self.left.by_pixel, by_left * (s / length)[..., None])
        along = np.einsum("...ik,...k->...i", self.right.by_pixel, by_right * (s / length)[..., None])
        by_E = (y[..., :, None] * across[..., None, :] - along[..., :, None] * x[..., None, :]) / length[
            ..., None, None
        ]
        jacobian = by_E.reshape(*by_E.shape[:-2], 9) @ _essential_derivatives(estimate)
        counts = None if self.counts is None else np.broadcast_to(self.counts, s.shape)
        pull = None if self.prior is None else self.prior.pull_on(estimate, np.broadcast_to(scale_px, s.shape[:-1]))
        unweighted = EpipolarEquations(s, jacobian, s, np.zeros(s.shape[:-1]), counts, pull)
        return unweighted.under(scale_px, kernel)

    def solve_step(
        self, estimate: RelativePose, equations: EpipolarEquations, damping: Float[ndarray, "*batch"]
    ) -> EpipolarStep:
        """Levenberg-Marquardt step with Marquardt's scaling; NaN where the equations are not finite."""
        H = equations.information
        g = equations.downhill
        size = np.sqrt(np.maximum(np.diagonal(H, axis1=-2, axis2=-1), 1e-300))
        A = H / (size[..., :, None] * size[..., None, :])
        A = A + (np.asarray(damping) + 1e-12)[..., None, None] * np.eye(5)
        is_sound = np.asarray(np.isfinite(A).all(axis=(-1, -2)) & np.isfinite(g).all(axis=-1))
        A = np.where(is_sound[..., None, None], A, np.eye(5))
        xi = np.linalg.solve(A, (g / size)[..., None])[..., 0] / size
        xi = np.where(is_sound[..., None], xi, np.nan)
        fall = np.einsum("...i,...i->...", xi, g) - 0.5 * np.einsum("...i,...ij,...j->...", xi, H, xi)
        return EpipolarStep(xi, np.asarray(fall))

    def retract(self, estimate: RelativePose, step: EpipolarStep) -> RelativePose:
        """The estimate moved by a step."""
        return estimate.stepped(step.xi)

    def shared_information(self, estimate: RelativePose, equations: EpipolarEquations) -> Float[ndarray, "*batch 5 5"]:
        """Information of the unknowns for unit noise."""
        return equations.information


def _essential_derivatives(estimate: RelativePose) -> Float[ndarray, "*batch 9 5"]:
    """Derivatives of the elements of E, row by row, by the five unknowns of :meth:`RelativePose.stepped`."""
    across, R = so3.hat(estimate.t)[..., None, :, :], estimate.R[..., None, :, :]
    by_rotation = across @ so3.hat(np.eye(3)) @ R
    moved = np.cross(tangents(estimate.t).swapaxes(-1, -2), estimate.t[..., None, :])
    both = np.concatenate([by_rotation, so3.hat(moved) @ R], axis=-3)
    return both.reshape(*both.shape[:-2], 9).swapaxes(-1, -2)


def parallax_and_sides(
    problem: EpipolarProblem, estimate: RelativePose
) -> tuple[Float[ndarray, "*batch n"], Float[ndarray, "*batch n"]]:
    """By how many pixels points lie from where they would at infinity, and 1 where they are in front of both cameras, else -1."""
    x, y = problem.left.directions @ estimate.R.swapaxes(-1, -2), problem.right.directions
    across = np.cross(x, y)
    # x a + t = y b: depths from both rays, signs only
    normal = np.maximum(np.sum(across**2, axis=-1), 1e-300)
    t = estimate.t[..., None, :]
    a = np.sum(np.cross(y, t) * across, axis=-1)
    b = np.sum(np.cross(x, t) * across, axis=-1)
    pixels = np.linalg.norm(problem.right.by_pixel, axis=-2).mean(axis=-1)
    return np.sqrt(normal) / pixels, np.where((a > 0) & (b > 0), 1.0, -1.0)
