"""What a scene does not tell of the pose: found by its standard deviation, named, and kept as an old rig has it."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.findings import Finding, finding
from binocal.shapes import Float
from binocal.solvers.epipolar import EpipolarProblem
from binocal.solvers.epipolar_descent import SCHEDULE_PX
from binocal.solvers.relative_pose import RelativePose, tangents

UNTOLD_TURN_DEG, UNTOLD_DIRECTION_DEG = 1.0, 12.0
"""Standard deviations above which a scene does not tell a direction of the pose."""
BESIDE = 0.02  # of the squared length of a direction: 8 deg
NAMED_SHARE = 0.01  # of an unknown's square
ANGLES, DIRECTION, PARTS = ("pitch", "yaw", "roll"), "the direction of T", ("sideways", "vertical", "forward")
KEPT_STEPS = 5  # pairs of steps under the last kernel
UNIT = np.radians([UNTOLD_TURN_DEG] * 3 + [UNTOLD_DIRECTION_DEG] * 2)


def untold_part(covariance: Float[ndarray, "q q"]) -> Float[ndarray, "5 k"] | None:
    """Directions of the five unknowns, in :data:`UNIT`, that the scene does not tell, at right angles; None if it tells all."""
    values, vectors = np.linalg.eigh(covariance[:5, :5] / np.outer(UNIT, UNIT))
    return vectors[:, values > 1.0] if values[-1] > 1.0 else None


def as_seen_from(untold: Float[ndarray, "5 k"], pose: RelativePose, old: RelativePose) -> Float[ndarray, "5 k"]:
    """The same directions in the unknowns of another pose: whole unknowns where they are no more than :data:`BESIDE` anything else."""
    moved = untold.copy()
    moved[3:] = tangents(old.t).T @ tangents(pose.t) @ untold[3:]
    basis, _ = np.linalg.qr(moved)
    share = np.sum(basis**2, axis=1)
    most = np.sort(np.argsort(share)[-basis.shape[1] :])
    return np.eye(5)[:, most] if share[most].min() > 1 - BESIDE else basis


def untold_finding(
    covariance: Float[ndarray, "q q"], untold: Float[ndarray, "5 k"], pose: RelativePose, *, is_kept: bool
) -> Finding:
    """Names what is not told; ``is_kept``: it stays as an old rig has it, whose pose this is."""
    sigma = np.degrees(np.sqrt(np.diagonal(covariance)[:5]))
    turn_deg, direction_deg = float(sigma[:3].max()), float(sigma[3:].max())
    share = np.sum(untold**2, axis=1)
    least_told = _words(pose)[int(np.argmax(share))]
    if not is_kept:
        what = least_told if least_told in ANGLES else DIRECTION
        return finding("scene-tells-too-little", what=what, turn_sigma_deg=turn_deg, direction_sigma_deg=direction_deg)
    named = [word for word, of_word in zip(_words(pose), share, strict=True) if of_word > NAMED_SHARE]
    if (share[3:] > NAMED_SHARE).all():
        named = [*(word for word in named if word in ANGLES), DIRECTION]
    if np.isin(untold, (0.0, 1.0)).all():
        what, kept = " or ".join(named), "kept at the old rig's value"
    else:
        what = f"{', '.join(named[:-1])} and {named[-1]} apart"
        sums = ", ".join(_sum_of(direction, _words(pose)) for direction in untold.T)
        kept = f"of its change from the old rig (deg), this was kept at 0, and no part of it alone: {sums}"
    return finding(
        "scene-tells-too-little-kept",
        what=what,
        kept=kept,
        least_told=least_told,
        turn_sigma_deg=turn_deg,
        direction_sigma_deg=direction_deg,
    )


def _words(pose: RelativePose) -> tuple[str, ...]:
    """What each unknown of a pose is called: angles, and which part of the translation the others move."""
    moves = np.cross(tangents(pose.t).T, pose.t)
    parts = (f"the {PARTS[axis]} part of T" for axis in np.argmax(np.abs(moves), axis=1))
    return (*ANGLES, *parts)


def _sum_of(direction: Float[ndarray, "5"], words: tuple[str, ...]) -> str:
    """A combination of unknowns that is kept, in degrees of each."""
    factors = direction / np.degrees(UNIT)
    return " ".join(f"{factor:+.3f} {word}" for factor, word in zip(factors, words, strict=True) if round(factor, 3))


def with_untold_kept(
    problem: EpipolarProblem, untold: Float[ndarray, "5 k"], old: RelativePose, noise_px: float
) -> RelativePose:
    """The best pose that agrees with the old one, exactly, in what the scene does not tell: ``old.step_to`` it has none of that."""
    told = np.linalg.svd(untold, full_matrices=True)[0][:, untold.shape[1] :]
    if set(np.unique(untold)) <= {0.0, 1.0}:  # whole unknowns: no rounding of their neighbours
        told = np.eye(5)[:, untold.sum(axis=1) == 0]
    return _refined_along(problem, old, UNIT[:, None] * told, noise_px)


def limited_to_kept(covariance: Float[ndarray, "q q"]) -> Float[ndarray, "q q"]:
    """What was kept is taken to be known to one unit: the old rig's own uncertainty is not asked for."""
    values, vectors = np.linalg.eigh(covariance[:5, :5] / np.outer(UNIT, UNIT))
    scaled = UNIT[:, None] * vectors
    limited = np.array(covariance)
    limited[:5, :5] = scaled @ np.diag(np.minimum(values, 1.0)) @ scaled.T
    return limited


def _refined_along(
    problem: EpipolarProblem, old: RelativePose, told: Float[ndarray, "5 k"], noise_px: float
) -> RelativePose:
    """The best estimate one step away from the old pose in some directions only, the kernel closing as ever."""
    current = old
    if told.shape[1] == 0:
        return current
    length = np.zeros(told.shape[1])
    for scale_px in (*SCHEDULE_PX, *([noise_px] * KEPT_STEPS)):
        kernel = "tukey" if scale_px == noise_px else "geman"
        for _ in range(2):
            equations = problem.linearize(current, np.asarray(scale_px), kernel)
            here = told.copy()
            here[3:] = tangents(current.t).T @ tangents(old.t) @ told[3:]
            J = equations.jacobian @ here
            H = J.T @ (equations.weights[:, None] * J)
            g = -J.T @ (equations.weights * equations.residuals_px)
            length += np.linalg.solve(H + 1e-9 * (np.trace(H) + 1e-9) * np.eye(len(H)), g)
            current = old.stepped(told @ length)
    return current
