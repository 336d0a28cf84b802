"""The joint equations of two cameras, views eliminated, with board points and exposures free; and dense definite equations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.kernels import _kernel
from binocal.kernels.arrays import as_floats
from binocal.kernels.linearization import PointEquations
from binocal.shapes import Float
from binocal.threads import n_threads

VIEWS_PER_THREAD = 100  # with points: a quarter of a millisecond of work and more
MIN_RIGHT_SIDES = 32  # fewer are solved faster than a thread starts


@dataclass(frozen=True, slots=True, eq=False)
class PoseSteps:
    """How a step of the rig, of the board and, if given, of a view's deviation steps the right camera's own pose, view by view.

    ``precision`` and ``pull`` are information and gradient of the deviations' prior.
    """

    rig: Float[ndarray, "V 6 6"]
    board: Float[ndarray, "V 6 6"]
    deviation: Float[ndarray, "V 6 6"] | None = None
    precision: Float[ndarray, "6"] | None = None
    pull: Float[ndarray, "V 6"] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class StereoSums:
    """What :func:`reduce_stereo` gives, without priors; see :class:`binocal.solvers.joint_system.ReducedSystem`."""

    inverse_L: Float[ndarray, "V P P"]
    Y: Float[ndarray, "z V P"]
    y: Float[ndarray, "V P"]
    own_gradient: Float[ndarray, "V P"]
    own_diagonal: Float[ndarray, "V P"]
    is_determined: ndarray
    information: Float[ndarray, "z z"]
    gradient: Float[ndarray, "z"]
    view_information: Float[ndarray, "told k k"]
    view_scores: Float[ndarray, "told z"]


def reduce_stereo(
    grams: tuple[Float[ndarray, "V p p"], Float[ndarray, "V q q"]],
    steps: PoseSteps,
    points: tuple[PointEquations, PointEquations] | None = None,
    growth: float = 1.0,
    *,
    of_views: bool = True,
) -> StereoSums:
    """Eliminate every view's board pose, and its deviation if there is one, from the equations of both cameras.

    ``grams`` and ``points`` come from :func:`accumulate_with_points`; ``points`` may be combinations of their coordinates, without
    information of their own. Diagonals are multiplied by ``growth``. The views' own sums are empty unless ``of_views``.
    """
    left, right = grams
    V, k = len(left), left.shape[-1] + right.shape[-1] - 8
    m = 0 if points is None else int(np.prod(points[0].coupling.shape[2:]))
    z, P = k + m, 6 if steps.deviation is None else 12
    rows, stride = -(-(z + 1) // 4) * 4, -(-P * V // 8) * 8
    inverse_L, padded = np.empty((V, P, P)), np.empty((rows, stride))
    own, determined = np.empty((V, 2, P)), np.empty(V)
    information, gradient = np.empty((z, z)), np.empty(z)
    n_told = V if of_views else 0
    view_information, view_scores = np.empty((n_told, k, k)), np.empty((n_told, z))
    given = _kernel.StereoViews(
        left=as_floats(left),
        right=as_floats(right),
        T_rig=as_floats(steps.rig),
        T_pose=as_floats(steps.board),
        T_deviation=as_floats(steps.deviation),
        left_coupling=as_floats(None if points is None else points[0].coupling),
        right_coupling=as_floats(None if points is None else points[1].coupling),
        left_points=as_floats(None if points is None else points[0].information),
        right_points=as_floats(None if points is None else points[1].information),
        precision=as_floats(steps.precision),
        pull=as_floats(steps.pull),
        growth=growth,
    )
    out = _kernel.ReducedViews(
        inverse_L=inverse_L,
        Y=padded,
        own=own,
        determined=determined,
        information=information,
        gradient=gradient,
        h=view_information,
        scores=view_scores,
    )
    threads = min(n_threads(), 1 + V // VIEWS_PER_THREAD) if m else 1
    _kernel.reduce_stereo(given, out, threads)
    Y = padded[:, : P * V].reshape(rows, V, P)
    return StereoSums(
        inverse_L,
        Y[:z],
        Y[z],
        own[:, 0],
        own[:, 1],
        determined > 0,
        information,
        gradient,
        view_information,
        view_scores,
    )


def solve_definite(A: Float[ndarray, "z z"], b: Float[ndarray, "r z"]) -> Float[ndarray, "r z"] | None:
    """A⁻¹ of every row of ``b`` for a symmetric positive definite, equilibrated A; None where it is none (or not finite)."""
    x = np.array(b, dtype=float, order="C")
    threads = n_threads() if len(x) >= MIN_RIGHT_SIDES else 1
    return x if _kernel.solve_definite(np.array(A, dtype=float, order="C"), x, threads) else None
