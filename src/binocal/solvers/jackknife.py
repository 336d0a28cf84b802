"""Covariance of the rig from what views have in common: the linearised delete-one-view jackknife.

Errors of real corners are alike within a view: a bent board, a lens that its model does not follow, a board that moves between the
exposures. Normal equations take every corner for independent and come out two to four times too small. Leaving each view out in
turn shows what the views really agree on (CR3; MacKinnon & White 1985; Bell & McCaffrey 2002), and from the solver's own equations
that needs no solve: without view v the estimate moves by -(T - h_v)⁻¹ g_v, with h_v and g_v the view's information and score once
its own unknowns are eliminated, and T the information of all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.shapes import Float
from binocal.solvers.joint_system import (
    JointSystem,
    ReducedSystem,
    information_of_view,
    information_times,
    solve_symmetric,
)

DIRECT_VIEWS = 15  # below, a view weighs so much that the series is slow
MAX_TERMS = 25
SERIES_TOLERANCE = 1e-3  # of the longest shift
NULL_SIGMAS, SURE_SIGMAS = 3.0, 5.0
"""Between so many standard deviations of what independent noise leaves, the jackknife gains its say; below it has none."""
POOLED_VIEWS = 2.0  # that the ratio common to all directions is worth beside a direction's own
FEW_VIEWS = 10  # below, a jackknife's sigma is that of Student's t
TRACED_VIEWS = 40  # of more, an even selection


@dataclass(frozen=True, slots=True, eq=False)
class ViewAgreement:
    """What the views' scores and the leaving out of each say of independent corner noise.

    ``excess`` is the scores' variance over that of independent noise, all parameters together, and ``excess_sigma`` what that ratio
    scatters by where corners are independent. ``widening`` is W in ``covariance = L W Lᵀ``, with L the factor of the covariance of
    independent noise: the identity where nothing speaks against it.
    """

    excess: float
    excess_sigma: float
    widening: Float[ndarray, "k k"]

    @property
    def factor(self) -> float:
        """Typical factor of a standard deviation."""
        return float(np.sqrt(np.trace(self.widening) / max(len(self.widening), 1))) if len(self.widening) else 1.0


def agreement_of_views(
    reduced: ReducedSystem, noise_px: float, L: Float[ndarray, "k k"], system: Callable[[], JointSystem]
) -> ViewAgreement:
    """Compare what the views leave with independent corner noise; ``L`` is a factor of the covariance that such noise has.

    ``system`` gives the equations before the reduction, where they are needed.

    A jackknife of V views knows a single variance to sqrt(2 / (V - 1)) only. So the excess of the scores is judged for all
    parameters together first; where it is no more than chance, the covariance of independent noise stands. Where it is more, the
    jackknife's covariance is shrunk towards a multiple of that one, and never falls below it.
    """
    k = len(L)
    n_views = int(reduced.is_determined.sum())
    if k == 0 or n_views < 3:
        return ViewAgreement(1.0, np.inf, np.eye(k))
    excess, excess_sigma = excess_of_scores(reduced, noise_px)
    weight = say_of_views(excess, excess_sigma)
    if weight == 0:
        return ViewAgreement(excess, excess_sigma, np.eye(k))
    shifts = shifts_without(reduced, system())[reduced.is_determined]
    if not np.isfinite(shifts).all():
        return ViewAgreement(excess, excess_sigma, np.eye(k))
    shifts = np.linalg.solve(L, (shifts - shifts.mean(axis=0)).T)
    W = (n_views - 1) / n_views * (shifts @ shifts.T) + _of_prior(reduced, noise_px, L)
    return ViewAgreement(excess, excess_sigma, widening(W, n_views, weight))


def say_of_views(excess: float, excess_sigma: float) -> float:
    """How far the views are believed, from 0 to 1, by the ratio of their scores' variance to that of independent noise."""
    return float(np.clip(((excess - 1) / excess_sigma - NULL_SIGMAS) / (SURE_SIGMAS - NULL_SIGMAS), 0, 1))


def widening(W: Float[ndarray, "k k"], n_views: int, weight: float) -> Float[ndarray, "k k"]:
    """A jackknife's covariance ``W`` in units of that of independent noise, shrunk to a multiple of it, never below it."""
    k = len(W)
    common = float(np.trace(W)) / k
    W = (POOLED_VIEWS * common * np.eye(k) + (n_views - 1) * W) / (POOLED_VIEWS + n_views - 1)
    if n_views < FEW_VIEWS:
        W = W * student_factor(n_views - 1) ** 2
    values, vectors = np.linalg.eigh(W)
    wide = 1 + weight * (np.maximum(values, 1) - 1)
    return (vectors * wide) @ vectors.T


def excess_of_scores(reduced: ReducedSystem, noise_px: float) -> tuple[float, float]:
    """Variance of the views' scores over that of independent noise, and the standard deviation of that ratio under such noise.

    With G_v a view's share of the information in the metric of all, its score has covariance C_v = G_v - G_v² there; the squares of
    all views add up to the sum of the traces of C_v, with variance 2 tr C_v² each. Of many views some stand for all in the
    traces of higher powers, which are small then.
    """
    k = reduced.n_shared
    own = reduced.view_information
    total = own.sum(axis=0) + reduced.prior[:k, :k]
    scale = 1 / np.sqrt(np.maximum(np.diagonal(total), 1e-300))
    values, vectors = np.linalg.eigh(total * scale[:, None] * scale)
    root = (vectors / np.sqrt(np.maximum(values, 1e-15 * values[-1]))).T * scale  # root total rootᵀ = 1
    inverse = root.T @ root
    some = own if len(own) <= TRACED_VIEWS else own[np.linspace(0, len(own) - 1, TRACED_VIEWS).round().astype(int)]
    B = (some.reshape(-1, k) @ inverse).reshape(some.shape)  # as G in another metric: traces of powers are the same
    B2 = B @ B
    squares = float(np.sum((reduced.view_scores[:, :k] @ root.T) ** 2))
    second, third, fourth = (
        float(np.einsum("vij,vji->", a, b)) * len(own) / len(some) for a, b in ((B, B), (B2, B), (B2, B2))
    )
    expected = float(np.vdot(own.sum(axis=0), inverse)) - second
    scatter = float(np.sqrt(2 * max(second - 2 * third + fourth, 0.0)))
    return squares / expected / noise_px**2, scatter / expected


def shifts_without(reduced: ReducedSystem, system: JointSystem) -> Float[ndarray, "V k"]:
    """By how much the cameras' and the rig's parameters move when a view is left out, in the solver's units, view by view."""
    k = reduced.n_shared
    if reduced.n_views < DIRECT_VIEWS:
        return -_directly(reduced, system)[:, :k]
    return -_by_series(reduced, system)[:, :k]


def _directly(reduced: ReducedSystem, system: JointSystem) -> Float[ndarray, "V z"]:
    return np.stack(
        [
            solve_symmetric(reduced.information - information_of_view(system, reduced, v), score)
            for v, score in enumerate(reduced.view_scores)
        ]
    )


def _by_series(reduced: ReducedSystem, system: JointSystem) -> Float[ndarray, "V z"]:
    """(T - h)⁻¹ g = the sum of (T⁻¹ h)^i T⁻¹ g."""
    k = reduced.n_shared
    inverse = solve_symmetric(reduced.information, np.eye(reduced.n_all))
    term = reduced.view_scores @ inverse.T
    total = term.copy()
    sigma = np.sqrt(np.maximum(np.diagonal(inverse)[:k], 1e-300))
    for _ in range(MAX_TERMS):
        term = information_times(system, reduced, term) @ inverse.T
        total += term
        if np.abs(term[:, :k] / sigma).max() < SERIES_TOLERANCE * np.abs(total[:, :k] / sigma).max():
            break
    return total


def _of_prior(reduced: ReducedSystem, noise_px: float, L: Float[ndarray, "k k"]) -> Float[ndarray, "k k"]:
    """The part of the variance that is the priors' own, which no view tells, in units of the covariance."""
    k = reduced.n_shared
    if not reduced.prior.any():
        return np.zeros((k, k))
    columns = solve_symmetric(reduced.information, np.eye(reduced.n_all)[:, :k])
    columns = np.linalg.solve(L, columns.T).T
    return columns.T @ reduced.prior @ columns * noise_px**2


def student_factor(freedom: int) -> float:
    """Student's t over the normal quantile at one standard deviation (a share of 68.27 % inside).

    Source: Cornish-Fisher expansion, Abramowitz & Stegun 1964, 26.7.5, at x = 1; within 0.4 % from two degrees of freedom.
    """
    n = float(freedom)
    return 1 + 2 / (4 * n) + 24 / (96 * n**2) + 24 / (384 * n**3)
