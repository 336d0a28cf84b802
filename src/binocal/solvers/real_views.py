"""Bundle adjustment of board views as they really are: a board that is not as it was drawn, exposures that differ.

The problem of :mod:`binocal.solvers.board_views` with two kinds of unknowns more, each with a prior whose variances come from the
data (:mod:`binocal.solvers.board_shape`, :mod:`binocal.solvers.exposures`):

- an offset of every board point from its nominal place, along the board's axes;
- one small deviation of the right camera's pose from the rig in each view, ``X <- exp(w) (X - c) + c + d`` with c the board's
  centre in that view: where the cameras are not triggered together, the board moves between the exposures.

Both stay inside the scheme: views are eliminated first, with blocks of 6 or 12 unknowns, and the points are shared unknowns. One
rig at a time. All functions are pure.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.geometry import SE3, so3
from binocal.kernels import (
    PointEquations,
    PoseSteps,
    Steps,
    ViewEquations,
    accumulate,
    accumulate_with_points,
    compose_poses,
    median_lengths2,
    point_gradients,
    reduce_stereo,
    robust_costs,
    squared_lengths,
)
from binocal.shapes import Float, Int
from binocal.solvers import robust
from binocal.solvers.board_views import BundleEstimate, BundleProblem, adjoint
from binocal.solvers.joint_system import JointSystem, ReducedSystem, reduce, solve_symmetric
from binocal.solvers.minimization import Minimum


@dataclass(frozen=True, slots=True, eq=False)
class RealViewsEstimate:
    """A point in parameter space: rig and board poses, board points, and the right camera's deviation in each view."""

    bundle: BundleEstimate
    points: Float[ndarray, "3 n"]
    deviations: Float[ndarray, "views 6"]
    """Rotation vector and shift of the right camera's view of the board; 0 where the exposures are one."""

    @property
    def batch(self) -> tuple[int, ...]:
        """No batch."""
        return ()


@dataclass(frozen=True, slots=True, eq=False)
class RealViewsEquations:
    """The problem linearised at an estimate, and its robust cost (see :class:`binocal.solvers.problem.Equations`)."""

    cameras: tuple[ViewEquations, ...]
    points: tuple[PointEquations, ...]
    cost_px2: Float[ndarray, "*batch"]
    prior_energy: Float[ndarray, "*batch"]
    scale_px: Float[ndarray, "*batch"]

    @property
    def r2_px2(self) -> tuple[Float[ndarray, "views n"], ...]:
        """Squared residual lengths of each camera."""
        return tuple(e.r2_px2 for e in self.cameras)

    @property
    def rss_px2(self) -> float:
        """Sum of squared residual lengths, with the kernel's weights and without the priors."""
        return sum(float(e.gram[..., -1, -1].sum()) for e in self.cameras)

    def cost_under(self, scale_px: Float[ndarray, "*batch"], kernel: robust.Kernel) -> Float[ndarray, "*batch"]:
        """Robust cost of the same residuals under another scale of the kernel."""
        total = scale_px**2 * self.prior_energy
        for e in self.cameras:
            total = total + robust_costs(e.r2_px2.reshape(-1), scale_px, kernel)
        return np.where(np.isfinite(self.cost_px2), total, np.inf)


@dataclass(frozen=True, slots=True, eq=False)
class RealViewsStep:
    """A step of all unknowns, and the fall of the cost that it predicts."""

    shared: Float[ndarray, "s"]
    points: Float[ndarray, "m"]
    own: Float[ndarray, "views P"]
    predicted_px2: Float[ndarray, "*batch"]


@dataclass(frozen=True, slots=True, eq=False)
class RealViewsProblem:
    """Measurements of two cameras, with priors of the board's offsets and of the exposures' deviations.

    ``shape_information`` is the inverse covariance of the points' offsets (x of all points, then y, z; per square metre), that of
    the directions which no image tells included; None holds the points where they are. ``deviation_sigma`` are the standard
    deviations of a deviation's rotation (radians) and shift (metres); None holds the exposures together.
    """

    nominal: BundleProblem
    shape_information: Float[ndarray, "m m"] | None = None
    deviation_sigma: tuple[float, float] | None = None
    centres: Float[ndarray, "views 3"] | None = None
    """About which deviations turn, in the right camera's frame: the board's centre in each view, at the start."""

    @property
    def cameras(self) -> tuple:
        """Those of the nominal problem."""
        return self.nominal.cameras

    @property
    def is_whitened(self) -> bool:
        """Whether some corners count more than others."""
        return self.nominal.is_whitened

    @property
    def unwhitened(self) -> RealViewsProblem:
        """The same measurements with all corners alike: residuals in pixels."""
        return replace(self, nominal=self.nominal.unwhitened)

    @property
    def n_free(self) -> int:
        """Intrinsics and the rig's parameters that measurements pay for."""
        return self.nominal.n_free

    @property
    def has_priors(self) -> bool:
        """Whether anything but measurements counts."""
        return bool(self.nominal.all_terms) or self.shape_information is not None or self.deviation_sigma is not None

    def start(self, bundle: BundleEstimate) -> RealViewsEstimate:
        """The nominal board and exposures that are one."""
        return RealViewsEstimate(bundle, self.nominal.object_points, np.zeros((len(bundle.T_left_board.t), 6)))

    def _deviation(self, estimate: RealViewsEstimate) -> SE3 | None:
        """What moves the right camera's view of the board from where the rig has it."""
        if self.centres is None:
            return None
        turn = so3.exp(estimate.deviations[:, :3])
        return SE3.unchecked(
            turn, self.centres + estimate.deviations[:, 3:] - np.einsum("vij,vj->vi", turn, self.centres)
        )

    def camera_poses(self, estimate: RealViewsEstimate) -> tuple[SE3, SE3]:
        """``T_camera_board`` of every view for both cameras."""
        rig, left = estimate.bundle.T_right_left, estimate.bundle.T_left_board
        right = SE3.unchecked(*compose_poses(rig.R, rig.t, left.R, left.t))
        deviation = self._deviation(estimate)
        if deviation is not None:  # a wild step may be no rotation: its cost is infinite, it is no error
            t = np.einsum("vij,vj->vi", deviation.R, right.t) + deviation.t
            right = SE3.unchecked(deviation.R @ right.R, t)
        return left, right

    def residual_lengths2(self, estimate: RealViewsEstimate) -> tuple[Float[ndarray, "views n"], ...]:
        """Squared residual lengths of each camera, whitened where it has a whitening; 0 where not seen."""
        return tuple(
            squared_lengths(c.model.name, p, T.R, T.t, estimate.points, c.pixels, c.is_seen, c.whitening)
            for c, p, T in zip(self.cameras, estimate.bundle.parameters, self.camera_poses(estimate), strict=True)
        )

    def noise_estimate_px(self, r2_px2: tuple[ndarray, ...]) -> Float[ndarray, "*batch"]:
        """Noise of one corner coordinate from the squared residual lengths (MAD); floored."""
        return np.asarray(robust.scale_of_median(median_lengths2(r2_px2, tuple(c.is_seen for c in self.cameras))))

    def points_gradient(
        self, estimate: RealViewsEstimate, scale_px: Float[ndarray, "*batch"], kernel: robust.Kernel
    ) -> Float[ndarray, "m"]:
        """The data's gradient of the points' coordinates, x of all points first; at a minimum with the points held, the reduced one."""
        total = np.zeros_like(estimate.points)
        for c, p, T in zip(self.cameras, estimate.bundle.parameters, self.camera_poses(estimate), strict=True):
            given = (p, T.R, T.t, estimate.points, c.pixels, c.is_seen, scale_px, kernel, c.whitening)
            total += point_gradients(c.model.name, *given)
        return total.reshape(-1)

    def of_views(
        self, estimate: RealViewsEstimate, views: Int[ndarray, "k"]
    ) -> tuple[RealViewsProblem, RealViewsEstimate]:
        """Problem and estimate of some views only."""
        cameras = tuple(
            replace(
                c,
                pixels=c.pixels[views],
                is_seen=c.is_seen[views],
                whitening=None if c.whitening is None else c.whitening[views],
                lengths2=None if c.lengths2 is None else c.lengths2[views],
            )
            for c in self.nominal.cameras
        )
        centres = None if self.centres is None else self.centres[views]
        problem = replace(self, nominal=replace(self.nominal, cameras=cameras), centres=centres)
        T = estimate.bundle.T_left_board
        bundle = replace(estimate.bundle, T_left_board=SE3.unchecked(T.R[views], T.t[views]))
        return problem, RealViewsEstimate(bundle, estimate.points, estimate.deviations[views])

    def prior_energy(self, estimate: RealViewsEstimate) -> Float[ndarray, "*batch"]:
        """Half the squared distance from all priors, in standard deviations."""
        energy = np.zeros(())
        for term in self.nominal.all_terms:
            energy = energy + term.energy(self.nominal, estimate.bundle)
        if self.shape_information is not None:
            offset = (estimate.points - self.nominal.object_points).reshape(-1)
            energy = energy + 0.5 * offset @ self.shape_information @ offset
        if self.deviation_sigma is not None:
            energy = energy + 0.5 * np.sum((estimate.deviations / self._deviation_scale) ** 2)
        return np.asarray(energy)

    @property
    def _deviation_scale(self) -> Float[ndarray, "6"]:
        assert self.deviation_sigma is not None
        return np.repeat(self.deviation_sigma, 3)

    def linearize(
        self,
        estimate: RealViewsEstimate,
        scale_px: Float[ndarray, "*batch"],
        kernel: robust.Kernel,
        *,
        with_points: bool = False,
    ) -> RealViewsEquations:
        """Residuals and normal equations of both cameras at an estimate, those of the board's points where they are free or wanted."""
        cameras, points = [], []
        for c, p, T in zip(self.cameras, estimate.bundle.parameters, self.camera_poses(estimate), strict=True):
            given = (p, T.R, T.t, estimate.points, c.pixels, c.is_seen, scale_px, kernel, c.is_free, c.whitening)
            if self.shape_information is None and not with_points:
                cameras.append(accumulate(c.model.name, *given))
            else:
                equations, coupling = accumulate_with_points(c.model.name, *given)
                cameras.append(equations)
                points.append(coupling)
        cost = cameras[0].cost_px2.sum() + cameras[1].cost_px2.sum()
        if not all((p[:2] > 0).all() for p in estimate.bundle.parameters):
            cost = np.inf
        energy, scale_px = self.prior_energy(estimate), np.asarray(scale_px, dtype=float)
        return RealViewsEquations(
            tuple(cameras), tuple(points), np.asarray(cost + scale_px**2 * energy), energy, scale_px
        )

    def system(self, estimate: RealViewsEstimate, equations: RealViewsEquations) -> JointSystem:
        """The normal equations view by view, in the solver's unknowns."""
        left, right = equations.cameras
        n_left, n_right = (g.gram.shape[-1] - 7 for g in (left, right))
        V, has_rig = len(left.gram), self.nominal.is_rig_free
        k = n_left + n_right + (6 if has_rig else 0)
        P = 6 if self.deviation_sigma is None else 12
        # columns of each camera's own equations from those of [shared, own]
        E_left = np.zeros((V, n_left + 6, k + P))
        E_left[:, range(n_left), range(n_left)] = 1
        E_left[:, n_left:, k : k + 6] = np.eye(6)
        E_right = np.zeros((V, n_right + 6, k + P))
        E_right[:, range(n_right), range(n_left, n_left + n_right)] = 1
        rig, board, deviation = self.right_steps(estimate)
        if has_rig:
            E_right[:, n_right:, k - 6 : k] = rig
        E_right[:, n_right:, k : k + 6] = board
        if deviation is not None:
            E_right[:, n_right:, k + 6 :] = deviation
        free = self.nominal.free_directions(estimate.bundle)
        if free is not None:  # shared columns are those of the steps that move nothing that is held
            E_left, E_right = (np.concatenate([E[..., :k] @ free, E[..., k:]], axis=2) for E in (E_left, E_right))
            k = free.shape[1]
        gram = _in_unknowns(left.gram, E_left) + _in_unknowns(right.gram, E_right)
        own, own_gradient = gram[:, k:-1, k:-1].copy(), gram[:, k:-1, -1].copy()
        weight = equations.scale_px**2
        if P == 12:
            precision = weight / self._deviation_scale**2
            own[:, range(6, 12), range(6, 12)] += precision
            own_gradient[:, 6:] -= precision * estimate.deviations
        m = int(np.prod(equations.points[0].coupling.shape[2:])) if equations.points else 0
        coupling, information = np.zeros((V, k + P + 1, m)), np.zeros((V, 6, 0))
        if m:
            for E, e in zip((E_left, E_right), equations.points, strict=True):
                flat = e.coupling.reshape(V, e.coupling.shape[1], m)
                coupling[:, :-1] += E.swapaxes(1, 2) @ flat[:, :-1]
                coupling[:, -1] += flat[:, -1]
            information = equations.points[0].information + equations.points[1].information
        prior, prior_gradient = self._prior(estimate, free, m)
        return JointSystem(
            own,
            own_gradient,
            gram[:, k:-1, :k],
            coupling[:, k:-1],
            gram[:, :k, :k],
            gram[:, :k, -1],
            coupling[:, :k],
            information,
            coupling[:, -1],
            weight * prior,
            weight * prior_gradient,
        )

    def right_steps(
        self, estimate: RealViewsEstimate
    ) -> tuple[Float[ndarray, "V 6 6"], Float[ndarray, "V 6 6"], Float[ndarray, "V 6 6"] | None]:
        """How steps of the rig, of the board and of the deviation step the right camera's own pose."""
        T, deviation = estimate.bundle.T_right_left, self._deviation(estimate)
        V, board = len(estimate.deviations), adjoint(T.R, T.t)
        if self.centres is None or deviation is None:
            return np.broadcast_to(np.eye(6), (V, 6, 6)), np.broadcast_to(board, (V, 6, 6)), None
        moved = adjoint(deviation.R, deviation.t)
        J = so3.left_jacobian(estimate.deviations[:, :3])
        own = np.zeros((V, 6, 6))
        own[:, :3, :3] = J
        own[:, 3:, :3] = so3.hat(self.centres + estimate.deviations[:, 3:]) @ J
        own[:, 3:, 3:] = np.eye(3)
        return moved, moved @ board, own

    def _prior(
        self, estimate: RealViewsEstimate, free: Float[ndarray, "s f"] | None, m: int
    ) -> tuple[Float[ndarray, "z z"], Float[ndarray, "z"]]:
        s = self.nominal.n_shared
        A, b = np.zeros((s, s)), np.zeros(s)
        for term in self.nominal.all_terms:
            own = term.normal_equations(self.nominal, estimate.bundle)
            A, b = A + own[0], b + own[1]
        if free is not None:
            A, b = free.T @ A @ free, free.T @ b
        k = len(b)
        information, gradient = np.zeros((k + m, k + m)), np.zeros(k + m)
        information[:k, :k], gradient[:k] = A, b
        if self.shape_information is not None:
            offset = (estimate.points - self.nominal.object_points).reshape(-1)
            information[k:, k:] = self.shape_information
            gradient[k:] = -self.shape_information @ offset
        return information, gradient

    def reduced(
        self, estimate: RealViewsEstimate, equations: RealViewsEquations, growth: float = 1.0, *, of_views: bool = True
    ) -> ReducedSystem:
        """The shared equations, views eliminated; what each view tells on its own may be left out."""
        if self.nominal.free_directions(estimate.bundle) is not None or not self.nominal.is_rig_free:
            return reduce(self.system(estimate, equations), growth)
        weight = float(equations.scale_px) ** 2
        rig, board, deviation = self.right_steps(estimate)
        precision = pull = None
        if deviation is not None:
            precision = weight / self._deviation_scale**2
            pull = -precision * estimate.deviations
        left, right = equations.cameras
        points = (equations.points[0], equations.points[1]) if equations.points else None
        steps = PoseSteps(rig, board, deviation, precision, pull)
        sums = reduce_stereo((left.gram, right.gram), steps, points, growth, of_views=of_views)
        k = left.gram.shape[-1] + right.gram.shape[-1] - 8
        prior, prior_gradient = self._prior(estimate, None, len(sums.gradient) - k)
        prior, prior_gradient = weight * prior, weight * prior_gradient
        information = sums.information + prior
        information[np.diag_indices_from(information)] += (growth - 1) * np.diagonal(prior)
        return ReducedSystem(
            k,
            sums.inverse_L,
            sums.Y,
            sums.y,
            sums.own_gradient,
            sums.own_diagonal,
            information,
            sums.gradient + prior_gradient,
            prior,
            prior_gradient,
            sums.is_determined,
            sums.view_information,
            sums.view_scores,
        )

    def solve_step(
        self, estimate: RealViewsEstimate, equations: RealViewsEquations, damping: Float[ndarray, "*batch"]
    ) -> RealViewsStep:
        """Levenberg-Marquardt step with Marquardt's scaling; NaN where the damped equations are singular."""
        growth = 1 + float(damping)
        reduced = self.reduced(estimate, equations, growth)
        x = solve_symmetric(reduced.information, reduced.gradient)
        own = reduced.own_step(x)
        # half of x'(b + D x), D what the damping added: the fall of the undamped quadratic at the damped step
        fall = own.ravel() @ reduced.own_gradient.ravel() + x @ reduced.whole_gradient()
        if growth > 1:
            diagonal = np.diagonal(reduced.information) + np.einsum("zvp,zvp->z", reduced.Y, reduced.Y)
            fall += (growth - 1) * (x**2 @ diagonal / growth + np.sum(own**2 * reduced.own_diagonal))
        k = reduced.n_shared
        free = self.nominal.free_directions(estimate.bundle)
        shared = x[:k] if free is None else free @ x[:k]
        return RealViewsStep(shared, x[k:], own, np.asarray(0.5 * fall))

    def retract(self, estimate: RealViewsEstimate, step: RealViewsStep) -> RealViewsEstimate:
        """The estimate moved by a step."""
        views = Steps(
            step.shared,
            np.ascontiguousarray(step.own[:, :6]),
            step.predicted_px2,
            np.zeros_like(step.shared),
            np.zeros(()),
        )
        points, deviations = estimate.points, estimate.deviations
        if self.shape_information is not None:
            points = points + step.points.reshape(3, -1)
        if self.deviation_sigma is not None:
            deviations = deviations + step.own[:, 6:]
        return RealViewsEstimate(self.nominal.retract(estimate.bundle, views), points, deviations)

    def shared_information(self, estimate: RealViewsEstimate, equations: RealViewsEquations) -> Float[ndarray, "s s"]:
        """Information of the cameras' and the rig's parameters for unit noise, all others free within their priors."""
        return cameras_information(self.reduced(estimate, equations))


def cameras_information(reduced: ReducedSystem) -> Float[ndarray, "s s"]:
    """Information of the cameras' and the rig's free parameters, the board's points free within their prior."""
    A, k = reduced.information, reduced.n_shared
    return A if len(A) == k else A[:k, :k] - A[:k, k:] @ solve_symmetric(A[k:, k:], A[k:, :k])


RealViewsMinimum = Minimum[RealViewsEstimate, RealViewsEquations]


def _in_unknowns(gram: Float[ndarray, "V q q"], E: Float[ndarray, "V r c"]) -> Float[ndarray, "V d d"]:
    """Gram matrices of [columns, residual] in other unknowns: columns = E times theirs."""
    V, _, c = E.shape
    out = np.empty((V, c + 1, c + 1))
    half = E.swapaxes(1, 2) @ gram[:, :-1]
    out[:, :-1, :-1] = half[..., :-1] @ E
    out[:, :-1, -1] = out[:, -1, :-1] = half[..., -1]
    out[:, -1, -1] = gram[:, -1, -1]
    return out
