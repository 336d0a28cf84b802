"""Focal length and principal point from segments of three orthogonal families, one camera, several images.

Each image has a rotation of its own, the columns of which are the directions of its families (a "Manhattan world", Coughlan & Yuille
1999); their vanishing points are K R e, and K with square pixels and no skew is common to all (eqs 7-10: the columns of R being
orthogonal is gᵀ ω h = 0). The residual of a segment is its distance from the nearest of the three points, in standard deviations of
its ends (:mod:`binocal.geometry.vanishing`).

Its loop is that of every problem (:mod:`binocal.solvers.loop`). Weak priors on the shared unknowns belong to the problem: without
them families at infinity leave it singular.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.geometry import so3
from binocal.geometry.vanishing import PencilForms
from binocal.shapes import Bool, Float, Int
from binocal.solvers import robust
from binocal.solvers.minimization import LoopOptions, Minimum, minimize

SCHEDULE_SIGMA = (8.0, 4.0, 2.0)
STEPS_EACH = 4
LAST_STEPS = 40
N_SHARED = 3


@dataclass(frozen=True, slots=True, eq=False)
class ManhattanEstimate:
    """Focal length and principal point in pixels, and T's rotation ``R_camera_scene`` of each image."""

    focal_px: float
    centre_px: Float[ndarray, "2"]
    rotations: Float[ndarray, "images 3 3"]

    @property
    def batch(self) -> tuple[int, ...]:
        """No batch."""
        return ()

    @property
    def K(self) -> Float[ndarray, "3 3"]:
        """Pinhole matrix."""
        return np.array([[self.focal_px, 0, self.centre_px[0]], [0, self.focal_px, self.centre_px[1]], [0, 0, 1]])

    @property
    def points(self) -> Float[ndarray, "images 3 3"]:
        """Vanishing points of the three families of each image in rows, homogeneous."""
        return (self.K @ self.rotations).transpose(0, 2, 1)

    def stepped(self, xi: Float[ndarray, "q"]) -> ManhattanEstimate:
        """Moved by steps of log f, cx, cy, and a turn from the left for each image."""
        turns = so3.exp(xi[N_SHARED:].reshape(-1, 3))
        step = float(np.clip(xi[0], -0.5, 0.5))
        return ManhattanEstimate(self.focal_px * float(np.exp(step)), self.centre_px + xi[1:3], turns @ self.rotations)


@dataclass(frozen=True, slots=True, eq=False)
class SharedPrior:
    """Weak knowledge: the principal point near the image's centre, and the order of magnitude of the focal length."""

    focal_px: float
    log_focal_sigma: float
    centre_px: Float[ndarray, "2"]
    centre_sigma_px: float

    @property
    def precision(self) -> Float[ndarray, "3"]:
        """Of log f, cx, cy."""
        return np.array([self.log_focal_sigma, self.centre_sigma_px, self.centre_sigma_px]) ** -2.0

    def away(self, estimate: ManhattanEstimate) -> Float[ndarray, "3"]:
        """The estimate's step from what is expected."""
        return np.r_[np.log(estimate.focal_px / self.focal_px), estimate.centre_px - self.centre_px]

    def energy(self, estimate: ManhattanEstimate) -> float:
        """Half the squared distance in standard deviations."""
        return 0.5 * float(self.precision @ self.away(estimate) ** 2)


@dataclass(frozen=True, slots=True, eq=False)
class ManhattanEquations:
    """Residuals, weights and normal equations (see :class:`binocal.solvers.problem.Equations`); pixels read standard deviations."""

    residuals: Float[ndarray, "n"]
    family: Int[ndarray, "n"]
    by_shared: Float[ndarray, "n 3"]
    by_turn: Float[ndarray, "n 3"]
    weights: Float[ndarray, "n"]
    prior_energy: float
    cost_px2: Float[ndarray, "*batch"]

    @property
    def r2_px2(self) -> tuple[Float[ndarray, "n"], ...]:
        """Squared residuals."""
        return (self.residuals**2,)

    def cost_under(self, scale_px: Float[ndarray, "*batch"], kernel: robust.Kernel) -> Float[ndarray, "*batch"]:
        """Robust cost of the same residuals under another scale of the kernel."""
        return np.asarray(robust.costs(self.residuals**2, scale_px, kernel).sum() + self.prior_energy)


@dataclass(frozen=True, slots=True, eq=False)
class ManhattanStep:
    """A step of the unknowns, and the fall of the cost that it predicts."""

    xi: Float[ndarray, "q"]
    predicted_px2: Float[ndarray, "*batch"]


@dataclass(frozen=True, slots=True, eq=False)
class ManhattanProblem:
    """Segments of one camera (:class:`binocal.solvers.problem.Problem`); residuals are in standard deviations, their scale is 1.

    ``counts`` says which of the three families of each image its segments may belong to.
    """

    forms: PencilForms
    image: Int[ndarray, "n"]
    counts: Bool[ndarray, "images 3"]
    prior: SharedPrior

    @property
    def n_images(self) -> int:
        """How many images."""
        return len(self.counts)

    def distances(self, estimate: ManhattanEstimate) -> Float[ndarray, "n 3"]:
        """Of each segment to its image's three points; infinite to those that do not count."""
        points = estimate.points[self.image]
        variance = np.einsum("nki,nij,nkj->nk", points, self.forms.variance, points, optimize=True)
        distances = np.einsum("nki,ni->nk", points, self.forms.value) / np.sqrt(np.maximum(variance, 1e-300))
        return np.where(self.counts[self.image], distances, np.inf)

    def log_odds(self, estimate: ManhattanEstimate) -> Float[ndarray, "n"]:
        """Evidence of each segment for the families of its image."""
        (r2,) = self.residual_lengths2(estimate)
        n_families = self.counts.sum(axis=1)[self.image]
        return self.forms.evidence(r2, n_families)

    def residual_lengths2(self, estimate: ManhattanEstimate) -> tuple[Float[ndarray, "n"], ...]:
        """Squared distance to the nearest point."""
        return ((self.distances(estimate) ** 2).min(axis=1),)

    def noise_estimate_px(self, r2_px2: tuple[ndarray, ...]) -> Float[ndarray, "*batch"]:
        """1: the segments' covariances are the noise."""
        return np.asarray(1.0)

    def linearize(
        self, estimate: ManhattanEstimate, scale_px: Float[ndarray, "*batch"], kernel: robust.Kernel
    ) -> ManhattanEquations:
        """Residuals, their derivatives by log f, cx, cy and the image's turn, and the kernel's weights."""
        family = np.abs(self.distances(estimate)).argmin(axis=1)
        d = estimate.rotations[self.image, :, family]
        r, by_point = self.forms.distances_of_own(d @ estimate.K.T)
        f, depth = estimate.focal_px, d[:, 2:]
        by_shared = np.concatenate(
            [f * np.sum(by_point[:, :2] * d[:, :2], axis=1, keepdims=True), by_point[:, :2] * depth], axis=1
        )
        by_turn = np.cross(d, by_point @ estimate.K)
        weights = robust.weights(r**2, scale_px, kernel)
        energy = self.prior.energy(estimate)
        cost = np.sum(robust.costs(r**2, scale_px, kernel)) + energy
        return ManhattanEquations(r, family, by_shared, by_turn, weights, energy, np.asarray(cost))

    def jacobian(self, equations: ManhattanEquations) -> Float[ndarray, "n q"]:
        """By all unknowns: the shared ones, then each image's turn."""
        J = np.zeros((len(self.image), N_SHARED + 3 * self.n_images))
        J[:, :N_SHARED] = equations.by_shared
        rows = np.arange(len(J))[:, None]
        J[rows, N_SHARED + 3 * self.image[:, None] + np.arange(3)] = equations.by_turn
        return J

    def information(self, equations: ManhattanEquations, weights: Float[ndarray, "n"]) -> Float[ndarray, "q q"]:
        """Normal equations of all unknowns under given weights, the prior's with them."""
        J = self.jacobian(equations)
        H = J.T @ (weights[:, None] * J)
        H[range(N_SHARED), range(N_SHARED)] += self.prior.precision
        return H

    def solve_step(
        self, estimate: ManhattanEstimate, equations: ManhattanEquations, damping: Float[ndarray, "*batch"]
    ) -> ManhattanStep:
        """Levenberg-Marquardt step with Marquardt's scaling."""
        H = self.information(equations, equations.weights)
        g = -self.jacobian(equations).T @ (equations.weights * equations.residuals)
        g[:N_SHARED] -= self.prior.precision * self.prior.away(estimate)
        size = np.sqrt(np.maximum(np.diagonal(H), 1e-300))
        A = H / np.outer(size, size) + (float(damping) + 1e-12) * np.eye(len(H))
        try:
            xi = np.linalg.solve(A, g / size) / size
        except np.linalg.LinAlgError:
            return ManhattanStep(np.full(len(H), np.nan), np.asarray(np.nan))
        return ManhattanStep(xi, np.asarray(xi @ g - 0.5 * xi @ H @ xi))

    def retract(self, estimate: ManhattanEstimate, step: ManhattanStep) -> ManhattanEstimate:
        """The estimate moved by a step."""
        return estimate.stepped(step.xi)

    def shared_information(self, estimate: ManhattanEstimate, equations: ManhattanEquations) -> Float[ndarray, "3 3"]:
        """Of log f, cx, cy, the turns free."""
        H = self.information(equations, equations.weights)
        return H[:3, :3] - H[:3, 3:] @ np.linalg.solve(H[3:, 3:], H[3:, :3])


ManhattanMinimum = Minimum[ManhattanEstimate, ManhattanEquations]


def solve_manhattan(
    problem: ManhattanProblem, start: ManhattanEstimate, schedule: tuple[float, ...] = SCHEDULE_SIGMA
) -> ManhattanMinimum:
    """The minimum under Tukey's kernel, after Geman and McClure's has closed from 8 standard deviations."""
    estimate = start
    for scale in schedule:
        options = LoopOptions("geman", scale, STEPS_EACH, initial_damping=1e-4)
        estimate = minimize(problem, estimate, options, scale_px=scale).estimate
    return minimize(problem, estimate, LoopOptions("tukey", max_iterations=LAST_STEPS, tolerance_sigma=0.005))
