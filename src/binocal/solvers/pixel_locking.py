"""Corners that lock to the pixel grid: a periodic error of the measured coordinate, found in residuals and taken out.

In images that were resized without filtering, upscaled, or demosaiced coarsely, an edge's measured place depends on where it lies
between the pixels: the error of x is a curve of x with the period of the grid (1 px), or of the grid before the images were
enlarged (2, 3, 4 px). It is alike in all views, so residuals show it, and a few harmonics describe it. Sub-pixel estimates of
particle images are known for the same ("peak locking": Westerweel 1997, "Fundamentals of digital particle image velocimetry").
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy import ndarray

from binocal.evidence import Detections
from binocal.evidence.pixel_locking import PixelLocking, RigLocking
from binocal.findings import Finding, finding
from binocal.geometry import SE3
from binocal.shapes import Bool, Float
from binocal.solvers import robust
from binocal.solvers.board_views import BundleMinimum, BundleProblem, CameraObservations

_TWELFTHS = (3, 4, 6, 8, 9, 12, 15, 18, 21, 24)
_FUNDAMENTAL = (3, 4, 6, 12)
_PRODUCTS = (
    (2, 1, 1), (3, 2, 1), (4, 2, 2), (6, 3, 3), (8, 4, 4), (9, 6, 3), (12, 6, 6), (15, 12, 3), (18, 9, 9), (21, 12, 9), (24, 12, 12),
)  # fmt: skip
FREQUENCIES_PER_PX = tuple(m / 12 for m in _TWELFTHS)
"""Of the grids 1, 2, 3 and 4 px wide, with their harmonics up to half a pixel."""

LEAST_SHARE = 0.05  # of an axis's residual variance; clean sets reach 0.015, sets that lock 0.08 to 0.38
LEAST_SHARE_OF_ONE = 0.01  # of one frequency's: less is not worth two numbers
LEAST_F = 14.0  # of 2 and many degrees of freedom: chance exceeds it once in a million
LEAST_CORNERS = 100  # of one camera
LOOKED_AT_FIRST = 400  # corners; more are fitted where these leave it open, which costs as much as a solve
LEAST_SHARE_AT_FIRST = 0.03  # of the four fundamental frequencies together, in those; by chance 0 +- 0.012
FITTED = 5000  # corners: they give a harmonic to a fiftieth of the noise


def find_pixel_locking(
    residuals_px: Float[ndarray, "views n 2"],
    points_px: Float[ndarray, "views n 2"],
    is_seen: Bool[ndarray, "views n"],
    weights: Float[ndarray, "views n"] | None = None,
) -> PixelLocking | None:
    """The periodic error in one camera's residuals (measured minus predicted); None where there is none to speak of.

    ``weights`` are those of the robust solve, 1 for all if None; what is not seen or not finite does not count. Each board
    point's mean residual is taken out first: that of its place on the board. On each axis frequencies are taken in, the
    strongest first, while an F test and :data:`LEAST_SHARE_OF_ONE` of the variance bear them out; an axis counts where
    together they explain :data:`LEAST_SHARE`.
    """
    is_known = is_seen & np.isfinite(residuals_px).all(axis=-1) & np.isfinite(points_px).all(axis=-1)
    weight = np.where(is_known, 1.0 if weights is None else weights, 0.0)
    n_used = int((weight > 0).sum())
    first, every = _stride(n_used, LOOKED_AT_FIRST), _stride(n_used, FITTED)
    if n_used < LEAST_CORNERS or not _seem_to_lock(residuals_px[::first], points_px[::first], weight[::first]):
        return None
    fits = [_choose(e) for e in _normal_equations(residuals_px[::every], points_px[::every], weight[::every])]
    cosines, sines = (np.array([fit.harmonics_px[:, part] for fit in fits]) for part in (0, 1))
    shares = np.array([fit.share for fit in fits])
    return PixelLocking(np.array(FREQUENCIES_PER_PX), cosines, sines, shares) if shares.any() else None


def locking_findings(locking: RigLocking) -> tuple[Finding, ...]:
    """What there is to say of it, of each camera."""
    found = []
    for camera, curve in (("left", locking.left), ("right", locking.right)):
        if curve is not None:
            axis = int(curve.variance_share.argmax())
            found.append(
                finding(
                    "corners-lock-to-pixels",
                    camera=camera,
                    amplitude_px=float(curve.amplitude_px.max()),
                    period_px=float(curve.period_px[axis]),
                    share_percent=100 * float(curve.variance_share[axis]),
                )
            )
    return tuple(found)


def locking_at(problem: BundleProblem, minimum: BundleMinimum, detections: Detections) -> RigLocking:
    """The pixel locking of a solved rig's corners, in the detections' own pixels.

    ``detections`` are the views of ``problem`` in its order, as measured, though the problem may hold them corrected already.
    Corners count by their robust weights.
    """
    found = []
    poses = problem.camera_poses(minimum.estimate)
    for camera, parameters, T, r2, measured in zip(
        problem.cameras,
        minimum.estimate.parameters,
        poses,
        minimum.equations.r2_px2,
        (detections.left_px, detections.right_px),
        strict=True,
    ):

        def given(
            views: slice,
            camera: CameraObservations = camera,
            parameters: ndarray = parameters,
            T: SE3 = T,
            r2: ndarray = r2,
            measured: ndarray = measured,
        ) -> tuple[ndarray, ...]:
            X, Y, Z = np.moveaxis(T.R[views] @ problem.object_points + T.t[views, :, None], -2, 0)
            predicted = np.stack(camera.model.project(parameters, X, Y, Z), axis=-1)
            weights = robust.weights(r2[views], minimum.scale_px, minimum.kernel)
            return measured[views] - predicted, measured[views], camera.is_seen[views], weights

        every = _stride(int(camera.is_seen.sum()), LOOKED_AT_FIRST)
        some = given(slice(None, None, every))  # all residuals take longer than to look at some of them
        is_open = every == 1 or _seem_to_lock(some[0], some[1], np.where(some[2], some[3], 0.0))
        found.append(find_pixel_locking(*(some if every == 1 else given(slice(None)))) if is_open else None)
    return RigLocking(*found)


def _stride(n_corners: int, n_wanted: int) -> int:
    """One view of how many leaves that many corners."""
    return max(1, n_corners // n_wanted)


class _Equations(NamedTuple):
    """Normal equations of all frequencies' cosines and sines on one axis, in pairs, board points' means taken out."""

    information: Float[ndarray, "c c"]
    gradient: Float[ndarray, "c"]
    total_px2: float
    freedom: int


class _Harmonics(NamedTuple):
    """Cosine and sine of every frequency, and the share of the variance that they explain; all 0 where nothing does."""

    harmonics_px: Float[ndarray, "k 2"]
    share: float


def _normal_equations(
    residuals: Float[ndarray, "views n 2"],
    points: Float[ndarray, "views n 2"],
    weight: Float[ndarray, "views n"],
    twelfths: tuple[int, ...] = _TWELFTHS,
) -> list[_Equations]:
    """Of x and of y, for these frequencies in twelfths of a cycle per pixel."""
    is_used = (weight > 0)[..., None]
    z = np.exp(2j * np.pi / 12 * np.where(is_used, points, 0.0))
    powers = {1: z}
    for m, a, b in _PRODUCTS:
        if m <= max(twelfths):
            powers[m] = powers[a] * powers[b]
    phases = np.stack([powers[m] for m in twelfths], axis=-1).view(float)  # cosine, sine, cosine, ...
    columns = np.concatenate([phases, np.where(is_used, residuals, 0.0)[..., None]], axis=-1)
    w = weight[..., None, None]
    columns -= (w * columns).sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-300)[:, None, None]
    columns *= np.sqrt(w)
    flat = columns.reshape(-1, 2, columns.shape[-1]).swapaxes(0, 1)
    freedom = int(is_used.sum()) - int(is_used.any(axis=0).sum())
    return [_Equations(g[:-1, :-1], g[:-1, -1], float(g[-1, -1]), freedom) for g in flat.swapaxes(-1, -2) @ flat]


def _seem_to_lock(
    residuals: Float[ndarray, "views n 2"], points: Float[ndarray, "views n 2"], weight: Float[ndarray, "views n"]
) -> bool:
    """Whether the fundamental frequencies explain so much of some corners' residuals that more corners are worth a look."""
    for equations in _normal_equations(residuals, points, weight, _FUNDAMENTAL):
        rest = equations.freedom - len(equations.gradient)
        if rest < len(equations.gradient):
            return True
        information = equations.information + 1e-9 * np.trace(equations.information) * np.eye(len(equations.gradient))
        explained = equations.gradient @ np.linalg.solve(information, equations.gradient)
        left = 1 - explained / max(equations.total_px2, 1e-300)
        if 1 - left * equations.freedom / rest > LEAST_SHARE_AT_FIRST:
            return True
    return False


def _choose(equations: _Equations) -> _Harmonics:
    """The significant frequencies, the strongest first."""
    total, freedom, n = equations.total_px2, equations.freedom, len(FREQUENCIES_PER_PX)
    chosen: list[int] = []
    solution, explained = np.zeros(0), 0.0
    while len(chosen) < n:
        trials = {f: _solve(equations, [*chosen, f]) for f in range(n) if f not in chosen}
        best = max(trials, key=lambda f: trials[f][1])
        rest = freedom - 2 * (len(chosen) + 1)
        gain, left = trials[best][1] - explained, total - trials[best][1]
        if rest < 1 or not gain > max(LEAST_SHARE_OF_ONE * total, 2 * LEAST_F * left / rest):
            break
        chosen.append(best)
        solution, explained = trials[best]
    harmonics = np.zeros((n, 2))
    if not chosen:
        return _Harmonics(harmonics, 0.0)
    share = 1 - (1 - explained / total) * freedom / (freedom - 2 * len(chosen))
    if share < LEAST_SHARE:
        return _Harmonics(harmonics, 0.0)
    harmonics[chosen] = solution.reshape(-1, 2)
    return _Harmonics(harmonics, share)


def _solve(equations: _Equations, frequencies: list[int]) -> tuple[Float[ndarray, "c"], float]:
    """The coefficients of some frequencies, and what they take from the sum of squares."""
    index = np.array([2 * f + part for f in frequencies for part in (0, 1)])
    b = equations.gradient[index]
    x = np.linalg.lstsq(equations.information[np.ix_(index, index)], b, rcond=1e-10)[0]
    return x, float(b @ x)
