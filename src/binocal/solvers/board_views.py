"""Bundle adjustment of one camera, or of a stereo pair, over board views: equations, steps, retraction.

Unknowns: each camera's intrinsics, the rig's ``T_right_left``, and one board pose ``T_left_board`` per view. Rigid
transforms are stepped from the left, ``T <- (exp(omega), tau) T``, xi = (omega, tau). A right corner then moves by the
same column whether the rig or the board stepped, up to the adjoint of ``T_right_left``; that is why :func:`accumulate`
needs only six pose columns per camera. The board poses are eliminated view by view (Schur complement; Triggs et al.
2000, "Bundle adjustment: a modern synthesis", section 6.1), so the cost is linear in the views.

Every array may carry leading batch dimensions: a batch of rigs with the same board and number of views is solved at
once. All functions are pure.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy import ndarray

from binocal.cameras import CameraModel, StereoRig
from binocal.geometry import SE3, so3
from binocal.kernels import (
    Steps,
    ViewEquations,
    accumulate,
    compose_poses,
    median_lengths2,
    pixels_behind,
    reduced_equations,
    reduced_information,
    robust_costs,
    solve_steps,
    squared_lengths,
    step_poses,
)
from binocal.shapes import Bool, Float
from binocal.solvers import plain_equations, robust
from binocal.solvers.arrays import SHARED, choose_rigs
from binocal.solvers.loop_state import LoopState
from binocal.solvers.minimization import Minimum
from binocal.solvers.problem import SharedTerm

MAX_CORRECTION = 1.0  # of the step itself, in rotation: beyond, the series does not converge
HARMLESS_TURN_RAD = 0.02  # a correction below this needs no such check
LOST_SHARE = 0.9  # of the cost that a view has when none of its left corners carries weight
LONGEST_TURN_RAD = 1.5  # a linear step that turns a camera further has lost all meaning


@dataclass(frozen=True, slots=True, eq=False)
class CameraObservations:
    """One camera's corners and which of its parameters are free.

    Pixels are component-first and finite everywhere: 0 where a corner was not seen. ``whitening`` is that of
    :class:`binocal.solvers.whitening.CornerWeights`, None where all corners are alike. ``lengths2`` are what squared residuals
    are on average over the square of the noise, 2 of every corner where None (less where corners share pixels).
    """

    model: CameraModel = field(metadata=SHARED)
    pixels: Float[ndarray, "*batch views 2 n"]
    is_seen: Bool[ndarray, "*batch views n"]
    is_free: Bool[ndarray, "p"] = field(metadata=SHARED)
    whitening: Float[ndarray, "*batch views 3 n"] | None = None
    lengths2: Float[ndarray, "*batch views n"] | None = None

    @staticmethod
    def from_corners(
        model: CameraModel,
        corners_px: Float[ndarray, "*batch views n 2"],
        *,
        skew: bool = False,
        intrinsics: bool = True,
        whitening: Float[ndarray, "*batch views 3 n"] | None = None,
    ) -> CameraObservations:
        """Observations of (views, n, 2) corners with NaN for unseen; ``intrinsics=False`` holds all parameters."""
        corners = np.asarray(corners_px, dtype=float)
        is_seen = np.isfinite(corners[..., 0])
        pixels = np.array(corners.swapaxes(-1, -2), order="C")
        if not is_seen.all():
            pixels[~np.broadcast_to(is_seen[..., None, :], pixels.shape)] = 0.0
        is_free = np.full(model.n_parameters, intrinsics)
        is_free[4] = intrinsics and skew
        return CameraObservations(model, pixels, is_seen, is_free, whitening)

    @property
    def prior_precision(self) -> Float[ndarray, "p"]:
        """Precision of the model's weak prior on each parameter; 0 where there is none or the parameter is held."""
        return np.where(self.is_free, self.model.prior_precision, 0.0)

    def each_view_alone(self) -> CameraObservations:
        """The views of one rig as a batch of rigs with one view each."""
        whitening = None if self.whitening is None else self.whitening[:, None]
        lengths2 = None if self.lengths2 is None else self.lengths2[:, None]
        return replace(
            self, pixels=self.pixels[:, None], is_seen=self.is_seen[:, None], whitening=whitening, lengths2=lengths2
        )

    def n_coordinates(self, is_used: Bool[ndarray, "views n"]) -> float:
        """How many independent coordinates these corners are, of one rig: two each, fewer where they share pixels."""
        return 2.0 * int(is_used.sum()) if self.lengths2 is None else float(self.lengths2[is_used].sum())


@dataclass(frozen=True, slots=True, eq=False)
class BundleEstimate:
    """A point in parameter space. With a single camera nobody looks at ``T_right_left``."""

    parameters: tuple[Float[ndarray, "*batch p"], ...]
    T_left_board: SE3
    """(*batch, views)"""
    T_right_left: SE3

    @property
    def batch(self) -> tuple[int, ...]:
        """The batch's dimensions."""
        return self.T_left_board.t.shape[:-2]

    @classmethod
    def of_rig(cls, rig: StereoRig, T_left_board: SE3) -> BundleEstimate:
        """One rig with the board poses of every rig of a batch, (*batch, views)."""
        batch, T = T_left_board.t.shape[:-2], rig.T_right_left
        return cls(
            tuple(np.broadcast_to(c.parameters, (*batch, len(c.parameters))) for c in (rig.left, rig.right)),
            T_left_board,
            SE3.unchecked(np.broadcast_to(T.R, (*batch, 3, 3)), np.broadcast_to(T.t, (*batch, 3))),
        )


@dataclass(frozen=True, slots=True, eq=False)
class BundleEquations:
    """The problem linearised at an estimate.

    Per-camera equations and the total robust cost (inf where the estimate is impossible).

    The cost includes ``prior_energy``, half the squared standardised distance from the priors, times the squared
    ``scale_px`` that stands for the noise.
    """

    cameras: tuple[ViewEquations, ...]
    cost_px2: Float[ndarray, "*batch"]
    prior_energy: Float[ndarray, "*batch"]
    scale_px: Float[ndarray, "*batch"]

    @property
    def r2_px2(self) -> tuple[Float[ndarray, "*batch views n"], ...]:
        """Squared residual lengths of each camera, as :meth:`BundleProblem.residual_lengths2` gives them."""
        return tuple(e.r2_px2 for e in self.cameras)

    def cost_under(self, scale_px: Float[ndarray, "*batch"], kernel: robust.Kernel) -> Float[ndarray, "*batch"]:
        """Robust cost of the same residuals under another scale of the kernel."""
        total = scale_px**2 * self.prior_energy
        for e in self.cameras:
            total = total + robust_costs(e.r2_px2.reshape(*e.r2_px2.shape[:-2], -1), scale_px, kernel)
        return np.where(np.isfinite(self.cost_px2), total, np.inf)


BundleStep = Steps
"""A Newton-like step: shared parameters (free ones only, in order), view poses, and the predicted fall of the cost."""

BundleState = LoopState[BundleEstimate, BundleEquations, BundleStep]
BundleMinimum = Minimum[BundleEstimate, BundleEquations]


def adjoint(R: Float[ndarray, "*batch 3 3"], t: Float[ndarray, "*batch 3"]) -> Float[ndarray, "*batch 6 6"]:
    """Adjoint of a transform: a left step xi seen through T_a_b is the left step Ad xi after it."""
    out = np.zeros((*R.shape[:-2], 6, 6))
    out[..., :3, :3] = R
    out[..., 3:, 3:] = R
    out[..., 3:, :3] = so3.hat(t) @ R
    return out


@dataclass(frozen=True, slots=True, eq=False)
class ModelPrior:
    """The weak priors of the cameras' models, a term like any other (:class:`binocal.solvers.problem.SharedTerm`)."""

    def energy(self, problem: BundleProblem, estimate: BundleEstimate) -> Float[ndarray, "*batch"]:
        """Half the squared distance of the coefficients from 0, in standard deviations."""
        energy = np.zeros(estimate.batch)
        for camera, parameters in zip(problem.cameras, estimate.parameters, strict=True):
            energy = energy + 0.5 * (parameters**2 @ camera.prior_precision)
        return energy

    def normal_equations(
        self, problem: BundleProblem, estimate: BundleEstimate
    ) -> tuple[Float[ndarray, "*batch s s"], Float[ndarray, "*batch s"]]:
        """A diagonal information; the gradient pulls towards 0."""
        precision = np.zeros(problem.n_shared)
        gradient = np.zeros((*estimate.batch, problem.n_shared))
        for camera, parameters, place in zip(problem.cameras, estimate.parameters, problem.places, strict=True):
            precision[place] = camera.prior_precision[camera.is_free]
            gradient[..., place] = -precision[place] * parameters[..., camera.is_free]
        return np.broadcast_to(np.diag(precision), (*estimate.batch, *(2 * precision.shape))), gradient


MODEL_PRIOR = ModelPrior()


@dataclass(frozen=True, slots=True, eq=False)
class BundleProblem:
    """The measurements: one or two cameras that saw the same views of the board (:class:`binocal.solvers.problem.Problem`).

    ``held_part`` of ``T_right_left`` does not move although the rig is free. ``terms`` are priors on the shared unknowns, beside
    the weak ones of the cameras' models.
    """

    object_points: Float[ndarray, "3 n"] = field(metadata=SHARED)
    cameras: tuple[CameraObservations, ...]
    is_rig_free: bool = True
    held_part: Literal["rotation", "translation"] | None = None
    terms: tuple[SharedTerm[BundleProblem, BundleEstimate], ...] = field(default=(), metadata=SHARED)

    @property
    def is_stereo(self) -> bool:
        """Two cameras rather than one."""
        return len(self.cameras) == 2

    @property
    def is_whitened(self) -> bool:
        """Whether some corners count more than others."""
        return any(c.whitening is not None for c in self.cameras)

    @property
    def unwhitened(self) -> BundleProblem:
        """The same measurements with all corners alike: residuals in pixels."""
        return replace(self, cameras=tuple(replace(c, whitening=None, lengths2=None) for c in self.cameras))

    @property
    def n_shared(self) -> int:
        """Free parameters that all views share: intrinsics, then the rig's six."""
        return sum(int(c.is_free.sum()) for c in self.cameras) + (6 if self.is_stereo and self.is_rig_free else 0)

    @property
    def n_free(self) -> int:
        """The same less what is held of the rig: the shared unknowns that measurements pay for."""
        return self.n_shared - (3 if self.held_part else 0)

    def free_directions(self, estimate: BundleEstimate) -> Float[ndarray, "*batch s k"] | None:
        """Columns that span the shared steps which move nothing that is held; None where nothing is.

        A left step (omega, tau) of the rig moves its translation by tau + omega x t.
        """
        if self.held_part is None:
            return None
        s, T = self.n_shared, estimate.T_right_left
        directions = np.zeros((*estimate.batch, s, s - 3))
        directions[..., np.arange(s - 6), np.arange(s - 6)] = 1.0
        if self.held_part == "rotation":
            directions[..., -3:, -3:] = np.eye(3)
        else:
            directions[..., -6:-3, -3:] = np.eye(3)
            directions[..., -3:, -3:] = so3.hat(T.t)
        return directions

    @property
    def places(self) -> tuple[slice, ...]:
        """Where each camera's free parameters stand among the shared unknowns."""
        ends = np.cumsum([0, *(int(c.is_free.sum()) for c in self.cameras)])
        return tuple(slice(int(a), int(b)) for a, b in itertools.pairwise(ends))

    @property
    def all_terms(self) -> tuple[SharedTerm[BundleProblem, BundleEstimate], ...]:
        """The priors, those of the models too."""
        return (MODEL_PRIOR, *self.terms) if any(c.model.has_prior for c in self.cameras) else self.terms

    def camera_poses(self, estimate: BundleEstimate) -> tuple[SE3, ...]:
        """``T_camera_board`` of every view for each camera of the self."""
        left, rig = estimate.T_left_board, estimate.T_right_left
        if not self.is_stereo:
            return (left,)
        return left, SE3.unchecked(*compose_poses(rig.R, rig.t, left.R, left.t))

    def residual_lengths2(self, estimate: BundleEstimate) -> tuple[Float[ndarray, "*batch views n"], ...]:
        """Squared residual lengths of each camera, whitened where it has a whitening; 0 where not seen."""
        poses = self.camera_poses(estimate)
        lengths2 = []
        for c, p, T in zip(self.cameras, estimate.parameters, poses, strict=True):
            given = (p, T.R, T.t, self.object_points, c.pixels, c.is_seen, c.whitening)
            is_compiled = c.model.is_compiled
            lengths2.append(
                squared_lengths(c.model.name, *given)
                if is_compiled
                else plain_equations.squared_lengths(c.model, *given)
            )
        return tuple(lengths2)

    def noise_estimate_px(self, r2_px2: tuple[ndarray, ...]) -> Float[ndarray, "*batch"]:
        """Noise of one corner coordinate of each rig from the squared residual lengths of its cameras (MAD); floored."""
        return robust.scale_of_median(median_lengths2(r2_px2, tuple(c.is_seen for c in self.cameras)))

    def linearize(
        self, estimate: BundleEstimate, scale_px: Float[ndarray, "*batch"], kernel: robust.Kernel
    ) -> BundleEquations:
        """Residuals and normal equations of all cameras at an estimate."""
        poses = self.camera_poses(estimate)
        equations = []
        for c, p, T in zip(self.cameras, estimate.parameters, poses, strict=True):
            given = (p, T.R, T.t, self.object_points, c.pixels, c.is_seen, scale_px, kernel, c.is_free, c.whitening)
            is_compiled = c.model.is_compiled
            equations.append(
                accumulate(c.model.name, *given) if is_compiled else plain_equations.accumulate(c.model, *given)
            )
        costs = [e.cost_px2.sum(axis=-1) for e in equations]
        cost = costs[0] + costs[1] if self.is_stereo else costs[0]
        energy = np.zeros(cost.shape)
        for parameters in estimate.parameters:
            has_focal = parameters[..., :2] > 0
            if not has_focal.all():
                cost = np.where(has_focal.all(axis=-1), cost, np.inf)
        for term in self.all_terms:
            energy = energy + term.energy(self, estimate)
        scale_px = np.asarray(scale_px, dtype=float)
        if scale_px.shape != cost.shape:
            scale_px = np.broadcast_to(scale_px, cost.shape)
        return BundleEquations(tuple(equations), cost + scale_px**2 * energy, energy, scale_px)

    def solve_step(
        self,
        estimate: BundleEstimate,
        equations: BundleEquations,
        damping: Float[ndarray, "*batch"],
        stretch: Float[ndarray, "*batch 2"] | None = None,
        increment: Float[ndarray, "*batch 6"] | None = None,
        pose_damping: Float[ndarray, "*batch"] | None = None,
    ) -> BundleStep:
        """Levenberg-Marquardt step with Marquardt's scaling (1963): the diagonal grows by the factor 1 + damping.

        ``stretch`` multiplies the step of the rig's rotation and translation, ``increment`` takes its place; the board poses take
        their best step beside it.
        ``pose_damping``, if given, damps the board poses in place of ``damping``. NaN where the damped equations are singular (a rig
        of the batch is degenerate).
        """
        growth = 1 + np.asarray(damping, dtype=float)
        stretches = shifts = None
        if stretch is not None:
            stretches = np.ones((*growth.shape, self.n_shared))
            stretches[..., -6:] = np.repeat(stretch, 3, axis=-1)
        if increment is not None:
            stretches, shifts = np.ones((*growth.shape, self.n_shared)), np.zeros((*growth.shape, self.n_shared))
            stretches[..., -6:], shifts[..., -6:] = 0.0, increment
        pose_growth = None if pose_damping is None else 1 + np.asarray(pose_damping, dtype=float)
        kernels_equations = self._equations(estimate, equations)
        if (directions := self.free_directions(estimate)) is not None:
            reduced, gradient = reduced_equations(**kernels_equations, growth=growth, pose_growth=pose_growth)
            stretches, shifts = np.zeros(gradient.shape), _step_along(directions, reduced, gradient)
        return solve_steps(
            **kernels_equations,
            growth=growth,
            pose_growth=pose_growth,
            stretch=stretches,
            shift=shifts,
        )

    def shared_information(self, estimate: BundleEstimate, equations: BundleEquations) -> Float[ndarray, "*batch s s"]:
        """Information of the shared parameters for unit noise, all board poses free; priors count."""
        information = reduced_information(**self._equations(estimate, equations))
        if (directions := self.free_directions(estimate)) is not None:
            information = directions.swapaxes(-1, -2) @ information @ directions
        return information

    def _equations(self, estimate: BundleEstimate, equations: BundleEquations) -> dict[str, Any]:
        """What the kernel needs to know of the normal equations."""
        prior = None
        if terms := self.all_terms:
            parts = [term.normal_equations(self, estimate) for term in terms]
            weight = equations.scale_px[..., None] ** 2
            prior = (weight[..., None] * sum(part[0] for part in parts), weight * sum(part[1] for part in parts))
        return {
            "grams": tuple(e.gram for e in equations.cameras),
            "T_right_left": (estimate.T_right_left.R, estimate.T_right_left.t) if self.is_stereo else None,
            "is_rig_free": self.is_rig_free,
            "prior": prior,
        }

    def retract(self, estimate: BundleEstimate, step: BundleStep) -> BundleEstimate:
        """The estimate moved by a step."""
        parameters, column = [], 0
        for camera, values in zip(self.cameras, estimate.parameters, strict=True):
            free = np.flatnonzero(camera.is_free)
            moved = np.zeros(values.shape)
            moved[..., free] = step.shared[..., column : column + len(free)]
            column += len(free)
            parameters.append(camera.model.step_parameters(values, moved))
        views, rig = estimate.T_left_board, estimate.T_right_left
        views = SE3.unchecked(*step_poses(views.R, views.t, step.views))
        if self.is_stereo and self.is_rig_free:
            R, t = step_poses(rig.R, rig.t, step.shared[..., column:])
            rig = SE3.unchecked(
                rig.R if self.held_part == "rotation" else R, rig.t if self.held_part == "translation" else t
            )
        return BundleEstimate(tuple(parameters), views, rig)

    def straightened(self, estimate: BundleEstimate, step: BundleStep, bend: Float[ndarray, "*batch"]) -> BundleProblem:
        """The problem as it looks from the estimate once the step is taken, projections followed to second order.

        Its residuals at ``estimate`` are those that the step leaves, so a second linear step from it corrects the first one
        for the bending of the projections, and for corners that only the first step shows to be outliers. ``bend`` is the
        share of the second order that counts.

        Source: Chebyshev's method; as geodesic acceleration in Transtrum & Sethna 2012, "Improvements to the
        Levenberg-Marquardt algorithm". Here the corrected residuals are weighed anew.
        """
        cameras, column = [], 0
        has_rig = self.is_stereo and self.is_rig_free
        rig_step = step.shared[..., -6:] if has_rig else np.zeros((*step.shared.shape[:-1], 6))
        for index, (camera, values) in enumerate(zip(self.cameras, estimate.parameters, strict=True)):
            moved = np.zeros(values.shape)
            count = int(camera.is_free.sum())
            moved[..., camera.is_free] = step.shared[..., column : column + count]
            column += count
            rig = (estimate.T_right_left.R, estimate.T_right_left.t, rig_step) if index == 1 else None
            poses = (estimate.T_left_board.R, estimate.T_left_board.t, step.views)
            pixels = pixels_behind(
                camera.model.name, (values, moved), poses, rig, self.object_points, camera.pixels, bend
            )
            cameras.append(replace(camera, pixels=pixels))
        return replace(self, cameras=tuple(cameras))

    def limited(self, step: BundleStep) -> BundleStep:
        """The step, shortened where it would turn the rig by more than a camera can turn and still see the board."""
        turn = _turn_rad(step)
        if not (turn > LONGEST_TURN_RAD).any():
            return step
        share = np.minimum(1.0, LONGEST_TURN_RAD / np.maximum(turn, 1e-300))
        return replace(step, shared=step.shared * share[..., None], views=step.views * share[..., None, None])

    def corrected(self, step: BundleStep, correction: BundleStep, is_wanted: Bool[ndarray, "*batch"]) -> BundleStep:
        """The sum of both where a correction is wanted and turns the rig by no more than the step did or a harmless angle."""
        longest = np.maximum(MAX_CORRECTION * _turn_rad(step), HARMLESS_TURN_RAD)
        is_sound = is_wanted & np.isfinite(correction.predicted_px2) & (_turn_rad(correction) <= longest)
        return replace(
            step,
            shared=step.shared + np.where(is_sound[..., None], correction.shared, 0.0),
            views=step.views + np.where(is_sound[..., None, None], correction.views, 0.0),
        )

    def with_views_at_best(
        self, estimate: BundleEstimate, scale_px: Float[ndarray, "*batch"], kernel: robust.Kernel
    ) -> BundleEstimate:
        """The estimate with every board pose stepped to where it fits best, cameras and rig held."""
        held = tuple(replace(c, is_free=np.zeros(c.is_free.shape, dtype=bool)) for c in self.cameras)
        problem = BundleProblem(self.object_points, held, is_rig_free=False)
        equations = problem.linearize(estimate, scale_px, kernel)
        return problem.retract(estimate, problem.solve_step(estimate, equations, np.zeros(np.shape(scale_px))))

    def with_lost_views_restored(
        self, candidate: BundleEstimate, equations: BundleEquations, start: BundleEstimate
    ) -> BundleEstimate:
        """The candidate with the poses of views as at the start whose left corners have all lost their weight.

        A redescending kernel gives a view that an early step threw off no way back; the start's pose fitted the left image.
        """
        left = self.cameras[0]
        no_weight = robust.HAMPEL_LIMIT * np.square(equations.scale_px)[..., None] * left.is_seen.sum(axis=-1)
        is_lost = (equations.cameras[0].cost_px2 > LOST_SHARE * no_weight) & (no_weight > 0)
        if not is_lost.any():
            return candidate
        return replace(candidate, T_left_board=choose_rigs(is_lost, start.T_left_board, candidate.T_left_board))


def _turn_rad(step: BundleStep) -> Float[ndarray, "*batch"]:
    omega = step.shared[..., -6:-3]
    return np.sqrt((omega * omega).sum(axis=-1))


def _step_along(
    directions: Float[ndarray, "*batch s k"],
    reduced: Float[ndarray, "*batch s s"],
    gradient: Float[ndarray, "*batch s"],
) -> Float[ndarray, "*batch s"]:
    """The step that solves the equations within the directions; NaN where they are singular there."""
    A = directions.swapaxes(-1, -2) @ reduced @ directions
    b = (directions.swapaxes(-1, -2) @ gradient[..., None])[..., 0]
    scale = 1 / np.sqrt(np.maximum(np.diagonal(A, axis1=-2, axis2=-1), 1e-300))
    try:
        x = np.linalg.solve(A * scale[..., None] * scale[..., None, :], (scale * b)[..., None])[..., 0]
    except np.linalg.LinAlgError:  # one rig is enough
        x = np.full(b.shape, np.nan)
    return (directions @ (scale * x)[..., None])[..., 0]
