"""Rotation and direction of translation between two cameras from points that both saw, intrinsics held.

The residual of a match is its signed Sampson distance in the pixels of the images as they are, lens included: by how much the
points must move, to first order, to lie on one epipolar plane. Five unknowns, two spheres' worth of which nothing else tells: the
scale of the translation has no part in it. Source: Sampson 1982; Hartley & Zisserman 2004, section 11.4.3, here with the
derivatives of rays by pixels in place of the pinhole's.

Its loop is that of every problem (:mod:`binocal.solvers.loop`). What is special is the kernel's scale: half of the matches and more
may be wrong, so that no median tells the noise of the right ones. It is closed in pixels first, 64 to 1, which match noise is
known to lie below, and only then measured.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.cameras import Camera
from binocal.evidence.point_matches import PointMatches
from binocal.geometry import SE3, so3
from binocal.shapes import Bool, Float
from binocal.solvers import robust
from binocal.solvers.minimization import LoopOptions, Minimum, minimize

SCHEDULE_PX = (64.0, 32.0, 16.0, 8.0, 4.0, 2.0, 1.0)
STEPS_EACH = 2
LAST_STEPS = 20
NOISE_FLOOR_PX = 0.02  # no window is matched better; keeps matches on whole rows from passing for exact
MAD_TO_SIGMA = 1.4826
NEAR_PX = 4.0  # beyond it nothing carries weight at the end; the median is then that of matches that may be right


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """Unit rays of one camera's points, and their derivatives by the pixels."""

    directions: Float[ndarray, "n 3"]
    by_pixel: Float[ndarray, "n 3 2"]

    @staticmethod
    def of_points(camera: Camera, points_px: Float[ndarray, "n 2"]) -> Rays:
        """By central differences of half a pixel."""
        by_pixel = [camera.unproject(points_px + half) - camera.unproject(points_px - half) for half in 0.5 * np.eye(2)]
        return Rays(camera.unproject(points_px), np.stack(by_pixel, axis=-1))

    @property
    def is_finite(self) -> Bool[ndarray, "n"]:
        """Whether the lens model has a ray there."""
        finite: Bool[ndarray, "n 3 3"] = np.isfinite(
            np.concatenate([self.directions[..., None], self.by_pixel], axis=-1)
        )
        return finite.reshape(len(finite), -1).min(axis=1)

    def select(self, index: ndarray) -> Rays:
        """Some of them."""
        return Rays(self.directions[index], self.by_pixel[index])


@dataclass(frozen=True, slots=True, eq=False)
class RelativePose:
    """Rotation and unit translation: p_right = R p_left + length t."""

    R: Float[ndarray, "3 3"]
    t: Float[ndarray, "3"]

    @property
    def batch(self) -> tuple[int, ...]:
        """No batch."""
        return ()

    @staticmethod
    def of(T_right_left: SE3) -> RelativePose:
        """Without the length of the translation."""
        return RelativePose(T_right_left.R, T_right_left.t / np.linalg.norm(T_right_left.t))

    def stepped(self, xi: Float[ndarray, "5"]) -> RelativePose:
        """Turned from the left by the first three; the direction of t along the last two of :func:`tangents`."""
        turn = so3.exp(tangents(self.t) @ xi[3:])
        t = turn @ self.t
        return RelativePose(so3.exp(xi[:3]) @ self.R, t / np.linalg.norm(t))


def tangents(t: Float[ndarray, "3"]) -> Float[ndarray, "3 2"]:
    """Two axes about which a turn moves a direction, at right angles to it and to each other."""
    first = np.cross(t, np.eye(3)[int(np.argmin(np.abs(t)))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(t, first)], axis=1)


def turn_of_direction(start: Float[ndarray, "3"], end: Float[ndarray, "3"]) -> Float[ndarray, "2"]:
    """The turn about the two :func:`tangents` of one direction that takes it to another, radians."""
    axis = np.cross(start, end)
    length = float(np.linalg.norm(axis))
    return tangents(start).T @ axis * (np.arctan2(length, float(start @ end)) / max(length, 1e-300))


@dataclass(frozen=True, slots=True, eq=False)
class PosePrior:
    """Where a pose was, and by how much it may have moved: one standard deviation of each angle of R, and of the direction of t.

    Noise is taken to be the kernel's scale: a wide kernel, under which wrong matches pull with full weight, hardly moves what matches
    hardly tell; one of a pixel does not feel the prior.
    """

    pose: RelativePose
    turn_rad: float
    direction_rad: float

    @property
    def precision(self) -> Float[ndarray, "5"]:
        """1 / variance of the five unknowns."""
        return np.r_[[self.turn_rad**-2] * 3, [self.direction_rad**-2] * 2]

    def step_back(self, estimate: RelativePose) -> Float[ndarray, "5"]:
        """The step that takes an estimate to the prior's pose; its square has the exact gradient that a step's has."""
        return np.r_[so3.log(self.pose.R @ estimate.R.T), turn_of_direction(estimate.t, self.pose.t)]


@dataclass(frozen=True, slots=True, eq=False)
class EpipolarEquations:
    """Residuals, weights and normal equations (see :class:`binocal.solvers.problem.Equations`)."""

    residuals_px: Float[ndarray, "n"]
    jacobian: Float[ndarray, "n 5"]
    weights: Float[ndarray, "n"]
    cost_px2: Float[ndarray, "*batch"]
    precision_px2: Float[ndarray, "5"]
    """Of the prior, in units of the kernel's squared scale; 0 without one."""
    step_back: Float[ndarray, "5"]
    scale_px: Float[ndarray, "*batch"]

    @property
    def r2_px2(self) -> tuple[Float[ndarray, "n"], ...]:
        """Squared residuals."""
        return (self.residuals_px**2,)

    def cost_under(self, scale_px: Float[ndarray, "*batch"], kernel: robust.Kernel) -> Float[ndarray, "*batch"]:
        """Robust cost of the same residuals under another scale of the kernel."""
        energy = 0.5 * self.precision_px2 @ self.step_back**2 * (scale_px / self.scale_px) ** 2
        return np.asarray(robust.costs(self.residuals_px**2, scale_px, kernel).sum() + energy)

    @property
    def information(self) -> Float[ndarray, "5 5"]:
        """Of the unknowns, for unit noise, by the kernel's weights and the prior."""
        return self.jacobian.T @ (self.weights[:, None] * self.jacobian) + np.diag(self.precision_px2)

    @property
    def downhill(self) -> Float[ndarray, "5"]:
        """The negative gradient of the cost."""
        return self.precision_px2 * self.step_back - self.jacobian.T @ (self.weights * self.residuals_px)


@dataclass(frozen=True, slots=True, eq=False)
class EpipolarStep:
    """A step of the unknowns, and the fall of the cost that it predicts."""

    xi: Float[ndarray, "5"]
    predicted_px2: Float[ndarray, "*batch"]


@dataclass(frozen=True, slots=True, eq=False)
class EpipolarProblem:
    """Matches of a pair of cameras (:class:`binocal.solvers.problem.Problem`). ``scale_px``: the noise to assume; None: measured."""

    left: Rays
    right: Rays
    counts: Float[ndarray, "n"] | None = None
    """How often each match counts; None: once."""
    scale_px: float | None = None
    prior: PosePrior | None = None

    @staticmethod
    def of_matches(cameras: tuple[Camera, Camera], matches: PointMatches) -> tuple[EpipolarProblem, Bool[ndarray, "n"]]:
        """The problem of the matches for which both lens models have rays, and which they are."""
        left, right = (Rays.of_points(c, p) for c, p in zip(cameras, (matches.left_px, matches.right_px), strict=True))
        is_seen = left.is_finite & right.is_finite
        return EpipolarProblem(left.select(is_seen), right.select(is_seen)), is_seen

    def select(self, index: ndarray) -> EpipolarProblem:
        """Some of the matches."""
        counts = None if self.counts is None else self.counts[index]
        return replace(self, left=self.left.select(index), right=self.right.select(index), counts=counts)

    def residuals_px(self, estimate: RelativePose) -> Float[ndarray, "n"]:
        """Signed Sampson distances."""
        value, length, _, _ = self._terms(so3.hat(estimate.t) @ estimate.R)
        return value / length

    def _terms(self, E: Float[ndarray, "3 3"]):  # type: ignore[no-untyped-def]
        """x_rᵀ E x_l, the length of its gradient by the pixels, and the gradients."""
        x, y = self.left.directions, self.right.directions
        plane, back = x @ E.T, y @ E
        value = np.einsum("ni,ni->n", y, plane)
        by_left = np.einsum("ni,nik->nk", back, self.left.by_pixel)
        by_right = np.einsum("ni,nik->nk", plane, self.right.by_pixel)
        length = np.sqrt(np.maximum(np.sum(by_left**2, axis=1) + np.sum(by_right**2, axis=1), 1e-300))
        return value, length, by_left, by_right

    def residual_lengths2(self, estimate: RelativePose) -> tuple[Float[ndarray, "n"], ...]:
        """Squared residuals."""
        return (self.residuals_px(estimate) ** 2,)

    def noise_estimate_px(self, r2_px2: tuple[ndarray, ...]) -> Float[ndarray, "*batch"]:
        """The noise to assume, or the median absolute residual as a standard deviation, floored."""
        if self.scale_px is not None:
            return np.asarray(self.scale_px)
        return np.asarray(max(MAD_TO_SIGMA * float(np.sqrt(np.median(r2_px2[0]))), NOISE_FLOOR_PX))

    def linearize(
        self, estimate: RelativePose, scale_px: Float[ndarray, "*batch"], kernel: robust.Kernel
    ) -> EpipolarEquations:
        """Residuals, their derivatives by the five unknowns, and the kernel's weights."""
        E = so3.hat(estimate.t) @ estimate.R
        value, length, by_left, by_right = self._terms(E)
        s = value / length
        columns = []
        basis = tangents(estimate.t)
        x, y = self.left.directions, self.right.directions
        for turned in (
            *(so3.hat(estimate.t) @ so3.hat(axis) @ estimate.R for axis in np.eye(3)),
            *(so3.hat(np.cross(axis, estimate.t)) @ estimate.R for axis in basis.T),
        ):
            plane, back = x @ turned.T, y @ turned
            d_value = np.einsum("ni,ni->n", y, plane)
            d_left = np.einsum("ni,nik->nk", back, self.left.by_pixel)
            d_right = np.einsum("ni,nik->nk", plane, self.right.by_pixel)
            d_length = (np.sum(by_left * d_left, axis=1) + np.sum(by_right * d_right, axis=1)) / length
            columns.append((d_value - s * d_length) / length)
        counts = 1.0 if self.counts is None else self.counts
        weights = counts * robust.weights(s**2, scale_px, kernel)
        precision, back = np.zeros(5), np.zeros(5)
        if self.prior is not None:
            precision, back = float(scale_px) ** 2 * self.prior.precision, self.prior.step_back(estimate)
        cost = np.sum(counts * robust.costs(s**2, scale_px, kernel)) + 0.5 * precision @ back**2
        return EpipolarEquations(s, np.stack(columns, axis=1), weights, np.asarray(cost), precision, back, scale_px)

    def solve_step(
        self, estimate: RelativePose, equations: EpipolarEquations, damping: Float[ndarray, "*batch"]
    ) -> EpipolarStep:
        """Levenberg-Marquardt step with Marquardt's scaling."""
        H = equations.information
        g = equations.downhill
        size = np.sqrt(np.maximum(np.diagonal(H), 1e-300))
        A = H / np.outer(size, size) + (float(damping) + 1e-12) * np.eye(5)
        try:
            xi = np.linalg.solve(A, g / size) / size
        except np.linalg.LinAlgError:
            return EpipolarStep(np.full(5, np.nan), np.asarray(np.nan))
        fall = xi @ g - 0.5 * xi @ H @ xi
        return EpipolarStep(xi, np.asarray(fall))

    def retract(self, estimate: RelativePose, step: EpipolarStep) -> RelativePose:
        """The estimate moved by a step."""
        return estimate.stepped(step.xi)

    def shared_information(self, estimate: RelativePose, equations: EpipolarEquations) -> Float[ndarray, "5 5"]:
        """Information of the unknowns for unit noise."""
        return equations.information


EpipolarMinimum = Minimum[RelativePose, EpipolarEquations]


def descend(
    problem: EpipolarProblem,
    start: RelativePose,
    schedule_px: tuple[float, ...] = SCHEDULE_PX,
    prior: PosePrior | None = None,
) -> RelativePose:
    """The estimate after the kernel has closed in pixels (Geman & McClure 1985), held by what is known of the pose."""
    known = replace(problem, scale_px=1.0, prior=prior)
    estimate = start
    for scale_px in schedule_px:
        options = LoopOptions("geman", scale_px, STEPS_EACH, initial_damping=1e-6)
        estimate = minimize(known, estimate, options, scale_px=scale_px).estimate
    return estimate


def finish(problem: EpipolarProblem, start: RelativePose) -> EpipolarMinimum:
    """The minimum under Tukey's kernel, its scale from the residuals of what is left within a few pixels.

    NOT checked: that anything is.
    """
    near = np.abs(problem.residuals_px(start)) < NEAR_PX
    part = replace(problem.select(near), scale_px=None)
    return minimize(part, start, LoopOptions("tukey", max_iterations=LAST_STEPS, tolerance_sigma=0.005))


def cost_at(problem: EpipolarProblem, estimate: RelativePose, scale_px: float = 1.0) -> float:
    """Geman and McClure's cost, by which starts compete, in squares of the scale."""
    return float(robust.costs(problem.residuals_px(estimate) ** 2, np.asarray(scale_px), "geman").sum()) / scale_px**2


def parallax_and_sides(
    problem: EpipolarProblem, estimate: RelativePose
) -> tuple[Float[ndarray, "n"], Float[ndarray, "n"]]:
    """By how many pixels points lie from where they would at infinity, and 1 where they are in front of both cameras, else -1."""
    x, y = problem.left.directions @ estimate.R.T, problem.right.directions
    across = np.cross(x, y)
    # x a + t = y b: depths from both rays, signs only
    normal = np.maximum(np.sum(across**2, axis=1), 1e-300)
    a = np.einsum("ni,ni->n", np.cross(y, estimate.t[None]), across) / normal
    b = np.einsum("ni,ni->n", np.cross(x, estimate.t[None]), across) / normal
    pixels = np.linalg.norm(problem.right.by_pixel, axis=1).mean(axis=1)
    return np.sqrt(normal) / pixels, np.where((a > 0) & (b > 0), 1.0, -1.0)
