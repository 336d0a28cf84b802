"""What focal length and principal point from families of lines are good for.

Three things are uncertain beside the ends' noise. Errors of segments are alike within a region of the images (a lens that is not
taken out, a wall that bends), so whole regions count as one draw, through all images. What is built is not at right angles exactly,
and in all images of one building by the same. And the priors were counted as knowledge. Source: Huber 1967 (sandwich), White 1980;
Liang & Zeger 1986 for sums over groups; the implicit function theorem for right angles.
"""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.shapes import Float, Int
from binocal.solvers import robust
from binocal.solvers.manhattan import N_SHARED, ManhattanEquations, ManhattanEstimate, ManhattanProblem


def shared_covariance(
    problem: ManhattanProblem,
    estimate: ManhattanEstimate,
    equations: ManhattanEquations,
    regions: Int[ndarray, "n"],
    right_angle_sigma_rad: float,
) -> Float[ndarray, "3 3"]:
    """Covariance of log f, cx, cy (pixels), all turns free: the largest of noise, segments' and regions' scatter; and right angles."""
    J = problem.jacobian(equations)
    r = equations.residuals
    inverse = _inverse(problem, equations, J)
    scores = J * (equations.weights * r)[:, None]
    prior = np.zeros_like(inverse)
    prior[range(N_SHARED), range(N_SHARED)] = problem.prior.precision
    used = max(int((equations.weights > 0).sum()), 1)
    by_segment = inverse @ (scores.T @ scores * used / max(used - len(inverse), 1) + prior) @ inverse
    sums = np.stack([scores[regions == k].sum(axis=0) for k in np.unique(regions)])
    by_region = inverse @ (sums.T @ sums * len(sums) / max(len(sums) - 1, 1) + prior) @ inverse
    random = bound(problem, equations)
    for scattered in (by_segment, by_region):
        random = _larger(random, scattered[:N_SHARED, :N_SHARED])
    turned = inverse @ (J * equations.weights[:, None]).T
    skewed = np.zeros((N_SHARED, N_SHARED))
    by_skew = _by_skew(problem, estimate, equations)
    for image in range(problem.n_images):
        own = problem.image == image
        A = (turned[:, own] @ by_skew[own])[:N_SHARED]
        skewed += A @ A.T
    # all images may show one building: their errors then add instead of averaging out, at most to this (Cauchy-Schwarz)
    return random + right_angle_sigma_rad**2 * problem.n_images * skewed


def bound(problem: ManhattanProblem, equations: ManhattanEquations) -> Float[ndarray, "3 3"]:
    """Cramér-Rao bound of log f, cx, cy where every segment that carries weight is of its family, priors counted."""
    H = problem.information(equations, (equations.weights > 0).astype(float))
    size = np.sqrt(np.maximum(np.diagonal(H), 1e-300))
    return (np.linalg.inv(H / np.outer(size, size) + 1e-12 * np.eye(len(H))) / np.outer(size, size))[
        :N_SHARED, :N_SHARED
    ]


def _inverse(
    problem: ManhattanProblem, equations: ManhattanEquations, J: Float[ndarray, "n q"]
) -> Float[ndarray, "q q"]:
    """Of the robust cost's second derivatives, without the residuals' own curvature; of the weights' where that is indefinite."""
    q2 = np.minimum(equations.residuals**2 / robust.TUKEY_END**2, 1.0)
    for curvature in ((1 - q2) * (1 - 5 * q2), equations.weights):
        H = problem.information(equations, curvature)
        size = np.sqrt(np.maximum(np.diagonal(H), 1e-300))
        scaled = H / np.outer(size, size)
        if np.linalg.eigvalsh(scaled)[0] > 1e-6:
            break
    return np.linalg.inv(scaled + 1e-12 * np.eye(len(H))) / np.outer(size, size)


def _larger(first: Float[ndarray, "k k"], second: Float[ndarray, "k k"]) -> Float[ndarray, "k k"]:
    """The first, grown to the second's variances where those are larger."""
    grow = np.sqrt(np.maximum(np.diagonal(second) / np.diagonal(first), 1.0))
    return first * np.outer(grow, grow)


def _by_skew(
    problem: ManhattanProblem, estimate: ManhattanEstimate, equations: ManhattanEquations
) -> Float[ndarray, "n 3"]:
    """Derivatives of residuals by turns of family 2 towards 1, 3 towards 1, 3 towards 2."""
    R = estimate.rotations[problem.image]
    rows = np.arange(len(R))
    _, by_point = problem.forms.distances_of_own(R[rows, :, equations.family] @ estimate.K.T)
    by_direction = by_point @ estimate.K
    out = np.zeros((len(R), 3))
    for k, (family, towards) in enumerate(((1, 0), (2, 0), (2, 1))):
        is_of = equations.family == family
        out[is_of, k] = np.sum(by_direction[is_of] * R[is_of, :, towards], axis=1)
    return out
