"""How a board differs from its drawing: the prior of its points' offsets, with variances that the data give (empirical Bayes).

A board point's offset d from its nominal place is Gaussian: independent print errors, a smooth part (Matérn 5/2, half the board
long), each in the plane and across it with a variance of its own, and stretch and shear of the print. The five variances maximise
the restricted likelihood of the linearised problem (Patterson & Thompson 1971), so a flat board stays flat and pays nothing, and
a bent one is freed as far as its images determine it. The seven directions that no image of the board alone can tell, a rigid
motion and the scale, are held: lengths on the board are right on average over all its points.

Where views are of several boards, each has offsets of its own, independent of the others' and held in its own seven directions; the
variances, in shares of its pitch, are those of all of them. Boards that too few views show are as drawn.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy import ndarray

from binocal.shapes import Float, Int

WEAK_SHARE = 0.3  # of the pitch: standard deviation of a point that hardly any view determines
STIFF_SHARE = 1e-5  # of the pitch: standard deviation of what no image tells
LEAST_SHARE = 1e-6  # of the pitch: a standard deviation below is none
CORRELATION_LENGTH = 0.5  # of the board's longer side
MAX_COORDINATES = 150  # that a variance is estimated from: more know it no better than the rig needs
N_BOWS = 3  # modes of a board

Variances = Float[ndarray, "5"]


@dataclass(frozen=True, slots=True, eq=False)
class ShapeModel:
    """The kinds of offsets of one board, or of several: covariances for unit variances, in a basis without the directions that no image tells.

    ``basis`` has orthonormal columns; ``kernels`` are (r, r) for independent in plane, independent across, smooth in plane, smooth
    across, affine; ``hidden`` spans the seven directions of every board, and those of the points that are as drawn. ``sample`` picks
    from the basis the coordinates of some points, evenly spread, from which the variances of a large board are estimated; None: all
    of them. ``sampled`` are the kernels there.
    """

    pitch: float
    points: Float[ndarray, "3 n"]
    hidden: Float[ndarray, "m h"]
    modes: Float[ndarray, "m s"]
    """Smooth offsets of unit length, without what no image tells: bows, then stretch and shear, then higher orders."""
    n_affine: int
    labels: Int[ndarray, "n"]
    """Which board each point is of, -1 where it is as drawn."""

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
        return _kinds(self.points.tobytes(), self.labels.tobytes())

    @staticmethod
    def of_points(points: Float[ndarray, "3 n"], labels: Int[ndarray, "n"] | None = None) -> ShapeModel:
        """The model of a board with these nominal points, or of several: ``labels`` says of which each is, -1 if as drawn."""
        one = np.zeros(points.shape[1], dtype=np.int64)
        known = one if labels is None else np.ascontiguousarray(labels, dtype=np.int64)
        return _model(np.ascontiguousarray(points).tobytes(), known.tobytes())

    @property
    def boards(self) -> tuple[Int[ndarray, "k"], ...]:
        """The points of each board that is not as drawn."""
        return _boards(self.labels)

    @property
    def scales(self) -> Variances:
        """Variances of size one: the square of the pitch, and 1 for the affine part."""
        return np.array([self.pitch**2] * 4 + [1.0])

    def covariance(self, variances: Variances) -> Float[ndarray, "r r"]:
        """Covariance of the offsets in the basis."""
        return weighted(variances, self.kernels)

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
        """Relative variance of the board's scale, which no image tells: of the similarity that fits offsets best.

        Of several boards the largest: they may come from one printer, so that their errors of scale do not average out.
        """
        return max(self._scale_variance(points[:, board], variances) for board in self.boards)

    def _scale_variance(self, points: Float[ndarray, "3 n"], variances: Variances) -> float:
        pitch = pitch_of(points)
        variances = variances * np.append(np.full(4, (pitch / self.pitch) ** 2), 1.0)
        x = (points - points.mean(axis=1, keepdims=True)).reshape(-1)
        g = x / (x @ x)
        n = points.shape[1]
        smooth = _smooth(points, pitch)
        affine = _affine(points)
        total = 0.0
        for axis in range(3):
            part = g[axis * n : (axis + 1) * n]
            own, alike = (variances[0], variances[2]) if axis < 2 else (variances[1], variances[3])
            total += own * part @ part + alike * part @ smooth @ part
        return float(total + variances[4] * np.sum((affine.T @ g) ** 2))


def weighted(variances: Variances, kernels: tuple[Float[ndarray, "r r"], ...]) -> Float[ndarray, "r r"]:
    """Sum of covariances for unit variances, each times its variance."""
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
def _model(data: bytes, label_data: bytes) -> ShapeModel:
    points, labels = _unpacked(data, label_data)
    n = points.shape[1]
    hidden, bows, affine, higher = [], [], [], []
    n_affine = 0
    for board in _boards(labels):
        directions = hidden_directions(points[:, board])
        modes, n_of_board = _smooth_modes(points[:, board], directions)
        hidden.append(_among(n, board, directions))
        for kind, part in ((bows, slice(0, N_BOWS)), (affine, slice(N_BOWS, N_BOWS + n_of_board))):
            kind.append(_among(n, board, modes[:, part]))
        higher.append(_among(n, board, modes[:, N_BOWS + n_of_board :]))
        n_affine += n_of_board
    as_drawn = np.flatnonzero(labels < 0)
    hidden.append(_among(n, as_drawn, np.eye(3 * len(as_drawn))))
    modes = np.concatenate([*bows, *affine, *higher], axis=1)
    return ShapeModel(pitch_of(points), points, np.concatenate(hidden, axis=1), modes, n_affine, labels)


@lru_cache(maxsize=4)
def _kinds(data: bytes, label_data: bytes) -> _Kinds:
    points, labels = _unpacked(data, label_data)
    n, pitch = points.shape[1], pitch_of(points)
    bases, parts = [], []
    for board in _boards(labels):
        own = points[:, board]
        basis, share2 = _complement(hidden_directions(own)), (pitch_of(own) / pitch) ** 2
        smooth, affine = _smooth(own, pitch_of(own)), _affine(own)
        zero, one = np.zeros((len(board), len(board))), np.eye(len(board))
        blocks = (
            share2 * _blocks(one, one, zero),
            share2 * _blocks(zero, zero, one),
            share2 * _blocks(smooth, smooth, zero),
            share2 * _blocks(zero, zero, smooth),
            affine @ affine.T,
        )
        bases.append(_among(n, board, basis))
        parts.append(tuple(basis.T @ block @ basis for block in blocks))
    basis = np.concatenate(bases, axis=1)
    kernels = tuple(_block_diagonal(kernel) for kernel in zip(*parts, strict=True))
    free = np.flatnonzero(labels >= 0)
    if 3 * len(free) <= MAX_COORDINATES:
        return _Kinds(basis, kernels, None, kernels)
    some = free[np.unique(np.linspace(0, len(free) - 1, MAX_COORDINATES // 3).round().astype(int))]
    sample = basis[np.concatenate([some, n + some, 2 * n + some])]
    return _Kinds(basis, kernels, sample, tuple(sample @ kernel @ sample.T for kernel in kernels))


def _unpacked(data: bytes, label_data: bytes) -> tuple[Float[ndarray, "3 n"], Int[ndarray, "n"]]:
    labels = np.frombuffer(label_data, dtype=np.int64)
    return np.frombuffer(data).reshape(3, len(labels)), labels


def _boards(labels: Int[ndarray, "n"]) -> tuple[Int[ndarray, "k"], ...]:
    return tuple(np.flatnonzero(labels == board) for board in range(int(labels.max(initial=-1)) + 1))


def _among(n: int, board: Int[ndarray, "k"], columns: Float[ndarray, "r c"]) -> Float[ndarray, "m c"]:
    """Columns of a board's coordinates among those of all ``n`` points."""
    out = np.zeros((3, n, columns.shape[1]))
    out[:, board] = columns.reshape(3, len(board), columns.shape[1])
    return out.reshape(3 * n, columns.shape[1])


def _block_diagonal(parts: tuple[ndarray, ...]) -> Float[ndarray, "r r"]:
    """Square matrices along the diagonal of one."""
    ends = np.cumsum([0, *(len(part) for part in parts)])
    out = np.zeros((ends[-1], ends[-1]))
    for first, end, part in zip(ends[:-1], ends[1:], parts, strict=True):
        out[first:end, first:end] = part
    return out


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
