"""Gauss-Newton without squaring the Jacobian, for corners without noise.

Normal equations square the condition number. With eight distortion coefficients it reaches 10¹⁶ there, and exact
corners end at 10⁻⁷ px. An orthogonal factorisation of the Jacobian ends at the rounding of the projections themselves.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from binocal.kernels import unweighted_columns
from binocal.solvers import robust
from binocal.solvers.board_views import (
    BundleEstimate,
    BundleMinimum,
    BundleProblem,
    BundleStep,
    adjoint,
)

MAX_STEPS = 60  # the rational model's valley is bent: up to 40 were seen, other models take 1 or 2
ROUNDING_PX = 1e-12  # a projection of some 1000 px is rounded to 1e-13
LEAST_DAMPING, MAX_DAMPING = 1e-14, 1e-2  # of a column's squared length
MAX_CORNERS = 200_000  # the whole Jacobian is held at once: 100 MB


def polish_exact(problem: BundleProblem, minimum: BundleMinimum) -> BundleMinimum:
    """The minimum of one stereo rig, stepped on to the rounding of the projections.

    Unchanged unless its scale is at the floor.

    Corners that the robust kernel gives no weight stay out; exact corners need neither prior nor whitening.
    """
    n_corners = sum(c.is_seen.size for c in problem.cameras)
    if minimum.scale_px > 1.5 * robust.SCALE_FLOOR_PX or n_corners > MAX_CORNERS:
        return minimum
    inlier = [
        c.is_seen & (robust.weights(e.r2_px2, minimum.scale_px, minimum.kernel) == 1)
        for c, e in zip(problem.cameras, minimum.equations.cameras, strict=True)
    ]
    clean = replace(
        problem,
        terms=(),
        cameras=tuple(
            replace(c, is_seen=seen, model=replace(c.model, prior_sigma=math.inf), whitening=None)
            for c, seen in zip(problem.cameras, inlier, strict=True)
        ),
    )
    one = np.asarray(1.0)
    estimate, cost = minimum.estimate, float(clean.linearize(minimum.estimate, one, "squared").cost_px2)
    damping = 0.0
    for _ in range(MAX_STEPS):
        if cost < n_corners * ROUNDING_PX**2 or damping > MAX_DAMPING:
            break
        candidate = clean.retract(estimate, _orthogonal_step(clean, estimate, damping))
        trial = float(clean.linearize(candidate, one, "squared").cost_px2)
        if trial < cost:
            estimate, cost = candidate, trial
            damping = damping / 10 if damping > LEAST_DAMPING else 0.0
        else:
            damping = max(10 * damping, LEAST_DAMPING)
    if estimate is minimum.estimate:
        return minimum
    return replace(
        minimum,
        estimate=estimate,
        equations=problem.linearize(estimate, minimum.scale_px, minimum.kernel),
    )


def _orthogonal_step(problem: BundleProblem, estimate: BundleEstimate, damping: float) -> BundleStep:
    """The Levenberg-Marquardt step by QR: first each view's pose columns, then the shared ones in their complement."""
    n_shared = problem.n_shared
    shared, pose, residual = [], [], []
    column = 0
    poses = problem.camera_poses(estimate)
    for index, (camera, T) in enumerate(zip(problem.cameras, poses, strict=True)):
        J = unweighted_columns(
            camera.model.name,
            estimate.parameters[index],
            T.R,
            T.t,
            problem.object_points,
            camera.pixels,
            camera.is_seen,
        )
        p = camera.model.n_parameters
        free = np.nonzero(camera.is_free)[0]
        block = np.zeros((len(J), n_shared, J.shape[-1]))
        block[:, column : column + len(free)] = J[:, free]
        column += len(free)
        J_pose = J[:, p : p + 6]
        if index == 1:
            if problem.is_rig_free:
                block[:, -6:] = J_pose
            J_pose = adjoint(estimate.T_right_left.R, estimate.T_right_left.t).T @ J_pose
        shared.append(block)
        pose.append(J_pose)
        residual.append(J[:, -1:])
    A = np.concatenate(shared, axis=-1).swapaxes(-1, -2)
    directions = problem.free_directions(estimate)
    if directions is not None:
        A = A @ directions
    B = np.concatenate(pose, axis=-1).swapaxes(-1, -2)
    r = np.concatenate(residual, axis=-1).swapaxes(-1, -2)
    Q, R_pose = np.linalg.qr(B)
    rest = np.concatenate([A, r], axis=-1)
    for _ in range(2):  # twice is enough: the second pass removes what rounding left in the first
        rest = rest - Q @ (Q.swapaxes(-1, -2) @ rest)
    n_unknown = A.shape[-1]
    flat = rest.reshape(-1, n_unknown + 1)
    size = np.linalg.norm(flat, axis=0)
    size[size == 0] = 1.0
    damped = np.concatenate([flat[:, :-1] / size[:-1], np.sqrt(damping) * np.eye(n_unknown)])
    step, *_ = np.linalg.lstsq(damped, np.concatenate([flat[:, -1], np.zeros(n_unknown)]), rcond=None)
    step = step / size[:-1]
    views = np.linalg.solve(R_pose, Q.swapaxes(-1, -2) @ (r - A @ step[:, None]))[..., 0]
    if directions is not None:
        step = directions @ step
    unknown = np.asarray(np.nan)
    return BundleStep(step, views, unknown, np.full(n_shared, np.nan), unknown)
