"""The joint normal equations view by view, in the unknowns of the solver: what every statement about views starts from.

The compiled kernel gives each camera's equations in that camera's own frame; here they stand in one set of unknowns: the shared
ones (intrinsics, rig, board points), and each view's own (board pose, and the right camera's deviation where there is one).
Eliminating the views gives the shared equations; leaving a view out of them again gives its influence. :func:`reduce` is the plain
statement; :func:`binocal.kernels.reduce_stereo` does the same, compiled, without the arrays between.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.kernels import solve_definite
from binocal.shapes import Bool, Float

LEAST_PIVOT = 1e-12  # of an equilibrated view's matrix: below, its corners do not determine its unknowns
PLACES = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""Entries of a point's 3 x 3 matrix as they are stored."""


@dataclass(frozen=True, slots=True, eq=False)
class JointSystem:
    """Normal equations of V views with P unknowns each, k shared unknowns and m coordinates of board points (0 where held).

    All are for unit weights: information and gradients in px². ``prior`` and ``prior_gradient`` are those of all shared unknowns,
    points last.
    """

    own: Float[ndarray, "V P P"]
    own_gradient: Float[ndarray, "V P"]
    own_shared: Float[ndarray, "V P k"]
    own_points: Float[ndarray, "V P m"]
    shared: Float[ndarray, "V k k"]
    shared_gradient: Float[ndarray, "V k"]
    shared_points: Float[ndarray, "V k m"]
    points: Float[ndarray, "V 6 n"]
    """3 x 3 information of every board point: xx, xy, xz, yy, yz, zz."""
    points_gradient: Float[ndarray, "V m"]
    prior: Float[ndarray, "z z"]
    prior_gradient: Float[ndarray, "z"]

    @property
    def n_shared(self) -> int:
        """Cameras and rig: k."""
        return self.shared.shape[-1]

    @property
    def n_all(self) -> int:
        """With the coordinates of board points: k + m."""
        return self.shared.shape[-1] + self.own_points.shape[-1]


@dataclass(frozen=True, slots=True, eq=False)
class ReducedSystem:
    """A joint system with the views eliminated.

    ``Y`` and ``y`` are the views' couplings and gradients times ``inverse_L``, the inverse of the Cholesky factors of their own
    equations: the information that a view loses to its own unknowns is Y Yᵀ. ``is_determined`` says which views count.
    """

    n_shared: int
    inverse_L: Float[ndarray, "V P P"]
    Y: Float[ndarray, "z V P"]
    y: Float[ndarray, "V P"]
    own_gradient: Float[ndarray, "V P"]
    own_diagonal: Float[ndarray, "V P"]
    """Undamped."""
    information: Float[ndarray, "z z"]
    """Of all shared unknowns, priors included."""
    gradient: Float[ndarray, "z"]
    prior: Float[ndarray, "z z"]
    prior_gradient: Float[ndarray, "z"]
    is_determined: Bool[ndarray, "V"]
    view_information: Float[ndarray, "told k k"]
    """Every view's information about cameras and rig, its own unknowns eliminated, board points held; none where nobody asked."""
    view_scores: Float[ndarray, "told z"]
    """Every view's own gradient of all shared unknowns, its own unknowns eliminated."""

    @property
    def n_views(self) -> int:
        """How many views, determined or not."""
        return len(self.inverse_L)

    @property
    def n_all(self) -> int:
        """All shared unknowns."""
        return len(self.information)

    def own_step(self, x: Float[ndarray, "z"]) -> Float[ndarray, "V P"]:
        """The views' best step beside a shared one."""
        rest = self.y - np.tensordot(x, self.Y, 1)
        return (rest[:, None, :] @ self.inverse_L)[:, 0]

    def whole_gradient(self) -> Float[ndarray, "z"]:
        """The shared gradient before the views were eliminated, priors included."""
        return self.gradient + np.tensordot(self.Y, self.y, 2)


def reduce(system: JointSystem, growth: float = 1.0) -> ReducedSystem:
    """Eliminate the views; every diagonal is multiplied by ``growth`` first."""
    V, P = system.own_gradient.shape
    k, z = system.n_shared, system.n_all
    diagonal = system.own[:, range(P), range(P)]
    own = system.own.copy()
    own[:, range(P), range(P)] = diagonal * growth
    scale = 1 / np.sqrt(np.maximum(diagonal * growth, 1e-300))
    L, is_determined = _cholesky(own * scale[:, :, None] * scale[:, None, :])
    inverse_L = np.linalg.inv(L) * scale[:, None, :]
    inverse_L[~is_determined] = 0.0
    couplings = inverse_L @ np.concatenate([system.own_shared, system.own_points], axis=2)
    y = np.einsum("vpq,vq->vp", inverse_L, system.own_gradient)
    counts = is_determined.astype(float)
    H = np.zeros((z, z))
    H[:k, :k] = np.tensordot(counts, system.shared, 1)
    if z > k:
        H[:k, k:] = np.tensordot(counts, system.shared_points, 1)
        H[k:, :k] = H[:k, k:].T
        add_points(H[k:, k:], np.tensordot(counts, system.points, 1))
    H += system.prior
    H[np.diag_indices_from(H)] *= growth
    flat = couplings.reshape(V * P, z)
    gradients = np.concatenate([system.shared_gradient, system.points_gradient], axis=1)
    lost = np.einsum("vpi,vpj->vij", couplings[..., :k], couplings[..., :k])
    return ReducedSystem(
        k,
        inverse_L,
        np.ascontiguousarray(couplings.transpose(2, 0, 1)),
        y,
        system.own_gradient,
        diagonal,
        H - flat.T @ flat,
        counts @ gradients + system.prior_gradient - y.reshape(-1) @ flat,
        system.prior,
        system.prior_gradient,
        is_determined,
        (system.shared - lost) * counts[:, None, None],
        (gradients - np.einsum("vpz,vp->vz", couplings, y)) * counts[:, None],
    )


def information_of_view(system: JointSystem, reduced: ReducedSystem, view: int) -> Float[ndarray, "z z"]:
    """A view's information about all shared unknowns, its own eliminated."""
    k = system.n_shared
    out = np.zeros((system.n_all, system.n_all))
    if reduced.is_determined[view]:
        out[:k, :k] = system.shared[view]
        out[:k, k:] = system.shared_points[view]
        out[k:, :k] = system.shared_points[view].T
        add_points(out[k:, k:], system.points[view])
        Y = reduced.Y[:, view]
        out -= Y @ Y.T
    return out


def information_times(system: JointSystem, reduced: ReducedSystem, x: Float[ndarray, "V z"]) -> Float[ndarray, "V z"]:
    """Every view's information about all shared unknowns, its own eliminated, times a vector of its own."""
    k = system.n_shared
    c, d = x[:, :k], x[:, k:]
    out = np.empty_like(x)
    out[:, :k] = np.einsum("vij,vj->vi", system.shared, c)
    if d.shape[1]:
        out[:, :k] += np.einsum("vim,vm->vi", system.shared_points, d)
        out[:, k:] = np.einsum("vim,vi->vm", system.shared_points, c) + _times_points(system.points, d)
    out -= np.einsum("zvp,vp->vz", reduced.Y, np.einsum("zvp,vz->vp", reduced.Y, x))
    return np.where(reduced.is_determined[:, None], out, 0.0)


def solve_symmetric(A: Float[ndarray, "z z"], b: Float[ndarray, "z *k"]) -> Float[ndarray, "z *k"]:
    """A⁻¹ b of a symmetric positive definite A, by equilibration; NaN where A is none."""
    scale = 1 / np.sqrt(np.maximum(np.abs(np.diagonal(A)), 1e-300))
    wide = b if b.ndim == 2 else b[:, None]
    x = solve_definite(A * scale[:, None] * scale, wide.T * scale)
    out = np.full(wide.shape, np.nan) if x is None else x.T * scale[:, None]
    return out if b.ndim == 2 else out[:, 0]


def _cholesky(matrices: Float[ndarray, "V P P"]) -> tuple[Float[ndarray, "V P P"], Bool[ndarray, "V"]]:
    """Factors, and which matrices have one; the others' is 1."""
    finite = np.asarray(np.isfinite(matrices).all(axis=(1, 2)))
    is_sound = np.array(finite)
    is_sound[finite] = np.linalg.eigvalsh(matrices[finite])[:, 0] > LEAST_PIVOT
    safe = np.where(is_sound[:, None, None], matrices, np.eye(matrices.shape[-1]))
    return np.linalg.cholesky(safe), is_sound


def add_points(matrix: Float[ndarray, "m m"], points: Float[ndarray, "6 n"]) -> None:
    """Add the points' 3 x 3 blocks to a matrix of their coordinates (x of all points, then y, then z), in place."""
    n = points.shape[-1]
    index = np.arange(n)
    for values, (a, b) in zip(points, PLACES, strict=True):
        matrix[a * n + index, b * n + index] += values
        if a != b:
            matrix[b * n + index, a * n + index] += values


def _times_points(points: Float[ndarray, "V 6 n"], x: Float[ndarray, "V m"]) -> Float[ndarray, "V m"]:
    n = points.shape[-1]
    parts = [x[:, i * n : (i + 1) * n] for i in range(3)]
    out = [np.zeros_like(part) for part in parts]
    for i, (a, b) in enumerate(PLACES):
        out[a] += points[:, i] * parts[b]
        if a != b:
            out[b] += points[:, i] * parts[a]
    return np.concatenate(out, axis=1)
