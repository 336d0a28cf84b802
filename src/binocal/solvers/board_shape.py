"""How a board differs from its drawing: the prior of its points' offsets, with variances that the data give (empirical Bayes).

A board point's offset d from its nominal place is Gaussian: independent print errors, a smooth part (Matérn 5/2, half the board
long), each in the plane and across it with a variance of its own, and stretch and shear of the print. The five variances maximise
the restricted likelihood of the linearised problem (Patterson & Thompson 1971), so a flat board stays flat and pays nothing, and
a bent one is freed as far as its images determine it. The seven directions that no image of the board alone can tell, a rigid
motion and the scale, are held: lengths on the board are right on average over all its points.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy import ndarray

from binocal.shapes import Float
from binocal.solvers.joint_system import ReducedSystem, solve_symmetric

WEAK_SHARE = 0.3  # of the pitch: standard deviation of a point that hardly any view determines
STIFF_SHARE = 1e-5  # of the pitch: standard deviation of what no image tells
START_SHARES = (0.003, 0.003, 0.003, 0.003, 0.001)
"""Standard deviations to start from, of the pitch: independent in the plane and across, smooth in and across; affine, a number."""
LEAST_SHARE = 1e-6  # of the pitch: a standard deviation below is none
CORRELATION_LENGTH = 0.5  # of the board's longer side
MAX_ITERATIONS = 30
_SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])  # places of a 3 x 3 matrix among xx, xy, xz, yy, yz, zz
TOLERANCE = 0.1  # of -2 log likelihood: a variance moves by less than a third of its standard deviation
MAX_COORDINATES = 150  # that a variance is estimated from: more know it no better than the rig needs
DOUBT_BOW, DOUBT_AFFINE, DOUBT_SMOOTH = 18.0, 16.0, 48.0
"""Of chi-squared with 3, 2 and 16 degrees of freedom: a flat board passes one in some thousand, and is then looked at closely."""
DOUBT_POINTS_SIGMA = 4.0
EVIDENCE_LIMIT = 15.0  # -2 log likelihood ratio: 700 flat boards stay below 13, a bow of 0.5 mm gives 84 and more

Variances = Float[ndarray, "5"]


@dataclass(frozen=True, slots=True, eq=False)
class ShapeModel:
    """The kinds of offsets of one board: covariances for unit variances, in a basis without the directions that no image tells.

    ``basis`` has orthonormal columns; ``kernels`` are (r, r) for independent in plane, independent across, smooth in plane, smooth
    across, affine; ``hidden`` spans the seven directions. ``sample`` picks from the basis the coordinates of some points, evenly
    spread, from which the variances of a large board are estimated; None: all of them. ``sampled`` are the kernels there.
    """

    pitch: float
    points: Float[ndarray, "3 n"]
    hidden: Float[ndarray, "m 7"]
    modes: Float[ndarray, "m s"]
    """Smooth offsets of unit length, without what no image tells: bows, then stretch and shear, then higher orders."""
    n_affine: int

    @property
    def basis(self) -> Float[ndarray, "m r"]:
        """See above."""
        return self._kinds.basis

    @property
    def kernels(self) -> tuple[Float[ndarray, "r r"], ...]:
        """See above."""
        return self._kinds.kernels

    @property
    def sample(self) -> Float[ndarray, "c r"] | None:
        """See above."""
        return self._kinds.sample

    @property
    def sampled(self) -> tuple[Float[ndarray, "c c"], ...]:
        """See above."""
        return self._kinds.sampled

    @property
    def _kinds(self) -> _Kinds:
        return _kinds(self.points.tobytes(), self.points.shape[1])

    @staticmethod
    def of_points(points: Float[ndarray, "3 n"]) -> ShapeModel:
        """The model of a board with these nominal points."""
        return _model(np.ascontiguousarray(points).tobytes(), points.shape[1])

    @property
    def scales(self) -> Variances:
        """Variances of size one: the square of the pitch, and 1 for the affine part."""
        return np.array([self.pitch**2] * 4 + [1.0])

    def covariance(self, variances: Variances) -> Float[ndarray, "r r"]:
        """Covariance of the offsets in the basis."""
        return _weighted(variances, self.kernels)

    def information(self, variances: Variances) -> Float[ndarray, "m m"]:
        """Inverse covariance of all offsets, the hidden directions held."""
        least = (LEAST_SHARE * self.pitch) ** 2
        inverse = np.linalg.inv(self.covariance(variances) + least * np.eye(self.basis.shape[1]))
        stiff = self.hidden @ self.hidden.T / (STIFF_SHARE * self.pitch) ** 2
        return self.basis @ (0.5 * (inverse + inverse.T)) @ self.basis.T + stiff

    def weak_information(self) -> Float[ndarray, "m m"]:
        """That of points which are free as far as they are seen at all."""
        m = len(self.hidden)
        return (
            np.eye(m) / (WEAK_SHARE * self.pitch) ** 2 + self.hidden @ self.hidden.T / (STIFF_SHARE * self.pitch) ** 2
        )

    def warp_information(self, points: Float[ndarray, "3 n"]) -> Float[ndarray, "m m"]:
        """That of a board that can only bow (as a quadratic), stretch and shear."""
        x, y, _ = points - points.mean(axis=1, keepdims=True)
        zero = np.zeros_like(x)
        bows = [np.concatenate([zero, zero, part]) for part in (x * x, x * y, y * y)]
        columns = np.concatenate([np.stack(bows, axis=1), _affine(points)], axis=1)
        columns = columns - self.hidden @ (self.hidden.T @ columns)
        u, size, _ = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), full_matrices=False)
        u = u[:, size > 1e-6 * size[0]]
        m, stiff = len(u), 1 / (STIFF_SHARE * self.pitch) ** 2
        return stiff * (np.eye(m) - u @ u.T) + (u @ u.T) / (WEAK_SHARE * self.pitch) ** 2

    def scale_variance(self, points: Float[ndarray, "3 n"], variances: Variances) -> float:
        """Relative variance of the board's scale, which no image tells: of the similarity that fits offsets best."""
        x = (points - points.mean(axis=1, keepdims=True)).reshape(-1)
        g = x / (x @ x)
        n = points.shape[1]
        smooth = _smooth(points, self.pitch)
        affine = _affine(points)
        total = 0.0
        for axis in range(3):
            part = g[axis * n : (axis + 1) * n]
            own, alike = (variances[0], variances[2]) if axis < 2 else (variances[1], variances[3])
            total += own * part @ part + alike * part @ smooth @ part
        return float(total + variances[4] * np.sum((affine.T @ g) ** 2))


def _weighted(variances: Variances, kernels: tuple[Float[ndarray, "r r"], ...]) -> Float[ndarray, "r r"]:
    out = variances[0] * kernels[0]
    for variance, kernel in zip(variances[1:], kernels[1:], strict=True):
        if variance > 0:
            out += variance * kernel
    return out


@dataclass(frozen=True, slots=True, eq=False)
class _Kinds:
    """What a closer look needs, and only that: a large board takes a second."""

    basis: Float[ndarray, "m r"]
    kernels: tuple[Float[ndarray, "r r"], ...]
    sample: Float[ndarray, "c r"] | None
    sampled: tuple[Float[ndarray, "c c"], ...]


@lru_cache(maxsize=8)
def _model(data: bytes, n: int) -> ShapeModel:
    points = np.frombuffer(data).reshape(3, n)
    hidden = hidden_directions(points)
    return ShapeModel(pitch_of(points), points, hidden, *_smooth_modes(points, hidden))


@lru_cache(maxsize=4)
def _kinds(data: bytes, n: int) -> _Kinds:
    points = np.frombuffer(data).reshape(3, n)
    basis = _complement(hidden_directions(points))
    smooth, affine = _smooth(points, pitch_of(points)), _affine(points)
    zero, one = np.zeros((n, n)), np.eye(n)
    blocks = (
        _blocks(one, one, zero),
        _blocks(zero, zero, one),
        _blocks(smooth, smooth, zero),
        _blocks(zero, zero, smooth),
        affine @ affine.T,
    )
    kernels = tuple(basis.T @ block @ basis for block in blocks)
    if 3 * n <= MAX_COORDINATES:
        return _Kinds(basis, kernels, None, kernels)
    some = np.unique(np.linspace(0, n - 1, MAX_COORDINATES // 3).round().astype(int))
    sample = basis[np.concatenate([some, n + some, 2 * n + some])]
    return _Kinds(basis, kernels, sample, tuple(sample @ kernel @ sample.T for kernel in kernels))


def _smooth_modes(points: Float[ndarray, "3 n"], hidden: Float[ndarray, "m 7"]) -> tuple[Float[ndarray, "m s"], int]:
    """Polynomials of the place on the board: quadratic to quartic across it, linear and quadratic in it."""
    x, y, _ = points - points.mean(axis=1, keepdims=True)
    half = max(float(np.abs(np.stack([x, y])).max()), 1e-300)
    x, y = x / half, y / half
    zero = np.zeros_like(x)
    across = [x * x, x * y, y * y]
    higher = [x**3, x * x * y, x * y * y, y**3, x**4 + y**4]
    columns = [np.concatenate([zero, zero, part]) for part in across]
    columns += list(_affine(points).T)
    columns += [np.concatenate([zero, zero, part]) for part in higher]
    columns += [np.concatenate(parts) for part in across for parts in ((part, zero, zero), (zero, part, zero))]
    kept: list[ndarray] = []
    n_affine = 0
    for index, column in enumerate(columns):
        size = np.linalg.norm(column)
        rest = column - hidden @ (hidden.T @ column)
        for other in kept:
            rest = rest - other * (other @ rest)
        if np.linalg.norm(rest) > 1e-6 * size:
            kept.append(rest / np.linalg.norm(rest))
            n_affine += len(across) <= index < len(across) + 3
    return np.stack(kept, axis=1), n_affine


def pitch_of(points: Float[ndarray, "3 n"]) -> float:
    """Median distance from a point to its nearest neighbour."""
    distance = np.linalg.norm(points[:, :, None] - points[:, None, :], axis=0)
    np.fill_diagonal(distance, np.inf)
    return float(np.median(distance.min(axis=1)))


def hidden_directions(points: Float[ndarray, "3 n"]) -> Float[ndarray, "m 7"]:
    """Orthonormal offsets of a rigid motion and of the scale about the centre."""
    centred = points - points.mean(axis=1, keepdims=True)
    x, y, z = centred
    zero, one = np.zeros_like(x), np.ones_like(x)
    columns = [
        np.concatenate(parts)
        for parts in (
            (one, zero, zero),
            (zero, one, zero),
            (zero, zero, one),
            (zero, -z, y),
            (z, zero, -x),
            (-y, x, zero),
            (x, y, z),
        )
    ]
    return np.linalg.qr(np.stack(columns, axis=1))[0]


def stated_information(points: Float[ndarray, "3 n"], sigma_m: Float[ndarray, "n"]) -> Float[ndarray, "m m"]:
    """Inverse covariance of offsets that are independent with these standard deviations, all rigid motions held.

    The scale is not: it is as uncertain as the points leave it.
    """
    least = STIFF_SHARE * pitch_of(points)
    rigid = hidden_directions(points)[:, :6]
    return np.diag(np.tile(1 / np.square(np.maximum(sigma_m, least)), 3)) + rigid @ rigid.T / least**2


def _complement(directions: Float[ndarray, "m k"]) -> Float[ndarray, "m r"]:
    full = np.linalg.qr(np.concatenate([directions, np.eye(len(directions))], axis=1))[0]
    return np.ascontiguousarray(full[:, directions.shape[1] :])


def _smooth(points: Float[ndarray, "3 n"], pitch: float) -> Float[ndarray, "n n"]:
    """Matérn 5/2 correlation of the points. Source: Rasmussen & Williams 2006, eq. 4.17."""
    length = CORRELATION_LENGTH * max(float(np.ptp(points, axis=1).max()), pitch)
    r = np.sqrt(5) * np.linalg.norm(points[:, :, None] - points[:, None, :], axis=0) / length
    return (1 + r + r * r / 3) * np.exp(-r)


def _affine(points: Float[ndarray, "3 n"]) -> Float[ndarray, "m 3"]:
    """Offsets of a print stretched along x, along y, and sheared, each by one."""
    x, y, _ = points - points.mean(axis=1, keepdims=True)
    zero = np.zeros_like(x)
    return np.stack(
        [np.concatenate(parts) for parts in ((x, zero, zero), (zero, y, zero), (0.5 * y, 0.5 * x, zero))], axis=1
    )


def _blocks(x: Float[ndarray, "n n"], y: Float[ndarray, "n n"], z: Float[ndarray, "n n"]) -> Float[ndarray, "m m"]:
    n = len(x)
    out = np.zeros((3 * n, 3 * n))
    for i, block in enumerate((x, y, z)):
        out[i * n : (i + 1) * n, i * n : (i + 1) * n] = block
    return out


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

    @property
    def is_any(self) -> bool:
        """Whether the likelihood ratio is worth its computation."""
        return (
            self.bow > DOUBT_BOW
            or self.affine > DOUBT_AFFINE
            or self.smooth > DOUBT_SMOOTH
            or self.points_sigma > DOUBT_POINTS_SIGMA
        )


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
    modes, n_bow, n_affine = model.modes, 3, model.n_affine
    information = A[k:, k:] + _sandwich(modes, own)
    information -= A[k:, :k] @ solve_symmetric(A[:k, :k], A[:k, k:])
    information *= noise_px**2 / share
    found = modes.T @ score

    def length2(part: slice) -> float:
        return float(found[part] @ solve_symmetric(information[part, part], found[part]))

    each = score.reshape(3, -1)
    points = (1 - taken) * noise_px**2 / share * own[_SYMMETRIC].transpose(2, 0, 1)
    points = points + 1e-9 * np.trace(points, axis1=1, axis2=2).mean() * np.eye(3)
    mean2 = np.einsum("in,nij,jn->", each, np.linalg.inv(points), each) / each.size
    return ShapeDoubt(
        length2(slice(0, n_bow)),
        length2(slice(n_bow, n_bow + n_affine)),
        length2(slice(0, None)),
        float((mean2 - 1) / np.sqrt(2 / each.size)),
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
        N = V + _weighted(trial, model.sampled)
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
