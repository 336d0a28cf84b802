"""What a scene does not tell of the pose: found by its standard deviation, named, and kept as an old rig has it."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.findings import Finding, finding
from binocal.shapes import Float
from binocal.solvers.epipolar import EpipolarProblem
from binocal.solvers.epipolar_descent import SCHEDULE_PX
from binocal.solvers.relative_pose import RelativePose

UNTOLD_TURN_DEG, UNTOLD_DIRECTION_DEG = 1.0, 12.0
"""Standard deviations above which a scene does not tell a direction of the pose."""
KEPT_STEPS = 5  # pairs of steps under the last kernel
UNIT = np.radians([UNTOLD_TURN_DEG] * 3 + [UNTOLD_DIRECTION_DEG] * 2)


def untold_part(covariance: Float[ndarray, "q q"]) -> Float[ndarray, "5 k"] | None:
    """Directions of the five unknowns, in :data:`UNIT`, that the scene does not tell, at right angles; None if it tells all."""
    values, vectors = np.linalg.eigh(covariance[:5, :5] / np.outer(UNIT, UNIT))
    return vectors[:, values > 1.0] if values[-1] > 1.0 else None


def untold_finding(covariance: Float[ndarray, "q q"], *, is_kept: bool) -> Finding:
    """Names the angle that is told least; ``is_kept``: it stays as an old rig has it."""
    _, vectors = np.linalg.eigh(covariance[:5, :5] / np.outer(UNIT, UNIT))
    sigma = np.degrees(np.sqrt(np.diagonal(covariance)[:5]))
    words = ("pitch", "yaw", "roll", "the direction of T", "the direction of T")
    code = "scene-tells-too-little-kept" if is_kept else "scene-tells-too-little"
    what = words[int(np.argmax(np.abs(vectors[:, -1])))]
    return finding(code, what=what, turn_sigma_deg=float(sigma[:3].max()), direction_sigma_deg=float(sigma[3:].max()))


def with_untold_kept(
    problem: EpipolarProblem, untold: Float[ndarray, "5 k"], old: RelativePose, noise_px: float
) -> RelativePose:
    """The best pose that agrees with the old one in what the scene does not tell."""
    told = np.linalg.svd(untold, full_matrices=True)[0][:, untold.shape[1] :]
    return _refined_along(problem, old, UNIT[:, None] * told, noise_px)


def limited_to_kept(covariance: Float[ndarray, "q q"]) -> Float[ndarray, "q q"]:
    """What was kept is taken to be known to one unit: the old rig's own uncertainty is not asked for."""
    values, vectors = np.linalg.eigh(covariance[:5, :5] / np.outer(UNIT, UNIT))
    scaled = UNIT[:, None] * vectors
    limited = np.array(covariance)
    limited[:5, :5] = scaled @ np.diag(np.minimum(values, 1.0)) @ scaled.T
    return limited


def _refined_along(
    problem: EpipolarProblem, start: RelativePose, told: Float[ndarray, "5 k"], noise_px: float
) -> RelativePose:
    """The best estimate reached by steps in some directions only, the kernel closing as ever."""
    current = start
    if told.shape[1] == 0:
        return current
    for scale_px in (*SCHEDULE_PX, *([noise_px] * KEPT_STEPS)):
        kernel = "tukey" if scale_px == noise_px else "geman"
        for _ in range(2):
            equations = problem.linearize(current, np.asarray(scale_px), kernel)
            J = equations.jacobian @ told
            H = J.T @ (equations.weights[:, None] * J)
            g = -J.T @ (equations.weights * equations.residuals_px)
            current = current.stepped(told @ np.linalg.solve(H + 1e-9 * (np.trace(H) + 1e-9) * np.eye(len(H)), g))
    return current
