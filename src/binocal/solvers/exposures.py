"""Whether both cameras saw each view at one moment, and by how much the right one's view deviates where they did not.

Each camera alone fits its images whatever the other saw. Where it does so clearly better than both together, the two did not see
the board in one place: they were not triggered together, or the rig moved. The deviation of each view is then an unknown with a
variance that the data give (MacKay 1992, "Bayesian interpolation", eq. 4.6, one variance for the turn and one for the shift).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.shapes import Float
from binocal.solvers import robust
from binocal.solvers.joint_system import ReducedSystem, solve_symmetric
from binocal.solvers.real_views import RealViewsEquations, RealViewsEstimate, RealViewsProblem

FREE_SHARE = 0.3  # of the board's size: a shift (and radians of turn) so wide that it is free
APART_T, LESS_APART_T, APART_RATIO = 4.0, 2.0, 1.136
"""Of the relative poses' excess over what images leave alike on their own: above, the exposures differ. Sound recordings reach 3, a
lens that its model does not follow 2.4; in those not triggered together the least is 4.6. The lower one
holds where the pair leaves that many times the noise of each camera alone."""
LINEAR_LEAST = 1e-6  # of the pair's variance: cameras alone cannot be known better from one linearisation
START_SHARE = 0.01  # as FREE_SHARE, where the search for the variances begins
LEAST_SHARE = 1e-7  # and where it ends: as good as none
MAX_ROUNDS = 8
SETTLED_LOG = 0.05  # of a standard deviation: nothing that depends on it moves by more


@dataclass(frozen=True, slots=True)
class PairFit:
    """Noise of a corner coordinate where each camera is fitted alone, and where both are, with one board; degrees of freedom counted."""

    alone_px: float
    pair_px: float
    excess: float = 1.0
    """Mean square of the views' relative poses in units of the noise alone: 1 where they are one."""
    excess_sigma: float = np.inf
    """What that scatters by where they are one."""

    @property
    def ratio(self) -> float:
        """Pair over alone: 1 where both cameras saw one board in one place."""
        return self.pair_px / self.alone_px if self.alone_px > 0 else 1.0


def board_size(problem: RealViewsProblem) -> float:
    """Half the longer side of the board."""
    return 0.5 * float(np.ptp(problem.nominal.object_points, axis=1).max())


def board_centres(problem: RealViewsProblem, estimate: RealViewsEstimate) -> Float[ndarray, "views 3"]:
    """The board's centre in the right camera's frame, as the rig has it."""
    rig, left = estimate.bundle.T_right_left, estimate.bundle.T_left_board
    in_left = left.R @ problem.nominal.object_points.mean(axis=1) + left.t
    return in_left @ rig.R.T + rig.t


def with_deviations(
    problem: RealViewsProblem, estimate: RealViewsEstimate, sigma: tuple[float, float]
) -> RealViewsProblem:
    """The problem with one deviation of the right pose in each view."""
    centres = board_centres(problem, estimate) if problem.centres is None else problem.centres
    return replace(problem, deviation_sigma=sigma, centres=centres)


def compare_with_cameras_alone(
    problem: RealViewsProblem,
    estimate: RealViewsEstimate,
    equations: RealViewsEquations,
    noise_px: float,
    together: ReducedSystem | None = None,
) -> PairFit:
    """Both noises from one linearisation of a problem without deviations; priors are weighed against ``noise_px``.

    ``together`` are the same equations reduced, where they are known already.
    """
    weighed = replace(equations, scale_px=np.asarray(noise_px))
    if together is None:
        together = problem.reduced(estimate, weighed, of_views=False)
    free = with_deviations(problem, estimate, (FREE_SHARE, FREE_SHARE * board_size(problem)))
    apart = free.reduced(estimate, weighed, of_views=False)
    total = squares(weighed)
    is_rig_free = problem.nominal.is_rig_free and problem.nominal.held_part is None
    pair = total - fall_of_squares(together)
    alone = total - fall_of_squares(apart, is_rig_held=is_rig_free)
    has_both = int(np.logical_and(*(e.gram[:, -2, -2] > 0 for e in equations.cameras)).sum())
    # the points' priors are as many measurements as the points are unknowns
    freedom = count_coordinates(problem, equations) - 6 * together.n_views - together.n_shared
    n_relative = 6 * max(has_both - 1, 1)
    if freedom <= n_relative or not pair > 0:
        return PairFit(1.0, 1.0)
    alone2, pair2 = max(alone, 0.0) / (freedom - n_relative), pair / freedom
    excess = (pair - alone) / max(alone2, LINEAR_LEAST * pair2) / n_relative
    return PairFit(float(np.sqrt(alone2)), float(np.sqrt(pair2)), float(excess), float(np.sqrt(2 / n_relative)))


def squares(equations: RealViewsEquations) -> float:
    """Weighted sum of squared residuals, and of distances from the priors in units of the equations' scale."""
    return equations.rss_px2 + 2 * float(equations.scale_px) ** 2 * float(equations.prior_energy)


def count_coordinates(problem: RealViewsProblem, equations: RealViewsEquations) -> float:
    """Corner coordinates that carry weight under Hampel's kernel, pixels that corners share counted once."""
    return sum(
        c.n_coordinates(c.is_seen & robust.carries_weight(r2, equations.scale_px, "hampel"))
        for c, r2 in zip(problem.cameras, equations.r2_px2, strict=True)
    )


def fall_of_squares(reduced: ReducedSystem, *, is_rig_held: bool = False) -> float:
    """How far the sum of squares falls in the best step; with every right pose free, the rig itself has nothing left to explain."""
    keep = np.arange(reduced.n_all)
    if is_rig_held:
        keep = np.delete(keep, np.s_[reduced.n_shared - 6 : reduced.n_shared])
    gradient = reduced.gradient[keep]
    x = solve_symmetric(reduced.information[np.ix_(keep, keep)], gradient)
    return float(x @ gradient + np.sum(reduced.y**2))


def effective_points(problem: RealViewsProblem, reduced: ReducedSystem) -> float:
    """How many of the points' coordinates the data determine, beyond their prior."""
    if problem.shape_information is None:
        return 0.0
    k = reduced.n_shared
    A = reduced.information
    inner = A[k:, k:] - A[k:, :k] @ solve_symmetric(A[:k, :k], A[:k, k:])
    return float(len(inner) - np.trace(solve_symmetric(inner, reduced.prior[k:, k:])))


def estimate_deviation_sigma(
    problem: RealViewsProblem, estimate: RealViewsEstimate, equations: RealViewsEquations, noise_px: float
) -> tuple[float, float]:
    """Standard deviations (rotation in radians, shift) of the deviations, on the linearised problem."""
    size = board_size(problem)
    sigma = problem.deviation_sigma or (START_SHARE, START_SHARE * size)
    weighed = replace(equations, scale_px=np.asarray(noise_px))
    for _ in range(MAX_ROUNDS):
        reduced = with_deviations(problem, estimate, sigma).reduced(estimate, weighed)
        own, variance = _posterior(reduced, noise_px)
        total = estimate.deviations + own[:, 6:]
        new = []
        for part, (s, unit) in enumerate(zip(sigma, (1.0, size), strict=True)):
            columns = slice(3 * part, 3 * part + 3)
            squares = float(np.sum(total[:, columns] ** 2))
            determined = max(total[:, columns].size - float(variance[:, columns].sum()) / s**2, 0.5)
            new.append(max(float(np.sqrt(squares / determined)), LEAST_SHARE * unit))
        change = max(abs(np.log(a / b)) for a, b in zip(new, sigma, strict=True))
        sigma = (new[0], new[1])
        if change < SETTLED_LOG:
            break
    return sigma


def determined_deviations(problem: RealViewsProblem, reduced: ReducedSystem, noise_px: float) -> float:
    """How many of the deviations' components the data determine, beyond their prior."""
    if problem.deviation_sigma is None:
        return 0.0
    inverse = reduced.inverse_L[:, :, 6:]
    variance = np.einsum("vqp,vqp->vp", inverse, inverse) * noise_px**2
    return float((1 - variance / np.repeat(problem.deviation_sigma, 3) ** 2)[reduced.is_determined].sum())


def _posterior(reduced: ReducedSystem, noise_px: float) -> tuple[Float[ndarray, "V P"], Float[ndarray, "V 6"]]:
    """The views' own step, and the variances of their deviations with all shared unknowns free."""
    own = reduced.own_step(solve_symmetric(reduced.information, reduced.gradient))
    inverse = reduced.inverse_L[:, :, 6:]
    variance = np.einsum("vqp,vqp->vp", inverse, inverse)
    coupling = np.einsum("zvq,vqp->vpz", reduced.Y, inverse, optimize=True)
    flat = coupling.reshape(-1, coupling.shape[-1])
    spread = solve_symmetric(reduced.information, np.eye(reduced.n_all))
    variance += np.einsum("iz,iz->i", flat @ spread, flat).reshape(variance.shape)
    return own, variance * noise_px**2
