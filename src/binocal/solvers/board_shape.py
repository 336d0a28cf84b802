"""How far the data speak against a board as drawn: a cheap look, the variances of its points' offsets, and what is said of its shape.

See :mod:`binocal.solvers.shape_model` for the offsets. The variances maximise the restricted likelihood of the linearised problem.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.shapes import Float
from binocal.solvers.joint_system import ReducedSystem, solve_symmetric
from binocal.solvers.shape_model import LEAST_SHARE, N_BOWS, WEAK_SHARE, ShapeModel, Variances, weighted

START_SHARES = (0.003, 0.003, 0.003, 0.003, 0.001)
"""Standard deviations to start from, of the pitch: independent in the plane and across, smooth in and across; affine, a number."""
MAX_ITERATIONS = 30
_SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])  # places of a 3 x 3 matrix among xx, xy, xz, yy, yz, zz
TOLERANCE = 0.1  # of -2 log likelihood: a variance moves by less than a third of its standard deviation
DOUBT_BOW, DOUBT_AFFINE, DOUBT_SMOOTH = 18.0, 16.0, 48.0
"""Of chi-squared with 3, 2 and 16 degrees of freedom: a flat board passes one in some thousand, and is then looked at closely."""
DOUBT_POINTS_SIGMA = 4.0
EVIDENCE_LIMIT = 15.0  # -2 log likelihood ratio: 700 flat boards stay below 13, a bow of 0.5 mm gives 84 and more


@dataclass(frozen=True, slots=True, eq=False)
class ShapeEvidence:
    """The most likely variances, and by how much -2 log likelihood falls against a board as drawn."""

    variances: Variances
    likelihood_ratio: float

    @property
    def is_flat(self) -> bool:
        """Whether nothing speaks against the drawing."""
        return self.likelihood_ratio < EVIDENCE_LIMIT


@dataclass(frozen=True, slots=True)
class ShapeDoubt:
    """Scores of a board as drawn, for a bow, a stretch or shear, smooth shapes and single points.

    The first three are squared lengths of scores in their standard deviations (chi-squared with 3, 2 and up to 16 degrees of
    freedom), the last is the excess of the points' mean square in standard deviations of that mean.
    """

    bow: float
    affine: float
    smooth: float
    points_sigma: float
    n_boards: int = 1

    @property
    def is_any(self) -> bool:
        """Whether the likelihood ratio is worth its computation."""
        bow, affine, smooth = (
            _limit_of(self.n_boards, *limit) for limit in ((DOUBT_BOW, 3), (DOUBT_AFFINE, 2), (DOUBT_SMOOTH, 16))
        )
        return self.bow > bow or self.affine > affine or self.smooth > smooth or self.points_sigma > DOUBT_POINTS_SIGMA


def _limit_of(n_boards: int, limit: float, freedom: int) -> float:
    """What chi-squared of so many boards passes as rarely as that of one, with ``freedom`` degrees, passes its limit.

    Source: Wilson & Hilferty 1931.
    """
    if n_boards == 1:
        return limit
    sigma = ((limit / freedom) ** (1 / 3) - 1 + 2 / (9 * freedom)) / np.sqrt(2 / (9 * freedom))
    of_all = n_boards * freedom
    return float(of_all * (1 - 2 / (9 * of_all) + sigma * np.sqrt(2 / (9 * of_all))) ** 3)


def doubt_flatness(
    model: ShapeModel,
    reduced: ReducedSystem,
    own: Float[ndarray, "6 n"],
    score: Float[ndarray, "m"],
    noise_px: float,
    *,
    share: float,
    taken: float,
) -> ShapeDoubt:
    """A cheap look at a board's shape: score tests at the minimum with the board as drawn.

    ``reduced`` are the equations of some of the views, which hold ``share`` of all corners, with the model's modes for points;
    ``own`` is the information that they have of each point (xx, xy, xz, yy, yz, zz), of which the views' poses take the part ``taken``
    away. ``score`` is the reduced gradient of the points over all views.
    """
    k = reduced.n_shared
    A = reduced.information
    modes, n_bow, n_affine = model.modes, N_BOWS * len(model.boards), model.n_affine
    information = A[k:, k:] + _sandwich(modes, own)
    information -= A[k:, :k] @ solve_symmetric(A[:k, :k], A[:k, k:])
    information *= noise_px**2 / share
    found = modes.T @ score

    def length2(part: slice) -> float:
        return float(found[part] @ solve_symmetric(information[part, part], found[part]))

    free = np.concatenate(model.boards)
    each = score.reshape(3, -1)[:, free]
    points = (1 - taken) * noise_px**2 / share * own[:, free][_SYMMETRIC].transpose(2, 0, 1)
    points = points + 1e-9 * np.trace(points, axis1=1, axis2=2).mean() * np.eye(3)
    mean2 = np.einsum("in,nij,jn->", each, np.linalg.inv(points), each) / each.size
    return ShapeDoubt(
        length2(slice(0, n_bow)),
        length2(slice(n_bow, n_bow + n_affine)),
        length2(slice(0, None)),
        float((mean2 - 1) / np.sqrt(2 / each.size)),
        len(model.boards),
    )


def _sandwich(modes: Float[ndarray, "m r"], own: Float[ndarray, "6 n"]) -> Float[ndarray, "r r"]:
    """modesᵀ B modes for the points' 3 x 3 blocks B."""
    axes = modes.reshape(3, -1, modes.shape[1])
    weighted = sum(own[_SYMMETRIC[:, axis], :, None] * axes[axis] for axis in range(3))
    return modes.T @ np.asarray(weighted).reshape(modes.shape)


def estimate_variances(
    model: ShapeModel,
    reduced: ReducedSystem,
    offset: Float[ndarray, "m"],
    noise_px: float,
    start: Variances | None = None,
) -> ShapeEvidence:
    """Variances of the offsets by restricted maximum likelihood, from the equations linearised at ``offset``.

    ``reduced`` counts a prior on the points, whose information and gradient are taken out again. Corner noise is ``noise_px``.
    """
    k = reduced.n_shared
    A, b = reduced.information, reduced.gradient
    prior, prior_gradient = reduced.prior[k:, k:], reduced.prior_gradient[k:]
    free = solve_symmetric(A[:k, :k], np.concatenate([A[:k, k:], b[:k, None]], axis=1))
    M = A[k:, k:] - A[k:, :k] @ free[:, :-1] - prior
    score = b[k:] - A[k:, :k] @ free[:, -1] - prior_gradient + M @ offset
    E = model.basis
    Mc = E.T @ M @ E + np.eye(E.shape[1]) * (noise_px / (WEAK_SHARE * model.pitch)) ** 2
    V = noise_px**2 * np.linalg.inv(0.5 * (Mc + Mc.T))
    found = V @ (E.T @ score) / noise_px**2
    if model.sample is not None:
        V, found = model.sample @ V @ model.sample.T, model.sample @ found
    flat = _minus_two_log_likelihood(V, found)
    least = LEAST_SHARE**2 * model.scales
    first = np.square(START_SHARES) * model.scales if start is None else np.maximum(start, 4 * least)
    value, best = _maximize(model, V, found, first)
    return ShapeEvidence(np.where(best > 4 * least, best, 0.0), flat - value)


def _minus_two_log_likelihood(N: Float[ndarray, "r r"], d: Float[ndarray, "r"]) -> float:
    L = np.linalg.cholesky(N)
    w = np.linalg.solve(L, d)
    return float(2 * np.log(np.diagonal(L)).sum() + w @ w)


def _maximize(
    model: ShapeModel, V: Float[ndarray, "r r"], d: Float[ndarray, "r"], start: Variances
) -> tuple[float, Variances]:
    """Average-information Newton steps on the logarithms of the variances. Source: Gilmour, Thompson & Cullis 1995."""
    least = LEAST_SHARE**2 * model.scales
    a, value = start, np.inf
    damping = 1e-3
    trial = a
    gradient = average = np.zeros(0)
    for _ in range(MAX_ITERATIONS):
        N = V + weighted(trial, model.sampled)
        inverse = np.linalg.inv(N)
        q = inverse @ d
        new = float(np.linalg.slogdet(N)[1] + d @ q)
        if not np.isfinite(new) and not np.isfinite(value):
            return np.inf, start  # nothing follows from such equations: the board stays as drawn
        if new < value:
            is_done = value - new < TOLERANCE
            a, value = trial, new
            pulled = np.stack([kernel @ q for kernel in model.sampled])
            traces = np.array([np.vdot(inverse, kernel) for kernel in model.sampled])
            gradient = (traces - pulled @ q) * a
            average = pulled @ inverse @ pulled.T * np.outer(a, a)
            damping /= 5
            if is_done:
                break
        else:
            damping = max(10 * damping, 0.1)
            if damping > 1e4:
                break
        size = np.maximum(np.diagonal(average), 1e-3)
        step = -np.linalg.solve(average + np.diag(damping * size + 1e-9), gradient)
        trial = np.maximum(a * np.exp(np.clip(step, -3.0, 3.0)), least)
    return value, a


@dataclass(frozen=True, slots=True)
class ShapeFigures:
    """What is said of a board's shape; lengths in the points' unit. See :class:`binocal.result.BoardShape`."""

    bow: float
    bow_sigma: float
    stretch: float
    stretch_sigma: float
    in_plane_rms: float


def describe_shape(
    nominal: Float[ndarray, "3 n"], points: Float[ndarray, "3 n"], covariance: Float[ndarray, "m m"]
) -> ShapeFigures:
    """Bow, stretch and their standard deviations; ``covariance`` is that of the offsets, x of all points first."""
    n = nominal.shape[1]
    offset = points - nominal
    high, low = int(np.argmax(offset[2])), int(np.argmin(offset[2]))
    heights = covariance[2 * n :, 2 * n :]
    bow_variance = heights[high, high] + heights[low, low] - 2 * heights[high, low]
    x, y = nominal[:2] - nominal[:2].mean(axis=1, keepdims=True)
    functional = np.zeros(3 * n)
    functional[:n] = x / max(float(x @ x), 1e-300)
    functional[n : 2 * n] = -y / max(float(y @ y), 1e-300)
    return ShapeFigures(
        float(offset[2, high] - offset[2, low]),
        float(np.sqrt(max(bow_variance, 0.0))),
        float(functional @ offset.reshape(-1)),
        float(np.sqrt(max(functional @ covariance @ functional, 0.0))),
        float(np.sqrt(np.mean(np.sum(offset[:2] ** 2, axis=0)))),
    )
