"""The joint step stated plainly in NumPy: dense normal equations of all unknowns, nothing eliminated."""

from __future__ import annotations

import numpy as np
import plain_accumulate
from numpy import ndarray

from binocal.geometry import so3
from binocal.solvers import robust
from binocal.solvers.board_views import BundleEstimate, BundleProblem


def normal_equations(
    problem: BundleProblem, estimate: BundleEstimate, scale_px: float, kernel: robust.Kernel
) -> tuple[ndarray, ndarray]:
    """H and g of one rig: shared unknowns first, then six for each view."""
    n_shared, n_views = problem.n_shared, len(estimate.T_left_board.t)
    n_all = n_shared + 6 * n_views
    H, g = np.zeros((n_all, n_all)), np.zeros(n_all)
    column = 0
    for index, (camera, T) in enumerate(zip(problem.cameras, problem.camera_poses(estimate), strict=True)):
        parameters = estimate.parameters[index]
        J, _ = plain_accumulate.unweighted_columns(
            camera.model, parameters, T.R, T.t, problem.object_points, camera.pixels, camera.is_seen
        )
        weight = robust.weights(np.sum(J[:, -1] ** 2, axis=1), np.asarray(scale_px), kernel)
        p, n_free = camera.model.n_parameters, int(camera.is_free.sum())
        for view in range(n_views):
            A = np.zeros((2, J.shape[-1], n_all))
            A[..., column : column + n_free] = np.moveaxis(J[view, :p][camera.is_free], 0, -1)
            pose = np.moveaxis(J[view, p : p + 6], 0, -1)
            if index == 1 and problem.is_rig_free:
                A[..., n_shared - 6 : n_shared] = pose
            if index == 1:
                R_rl, t_rl = estimate.T_right_left.R, estimate.T_right_left.t
                pose = pose @ np.block([[R_rl, np.zeros((3, 3))], [so3.hat(t_rl) @ R_rl, R_rl]])
            A[..., n_shared + 6 * view : n_shared + 6 * view + 6] = pose
            H += np.einsum("cna,n,cnb->ab", A, weight[view], A)
            g += np.einsum("cna,n,cn->a", A, weight[view], J[view, -1])
        own = np.arange(column, column + n_free)
        precision = scale_px**2 * camera.prior_precision[camera.is_free]
        H[own, own] += precision
        g[own] -= precision * parameters[camera.is_free]
        column += n_free
    return H, g


def solve(H: ndarray, g: ndarray, damping: float) -> tuple[ndarray, float]:
    """The damped step and the fall of the cost that it predicts."""
    damped = H + damping * np.diag(np.diag(H))
    scale = 1 / np.sqrt(np.diag(damped))
    step = scale * np.linalg.solve(damped * scale * scale[:, None], g * scale)
    return step, 0.5 * float(step @ g + damping * step**2 @ np.diag(H))
