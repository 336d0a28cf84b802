"""The joint normal equations view by view, in the unknowns of the solver: what every statement about views starts from.

The compiled kernel gives each camera's equations in that camera's own frame; here they are put into one set of unknowns: the
shared ones (intrinsics, rig, board points), and each view's own (board pose, and the right camera's deviation where there is
one). Eliminating the views gives the shared equations; leaving a view out of them again gives its influence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.shapes import Bool, Float

LEAST_PIVOT = 1e-12  # of an equilibrated view's matrix: below, its corners do not determine its unknowns


@dataclass(frozen=True, slots=True, eq=False)
class JointSystem:
    """Normal equations of V views with P unknowns each, s shared unknowns and m coordinates of board points (0 where held).

    All are for unit weights: information and gradients in px². ``prior`` and ``prior_gradient`` are those of all shared unknowns,
    points last.
    """

    own: Float[ndarray, "V P P"]
    own_gradient: Float[ndarray, "V P"]
    own_shared: Float[ndarray, "V P s"]
    own_points: Float[ndarray, "V P m"]
    shared: Float[ndarray, "V s s"]
    shared_gradient: Float[ndarray, "V s"]
    shared_points: Float[ndarray, "V s m"]
    points: Float[ndarray, "V 6 n"]
    """3 x 3 information of every board point: xx, xy, xz, yy, yz, zz."""
    points_gradient: Float[ndarray, "V m"]
    prior: Float[ndarray, "z z"]
    prior_gradient: Float[ndarray, "z"]

    @property
    def n_views(self) -> int:
        """How many views."""
        return len(self.own)

    @property
    def n_shared(self) -> int:
        """Cameras and rig: s."""
        return self.shared.shape[-1]

    @property
    def n_all(self) -> int:
        """With the coordinates of board points: s + m."""
        return self.shared.shape[-1] + self.own_points.shape[-1]


@dataclass(frozen=True, slots=True, eq=False)
class ReducedSystem:
    """A :class:`JointSystem` with the views eliminated.

    ``Y`` and ``y`` are the views' couplings and gradients times the inverse of their Cholesky factors ``L`` (equilibrated by
    ``scale``): the information that a view loses to its own unknowns is YᵀY. ``is_determined`` says which views count.
    """

    system: JointSystem
    inverse_L: Float[ndarray, "V P P"]
    Y: Float[ndarray, "V P z"]
    y: Float[ndarray, "V P"]
    information: Float[ndarray, "z z"]
    """Of all shared unknowns, priors included."""
    gradient: Float[ndarray, "z"]
    is_determined: Bool[ndarray, "V"]

    @property
    def data_information(self) -> Float[ndarray, "z z"]:
        """The same without the priors."""
        return self.information - self.system.prior

    def view_scores(self) -> Float[ndarray, "V z"]:
        """Every view's own gradient of the shared unknowns, its own unknowns eliminated."""
        s = self.system
        own = np.concatenate([s.shared_gradient, s.points_gradient], axis=1)
        return np.where(self.is_determined[:, None], own - np.einsum("vpz,vp->vz", self.Y, self.y), 0.0)

    def view_information_times(self, x: Float[ndarray, "V z"]) -> Float[ndarray, "V z"]:
        """h_v x_v for every view: its information with its own unknowns eliminated, times a vector of its own."""
        s = self.system
        k = s.n_shared
        c, d = x[:, :k], x[:, k:]
        out_c = np.einsum("vij,vj->vi", s.shared, c)
        out = [out_c]
        if d.shape[1]:
            out_c += np.einsum("vim,vm->vi", s.shared_points, d)
            out.append(np.einsum("vim,vi->vm", s.shared_points, c) + _times_points(s.points, d))
        total = np.concatenate(out, axis=1)
        total -= np.einsum("vpz,vp->vz", self.Y, np.einsum("vpz,vz->vp", self.Y, x))
        return np.where(self.is_determined[:, None], total, 0.0)

    def view_information(self, view: int) -> Float[ndarray, "z z"]:
        """h_v as a matrix."""
        s = self.system
        k = s.n_shared
        out = np.zeros((s.n_all, s.n_all))
        if not self.is_determined[view]:
            return out
        out[:k, :k] = s.shared[view]
        out[:k, k:] = s.shared_points[view]
        out[k:, :k] = s.shared_points[view].T
        add_points(out[k:, k:], s.points[view])
        return out - self.Y[view].T @ self.Y[view]


def reduce(system: JointSystem, growth: float = 1.0) -> ReducedSystem:
    """Eliminate the views; every diagonal is multiplied by ``growth`` first."""
    own = system.own.copy()
    V, P, k = len(own), own.shape[-1], system.n_shared
    diagonal = own[:, range(P), range(P)]
    own[:, range(P), range(P)] = diagonal * growth
    scale = 1 / np.sqrt(np.maximum(diagonal * growth, 1e-300))
    own *= scale[:, :, None] * scale[:, None, :]
    L, is_determined = _cholesky(own)
    inverse_L = np.linalg.inv(L) * scale[:, None, :]
    inverse_L[~is_determined] = 0.0
    Y = inverse_L @ np.concatenate([system.own_shared, system.own_points], axis=2)
    y = np.einsum("vpq,vq->vp", inverse_L, system.own_gradient)
    H = np.zeros((system.n_all, system.n_all))
    counts = is_determined.astype(float)
    H[:k, :k] = np.tensordot(counts, system.shared, 1)
    gradient = (
        np.concatenate([counts @ system.shared_gradient, counts @ system.points_gradient]) + system.prior_gradient
    )
    if system.n_all > k:
        H[:k, k:] = np.tensordot(counts, system.shared_points, 1)
        H[k:, :k] = H[:k, k:].T
        add_points(H[k:, k:], np.tensordot(counts, system.points, 1))
    H += system.prior
    H[np.diag_indices_from(H)] *= growth
    flat = Y.reshape(V * P, -1)
    return ReducedSystem(system, inverse_L, Y, y, H - flat.T @ flat, gradient - y.reshape(-1) @ flat, is_determined)


def _cholesky(matrices: Float[ndarray, "V P P"]) -> tuple[Float[ndarray, "V P P"], Bool[ndarray, "V"]]:
    """Factors, and which matrices have one; the others' is 1."""
    try:
        return np.linalg.cholesky(matrices), np.ones(len(matrices), dtype=bool)
    except np.linalg.LinAlgError:
        finite = np.asarray(np.isfinite(matrices).all(axis=(1, 2)))
        is_sound = np.array(finite)
        is_sound[finite] = np.linalg.eigvalsh(matrices[finite])[:, 0] > LEAST_PIVOT
        safe = np.where(is_sound[:, None, None], matrices, np.eye(matrices.shape[-1]))
        return np.linalg.cholesky(safe), is_sound


_PLACES = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def add_points(matrix: Float[ndarray, "m m"], points: Float[ndarray, "6 n"]) -> None:
    """Add the points' 3 x 3 blocks to a matrix of their coordinates (x of all points, then y, then z), in place."""
    n = points.shape[-1]
    index = np.arange(n)
    for values, (a, b) in zip(points, _PLACES, strict=True):
        matrix[a * n + index, b * n + index] += values
        if a != b:
            matrix[b * n + index, a * n + index] += values


def _times_points(points: Float[ndarray, "V 6 n"], x: Float[ndarray, "V m"]) -> Float[ndarray, "V m"]:
    n = points.shape[-1]
    parts = [x[:, i * n : (i + 1) * n] for i in range(3)]
    out = [np.zeros_like(part) for part in parts]
    for i, (a, b) in enumerate(_PLACES):
        out[a] += points[:, i] * parts[b]
        if a != b:
            out[b] += points[:, i] * parts[a]
    return np.concatenate(out, axis=1)
