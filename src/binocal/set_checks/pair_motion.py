"""How the pair of cameras moved between or within the views of a set, from one linearisation at the solution.

Every view's right pose is freed on paper (``e``: what a deviation of its own would remove). How much that removes, against what the
images leave alone, says whether both cameras saw one board in one place; whether a single change of the rig at one view removes it
too says what happened: a camera turned, was refocused, its image shifted, at once or slowly. All of it is small dense algebra on the
views' Gram matrices. Thresholds were found on simulated faults and real recordings: a step on paper of clean sets reaches 8 of the
60 that are asked for, T reaches 1.9.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.geometry import SE3
from binocal.kernels import unweighted_columns
from binocal.shapes import Float, Int
from binocal.solvers import robust
from binocal.solvers.board_views import adjoint
from binocal.solvers.exposures import PairFit, compare_with_cameras_alone
from binocal.solvers.joint_system import solve_symmetric
from binocal.solvers.real_views import RealViewsEquations, RealViewsEstimate, RealViewsProblem

MIN_CORNERS = 12  # of an image, to tell smooth residuals from its pose
LEAST_T = 2.0  # for a change to be named: below, the standard deviations carry it
MIN_VIEWS, MIN_VIEWS_OF_CHANGE = 4, 5  # fewer have no room for motion, or for a change, among them
EXPLAINED_SHARE = 0.8  # of the excess, for a cause to be named
SURE_GAIN, GAIN_PER_FREEDOM = 60.0, 6.0  # of -2 log likelihood over what else is alike within views
CAMERAS = ("left", "right")


@dataclass(frozen=True, slots=True)
class Change:
    """A change of the rig that explains most of what the pair leaves beyond the cameras alone.

    ``kind``: turned, refocused, shifted. ``course``: ``step`` from view ``view`` on, ``drift`` over the whole sequence, or ``states``,
    the views marked in ``members``. ``size`` is in degrees, percent of the focal length, or pixels.
    """

    kind: str
    camera: str
    course: str
    view: int
    size: float
    gain: float
    members: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class PairMotion:
    """Statistics of a set; see SET checks in the documentation's method.

    ``excess`` is the mean square, in units of the noise that the cameras leave alone, of the 6 V - 6 relative poses; ``reference``
    that of smooth residuals within the images, which no motion can make; ``T`` their ratio: 1 where both cameras saw one board in
    one place.
    """

    excess: float
    reference: float
    change: Change | None

    @property
    def T(self) -> float:
        """The excess over what the images leave alike on their own."""
        return self.excess / max(1.0, self.reference)


@dataclass(frozen=True, slots=True)
class _Direction:
    """A way in which the rig may change: columns of the extra unknowns, and how its size is said."""

    kind: str
    camera: str
    columns: tuple[int, ...]
    handicap: float = 0.0


# extra unknowns of a view: right camera focal length, centre (2), turn (3); left camera the same
_DIRECTIONS = (
    _Direction("turned", "right", (3, 4, 5)),
    _Direction("turned", "left", (9, 10, 11)),
    _Direction("refocused", "right", (0,)),
    _Direction("refocused", "left", (6,)),
    _Direction("shifted", "right", (1, 2)),
    _Direction("shifted", "left", (7, 8)),
)


@dataclass(frozen=True, slots=True, eq=False)
class _Extras:
    """Normal equations of the views' extra unknowns, board poses eliminated: own, with the shared ones, gradient; and those of all."""

    h: Float[ndarray, "V 12 12"]
    c: Float[ndarray, "V 12 k"]
    g: Float[ndarray, "V 12"]
    T: Float[ndarray, "k k"]
    gradient: Float[ndarray, "k"]
    noise2: float


def measure_freed_motion(
    problem: RealViewsProblem, estimate: RealViewsEstimate, equations: RealViewsEquations, noise_px: float
) -> PairMotion | None:
    """The same from a solve whose exposures are free: its deviations are put back into the residuals.

    Large motion is not linear, and a robust kernel hides it; around the freed solution neither matters.
    """
    *_, deviation = problem.right_steps(estimate)
    if deviation is None:
        return None
    left, right = equations.cameras
    moved = np.einsum("vij,vj->vi", deviation, estimate.deviations)
    p = right.gram.shape[-1] - 7
    put_back = np.broadcast_to(np.eye(p + 7), right.gram.shape).copy()
    put_back[:, p : p + 6, -1] = moved
    gram = put_back.swapaxes(1, 2) @ right.gram @ put_back
    held = replace(problem, deviation_sigma=None, centres=None)
    start = replace(estimate, deviations=np.zeros_like(estimate.deviations))
    points = equations.points
    if points:
        coupling = points[1].coupling.copy()
        coupling[:, -1] += np.einsum("vi,viam->vam", moved, coupling[:, p : p + 6])
        points = (points[0], replace(points[1], coupling=coupling))
    together = replace(
        equations,
        cameras=(left, replace(right, gram=gram)),
        points=points,
        prior_energy=held.prior_energy(start),
    )
    reference = smooth_residuals(problem, estimate, equations, noise_px)
    pair = compare_with_cameras_alone(held, start, together, noise_px)
    return measure_pair_motion(held, start, together, pair, reference=reference)


def measure_pair_motion(
    problem: RealViewsProblem,
    estimate: RealViewsEstimate,
    equations: RealViewsEquations,
    pair: PairFit,
    *,
    reference: float | None = None,
) -> PairMotion | None:
    """The statistics of a solved set whose exposures are held together; None where the views are too few, or a part of the rig is held.

    The board's points count as they are in the estimate. ``pair`` is their comparison; ``reference`` is measured unless given.
    """
    seen = np.stack([e.gram[:, -2, -2] > 0 for e in equations.cameras])
    both = np.flatnonzero(seen.all(axis=0))
    nominal = problem.nominal
    if len(both) < MIN_VIEWS or nominal.held_part is not None or not nominal.is_rig_free:
        return None
    if not pair.alone_px > 0 or not np.isfinite(pair.excess_sigma):
        return None
    if reference is None:
        reference = smooth_residuals(problem, estimate, equations, pair.alone_px)
    change = None
    if len(both) >= MIN_VIEWS_OF_CHANGE and pair.excess > LEAST_T * max(1.0, reference):
        extras = _extras(problem, estimate, equations, pair.alone_px**2)
        change = _find_change(extras, both, pair.excess, reference)
    return PairMotion(pair.excess, reference, change)


def smooth_residuals(
    problem: RealViewsProblem, estimate: RealViewsEstimate, equations: RealViewsEquations, noise_px: float
) -> float:
    """Mean square, in units of the noise, of six smooth fields of each image beyond its pose, in what is left at an estimate."""
    total, count = 0.0, 0
    fields = _fields(problem.nominal.object_points)
    cameras = zip(
        problem.cameras, estimate.bundle.parameters, problem.camera_poses(estimate), equations.cameras, strict=True
    )
    for camera, parameters, T, e in cameras:
        given = (parameters, T.R, T.t, estimate.points, camera.pixels, camera.is_seen)
        columns, p = unweighted_columns(camera.model.name, *given), len(parameters)
        inlier = camera.is_seen & robust.carries_weight(e.r2_px2, equations.scale_px, "hampel")
        usable = inlier.sum(axis=1) >= MIN_CORNERS
        if not usable.any():
            continue
        mask = np.concatenate([inlier, inlier], axis=1).astype(float)[usable]
        poses, modes = columns[usable, p : p + 6] * mask[:, None], fields * mask[:, None]
        basis = np.linalg.qr(np.concatenate([poses, modes], axis=1).swapaxes(1, 2))[0][:, :, 6:]
        total += float(np.sum(np.einsum("vnm,vn->vm", basis, columns[usable, -1] * mask) ** 2))
        count += basis.shape[0] * basis.shape[2]
    return total / max(count, 1) / noise_px**2


def _fields(points: Float[ndarray, "3 n"]) -> Float[ndarray, "6 _"]:
    """x², xy, y² of the place on the board, in u and in v."""
    x, y, _ = points - points.mean(axis=1, keepdims=True)
    half = max(float(np.abs(np.stack([x, y])).max()), 1e-300)
    x, y = x / half, y / half
    zero = np.zeros_like(x)
    return np.stack([np.concatenate(pair) for f in (x * x, x * y, y * y) for pair in ((f, zero), (zero, f))])


def _extras(
    problem: RealViewsProblem, estimate: RealViewsEstimate, equations: RealViewsEquations, noise2: float
) -> _Extras:
    """Each view's equations of what may change in it, with the shared unknowns (board points held)."""
    left, right = equations.cameras
    n_left, n_right = left.gram.shape[-1] - 7, right.gram.shape[-1] - 7
    V = len(left.gram)
    T: SE3 = estimate.bundle.T_right_left
    k = n_left + n_right + 6
    E_left, E_right = np.zeros((n_left + 6, k + 18)), np.zeros((n_right + 6, k + 18))
    E_left[:n_left, :n_left] = np.eye(n_left)
    E_right[:n_right, n_left : n_left + n_right] = np.eye(n_right)
    E_right[n_right:, k - 6 : k] = np.eye(6)
    E_left[n_left:, k : k + 6] = np.eye(6)
    E_right[n_right:, k : k + 6] = adjoint(T.R, T.t)
    for E, n, first, camera, parameters in (
        (E_right, n_right, k + 6, problem.cameras[1], estimate.bundle.parameters[1]),
        (E_left, n_left, k + 12, problem.cameras[0], estimate.bundle.parameters[0]),
    ):
        place = np.cumsum(camera.is_free) - 1
        if camera.is_free[:4].all():
            E[place[0], first], E[place[1], first] = parameters[0], parameters[1]
            E[place[2], first + 1] = E[place[3], first + 2] = 1.0
        E[n : n + 3, first + 3 : first + 6] = np.eye(3)
    whole = E_left.T @ left.gram[:, :-1, :-1] @ E_left + E_right.T @ right.gram[:, :-1, :-1] @ E_right
    gradient = (E_left.T @ left.gram[:, :-1, -1:] + E_right.T @ right.gram[:, :-1, -1:])[..., 0]
    order = np.r_[0:k, k + 6 : k + 18]
    pose = np.arange(k, k + 6)
    own = whole[:, pose[:, None], pose]
    size = 1 / np.sqrt(np.maximum(own[:, range(6), range(6)], 1e-300))
    own = own * size[:, :, None] * size[:, None, :] + 1e-10 * np.eye(6)
    coupling = whole[:, pose[:, None], order] * size[:, :, None]
    lost = np.linalg.solve(own, np.concatenate([coupling, (gradient[:, pose] * size)[..., None]], axis=2))
    rest = whole[:, order[:, None], order] - coupling.swapaxes(1, 2) @ lost[..., :-1]
    score = gradient[:, order] - np.einsum("vpo,vp->vo", coupling, lost[..., -1])
    prior = np.zeros((k, k))
    for term in problem.nominal.all_terms:
        prior += float(equations.scale_px) ** 2 * term.normal_equations(problem.nominal, estimate.bundle)[0]
    has_views = (own[:, 0, 0] > 0.5) & np.isfinite(rest).all(axis=(1, 2))
    rest[~has_views], score[~has_views] = 0.0, 0.0
    shared = rest[:, :k, :k].sum(axis=0) + prior
    assert len(rest) == V
    return _Extras(rest[:, k:, k:], rest[:, k:, :k], score[:, k:], shared, score[:, :k].sum(axis=0), noise2)


def _find_change(extras: _Extras, both: Int[ndarray, "b"], excess: float, reference: float) -> Change | None:
    """The change of the rig that explains the excess best, if one explains most of it."""
    n_views = len(both)
    total = excess * 6 * (n_views - 1)
    wanted = EXPLAINED_SHARE * max(total - reference * 6 * (n_views - 1), 0.0)
    best: tuple[float, Change] | None = None
    for direction in _DIRECTIONS:
        d = len(direction.columns)
        for change in (
            _step(extras, both, direction),
            _drift(extras, both, direction),
            *_states(extras, both, direction),
        ):
            left = (total - change.gain) / max(6 * (n_views - 1) - d, 1)
            level = max(1.0, reference, left)
            if change.gain / level < SURE_GAIN + GAIN_PER_FREEDOM * d or change.gain < wanted:
                continue
            handicap = 1.1 if change.course == "states" else 1.0
            if best is None or left * handicap < best[0]:
                best = (left * handicap, change)
    return None if best is None else best[1]


def _gains(
    h: Float[ndarray, "s d d"], c: Float[ndarray, "s d k"], g: Float[ndarray, "s d"], extras: _Extras
) -> tuple[Float[ndarray, "s"], Float[ndarray, "s d"]]:
    """Fall of the squares, in units of the noise, and size of a change, for sums over views."""
    spread = solve_symmetric(extras.T, np.concatenate([c.reshape(-1, c.shape[-1]), extras.gradient[None]]).T).T
    through, moved = spread[:-1].reshape(c.shape), spread[-1]
    information = h - c @ through.swapaxes(1, 2)
    score = g - c @ moved
    size = np.sqrt(np.maximum(np.einsum("sii->si", h), 1e-300))
    scaled = information / size[:, :, None] / size[:, None, :]
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.swapaxes(1, 2)))
    along = np.einsum("sij,si->sj", vectors, score / size)
    inverse = np.where(values > 1e-9, 1 / np.maximum(values, 1e-9), 0.0)
    gain = np.sum(along**2 * inverse, axis=1) / extras.noise2
    return gain, np.einsum("sij,sj->si", vectors, along * inverse) / size


def _parts(extras: _Extras, views: Int[ndarray, "b"], direction: _Direction):  # type: ignore[no-untyped-def]
    columns = np.array(direction.columns)
    return (
        extras.h[views][:, columns[:, None], columns],
        extras.c[views][:, columns],
        extras.g[views][:, columns],
    )


def _step(extras: _Extras, views: Int[ndarray, "b"], direction: _Direction) -> Change:
    """The best step in the order of the views."""
    h, c, g = (np.cumsum(part[::-1], axis=0)[::-1][1:] for part in _parts(extras, views, direction))
    gains, sizes = _gains(h, c, g, extras)
    best = int(np.argmax(gains))
    return _change(direction, "step", int(views[best + 1]), sizes[best], float(gains[best]))


def _drift(extras: _Extras, views: Int[ndarray, "b"], direction: _Direction) -> Change:
    """A change that grows evenly over the sequence; its size is that from the first to the last view."""
    place = np.linspace(-0.5, 0.5, len(views))
    h, c, g = _parts(extras, views, direction)
    gains, sizes = _gains(
        np.tensordot(place**2, h, 1)[None], np.tensordot(place, c, 1)[None], np.tensordot(place, g, 1)[None], extras
    )
    return _change(direction, "drift", int(views[0]), sizes[0], float(gains[0]))


def _states(extras: _Extras, views: Int[ndarray, "b"], direction: _Direction) -> list[Change]:
    """The best split of the views in two, whatever their order: along the principal axis of their own estimates."""
    h, c, g = _parts(extras, views, direction)
    size = np.sqrt(np.maximum(np.einsum("vii->vi", h), 1e-300))
    scaled = h / size[:, :, None] / size[:, None, :] + 1e-6 * np.eye(h.shape[-1])
    own = np.linalg.solve(scaled, (g / size)[..., None])[..., 0] / size
    own = own - np.median(own, axis=0)
    spread = own / np.maximum(np.median(np.abs(own), axis=0), 1e-300)
    axis = np.linalg.svd(np.clip(spread, -10, 10), full_matrices=False)[2][0]
    order = np.argsort(spread @ axis, kind="stable")
    h, c, g = (np.cumsum(part[order][::-1], axis=0)[::-1][2:-1] for part in (h, c, g))
    if len(h) == 0:
        return []
    gains, sizes = _gains(h, c, g, extras)
    best = int(np.argmax(gains))
    members = tuple(sorted(int(v) for v in views[order[best + 2 :]]))
    if members and (members[0] == 0 or members[-1] == int(views[-1])) and len(members) == members[-1] - members[0] + 1:
        return []  # a step in the order of the views, found as such
    return [_change(direction, "states", members[0], sizes[best], float(gains[best]), members)]


def _change(
    direction: _Direction, course: str, view: int, size: Float[ndarray, "d"], gain: float, members: tuple[int, ...] = ()
) -> Change:
    length = float(np.linalg.norm(size))
    said = {"turned": np.degrees(length), "refocused": 100 * length, "shifted": length}[direction.kind]
    return Change(direction.kind, direction.camera, course, view, float(said), gain, members)
