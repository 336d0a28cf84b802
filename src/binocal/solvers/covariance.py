"""Covariance of the rig from the final normal equations, and the Cramér-Rao bound of a scene."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.cameras import StereoRig, camera_model
from binocal.findings import finding, refusal
from binocal.geometry import SE3, so3
from binocal.shapes import Bool, Float
from binocal.solvers import robust
from binocal.solvers.board_views import (
    BundleEquations,
    BundleEstimate,
    BundleMinimum,
    BundleProblem,
    CameraObservations,
)
from binocal.solvers.jackknife import ViewAgreement, agreement_of_views
from binocal.solvers.joint_system import ReducedSystem, solve_symmetric
from binocal.solvers.real_views import (
    RealViewsEquations,
    RealViewsEstimate,
    RealViewsMinimum,
    RealViewsProblem,
    cameras_information,
)
from binocal.solvers.whitening import CornerWeights
from binocal.uncertainty import Covariance, MeanBoardPose

SINGULAR_CONDITION = 1e15  # of the equilibrated information; a usable rig has 1e3 to 1e9, brown8 up to 1e13


def shared_names(problem: BundleProblem) -> tuple[str, ...]:
    """Names of the shared free parameters in the solver's order."""
    names: list[str] = []
    for side, camera in zip(("left", "right"), problem.cameras, strict=False):
        names += [f"{side}.{n}" for n, free in zip(camera.model.parameter_names, camera.is_free, strict=True) if free]
    if problem.is_stereo and problem.is_rig_free:
        parts = [part for part in ("rotation", "translation") if part != problem.held_part]
        names += [f"{part}.{axis}" for part in parts for axis in "xyz"]
    return tuple(names)


def shared_covariance(
    problem: BundleProblem, estimate: BundleEstimate, equations: BundleEquations, noise_px: float
) -> Float[ndarray, "s s"]:
    """Covariance of the shared parameters of one rig, all board poses free, translation stepped additively.

    Priors count as information, as they did in the estimate. Nothing is left of a problem in which everything is held.
    The solver's left step moves the translation by tau + omega x t; the covariance is that of t itself.

    Raises:
        DegenerateGeometryError: The information matrix is singular.
    """
    inverse = invert_information(problem, problem.shared_information(estimate, equations)) * noise_px**2
    return _with_additive_translation(problem, estimate, inverse)


def real_covariance(
    problem: RealViewsProblem,
    estimate: RealViewsEstimate,
    equations: RealViewsEquations,
    reduced: ReducedSystem,
    noise_px: float,
) -> tuple[Float[ndarray, "s s"], MeanBoardPose | None, ViewAgreement]:
    """Covariance of the rig from the equations at the minimum, widened by what views have in common, the boards' mean pose, what that was.

    Board and exposures are free within their priors. See :mod:`binocal.solvers.jackknife`. Raises as :func:`shared_covariance`.
    """
    inverse = invert_information(problem.nominal, cameras_information(reduced)) * noise_px**2
    scale = np.sqrt(np.diagonal(inverse))
    values, vectors = np.linalg.eigh(inverse / np.outer(scale, scale))
    L = scale[:, None] * vectors * np.sqrt(np.maximum(values, 1e-300))
    agreement = agreement_of_views(reduced, noise_px, L, lambda: problem.system(estimate, equations))
    widened = L @ agreement.widening @ L.T
    to_additive = _to_additive_translation(problem.nominal, estimate.bundle, len(widened))
    mean_pose = _mean_board_pose(reduced, noise_px, inverse, widened, agreement.factor)
    if mean_pose is not None:
        mean_pose = MeanBoardPose(mean_pose.covariance, mean_pose.with_rig @ to_additive.T)
    covariance = to_additive @ widened @ to_additive.T
    return 0.5 * (covariance + covariance.T), mean_pose, agreement


def _mean_board_pose(
    reduced: ReducedSystem,
    noise_px: float,
    independent: Float[ndarray, "s s"],
    widened: Float[ndarray, "s s"],
    factor: float,
) -> MeanBoardPose | None:
    """How the boards' mean pose errs with the rig, in the solver's unknowns; None where the equations do not tell.

    A view's own unknowns follow the shared ones x as ``inverse_Lᵀ (y - Y x)``, and scatter about that by the inverse of their own
    equations. What of their mean is regressed on the rig's errors is widened as these are, the rest by the typical ``factor``.
    """
    k = reduced.n_shared
    V, P = reduced.y.shape
    n_views = max(int(reduced.is_determined.sum()), 1)
    inverse_L = reduced.inverse_L.reshape(V * P, P)[:, :6]
    follow = -(inverse_L.T @ reduced.Y.reshape(-1, V * P).T) / n_views
    with_all = solve_symmetric(reduced.information, np.ascontiguousarray(follow.T)).T * noise_px**2
    own = follow @ with_all.T + inverse_L.T @ inverse_L * (noise_px / n_views) ** 2
    with_rig = with_all[:, :k]
    if not np.isfinite(own).all():
        return None
    if not k:
        return MeanBoardPose(0.5 * (own + own.T), with_rig)
    on_rig = solve_symmetric(independent, np.ascontiguousarray(with_rig.T)).T
    rest = own - on_rig @ with_rig.T
    own = on_rig @ widened @ on_rig.T + factor**2 * rest
    return MeanBoardPose(0.5 * (own + own.T), on_rig @ widened)


def invert_information(problem: BundleProblem, H: Float[ndarray, "s s"]) -> Float[ndarray, "s s"]:
    """The inverse of an information matrix of the shared parameters, by equilibration.

    Raises:
        DegenerateGeometryError: It is singular; the text names the parameters that nothing determines.
    """
    if H.shape[-1] == 0:
        return H
    scale = 1 / np.sqrt(np.maximum(np.diagonal(H), 1e-300))
    equilibrated = H * scale[:, None] * scale
    if not np.isfinite(equilibrated).all():
        equilibrated = np.nan_to_num(equilibrated)
    values, vectors = np.linalg.eigh(equilibrated)
    if not values[0] > values[-1] / SINGULAR_CONDITION:
        weakest = np.abs(vectors[:, 0])
        names = [shared_names(problem)[i] for i in np.argsort(-weakest)[:3]]
        raise refusal(finding("parameters-undetermined", parameters=", ".join(names)))
    inverse = (vectors / values) @ vectors.T * scale[:, None] * scale
    return 0.5 * (inverse + inverse.T)


def _with_additive_translation(
    problem: BundleProblem, estimate: BundleEstimate, covariance: Float[ndarray, "s s"]
) -> Float[ndarray, "s s"]:
    """From the solver's left step, which moves the translation by tau + omega x t, to steps of t itself."""
    to_additive = _to_additive_translation(problem, estimate, len(covariance))
    covariance = to_additive @ covariance @ to_additive.T
    return 0.5 * (covariance + covariance.T)


def _to_additive_translation(problem: BundleProblem, estimate: BundleEstimate, n: int) -> Float[ndarray, "n n"]:
    """The matrix that does it; of a rig that is held in part, whose steps are additive already, the identity."""
    to_additive = np.eye(n)
    if problem.is_stereo and problem.is_rig_free and problem.held_part is None and n:
        to_additive[-3:, -6:-3] = -so3.hat(estimate.T_right_left.t)
    return to_additive


def residual_noise_px(
    problem: BundleProblem, minimum: BundleMinimum, used: tuple[Bool[ndarray, "views n"], ...] | None = None
) -> float:
    """Noise of one corner coordinate from the weighted residuals of one rig, corrected for the fitted parameters.

    ``used`` are the :func:`inliers`, where they are known already.
    """
    weighted = sum(float(e.gram[..., -1, -1].sum()) for e in minimum.equations.cameras)
    used = inliers(problem, minimum) if used is None else used
    n_measured = sum(c.n_coordinates(of_camera) for c, of_camera in zip(problem.cameras, used, strict=True))
    n_views = int(np.logical_or.reduce([is_inlier.any(axis=-1) for is_inlier in used]).sum())
    freedom = n_measured - 6 * n_views - problem.n_free
    if freedom <= 0:
        raise refusal(finding("too-few-measurements"))
    return float(np.sqrt(weighted / freedom))


def inliers(
    problem: BundleProblem | RealViewsProblem, minimum: BundleMinimum | RealViewsMinimum
) -> tuple[Bool[ndarray, "views n"], ...]:
    """Which seen corners carry weight at the minimum."""
    return tuple(
        c.is_seen & robust.carries_weight(e.r2_px2, minimum.scale_px, minimum.kernel)
        for c, e in zip(problem.cameras, minimum.equations.cameras, strict=True)
    )


def cramer_rao_bound(
    rig: StereoRig,
    object_points_m: Float[ndarray, "n 3"],
    T_left_board: SE3,
    noise_px: float,
    *,
    left_is_seen: Bool[ndarray, "views n"] | None = None,
    right_is_seen: Bool[ndarray, "views n"] | None = None,
    skew: bool = False,
    weights: CornerWeights | None = None,
    points_information: Float[ndarray, "m m"] | None = None,
) -> Covariance:
    """Least covariance that any unbiased estimate of the rig can have.

    From corners with Gaussian noise of ``noise_px`` per coordinate; with ``weights``, of that noise once whitened.

    All board poses are unknown (nuisance) parameters. ``T_left_board`` holds one pose per view. The models' weak priors
    count as information, as they do in the estimate. With ``points_information``, the inverse covariance of how far the board's points
    may be from where they are drawn (x of all points, then y, z; per square metre), they are unknown too, the same in all views:
    ``object_points_m`` are then where they really are.

    Raises:
        DegenerateGeometryError: The scene leaves parameters undetermined.
    """
    n_views, n = len(T_left_board.t), len(object_points_m)
    weights = weights or CornerWeights()
    cameras = []
    for camera, is_seen, whitening in (
        (rig.left, left_is_seen, weights.left),
        (rig.right, right_is_seen, weights.right),
    ):
        model = camera_model(camera.model)
        seen = np.ones((n_views, n), dtype=bool) if is_seen is None else np.asarray(is_seen, dtype=bool)
        is_free = np.ones(model.n_parameters, dtype=bool)
        is_free[4] = skew
        cameras.append(CameraObservations(model, np.zeros((n_views, 2, n)), seen, is_free, whitening))
    problem = BundleProblem(np.ascontiguousarray(np.asarray(object_points_m, dtype=float).T), tuple(cameras))
    truth = BundleEstimate.of_rig(rig, T_left_board)
    if points_information is not None:
        with_points = RealViewsProblem(problem, points_information)
        at_truth = with_points.start(truth)
        reduced = with_points.reduced(at_truth, with_points.linearize(at_truth, np.asarray(noise_px), "squared"))
        inverse = invert_information(problem, cameras_information(reduced)) * noise_px**2
        return Covariance(shared_names(problem), _with_additive_translation(problem, truth, inverse))
    equations = problem.linearize(truth, np.asarray(noise_px), "squared")
    return Covariance(shared_names(problem), shared_covariance(problem, truth, equations, noise_px))
