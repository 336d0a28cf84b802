"""Whether a rig agrees with new images of a board as far as its own standard deviations allow, and what has changed if not.

The new views are solved with the rig as a prior so wide that it decides nothing which they tell: :data:`WIDE` times its standard
deviations, or :data:`NARROW` times them where that explains the corners as well. Views that tell little run off, with a wide one, to
where nothing is linear; a narrow one would rather give up the corners of a rig that has changed than follow them.

The difference of the two rigs, over the covariances of both, is a chi-squared statistic with one degree of freedom for each direction of
which the views say anything. A single cause may lie in one of these directions and be lost among the chance of all, so each is tested
alone as well, and the p-value is that of the more telling test, times the number of tests. Where standard deviations rest on few views
(those that were widened by what views have in common), the statistic over its degrees of freedom is F-distributed (Hotelling's T², to
first order). Where it is too large, the causes that a rig can have are fitted to the difference in turn: the one that explains most
names the drift.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.calibrators.agreement_causes import fit_causes, likeliest_cause
from binocal.calibrators.base import CalibrationRequest
from binocal.calibrators.board_and_exposures import RealViewsSolve
from binocal.calibrators.joint import RobustSolver, solve_as_they_were, solve_with_misfit
from binocal.cameras import StereoRig
from binocal.errors import CalibrationError, DataError
from binocal.evidence import Detections
from binocal.geometry import SE3, so3
from binocal.initialization.poses import estimate_poses
from binocal.requirements.agreement import Agreement
from binocal.requirements.figures import freedom_of
from binocal.result import StereoCalibration
from binocal.shapes import Float
from binocal.solvers.board_views import BundleEstimate
from binocal.solvers.covariance import inliers, real_covariance
from binocal.solvers.minimization import minimize
from binocal.solvers.poses import MIN_CORNERS, estimate_board_poses
from binocal.solvers.prior import PriorTerm, RigPrior
from binocal.uncertainty import Covariance

WIDE, NARROW = 100.0, 10.0  # standard deviations; 0.05 deg of a good rig are 20 to 60 of them
MOST_APART = (
    3.0  # times what each camera alone leaves, and what the pair left over that in the calibration: no rig's own error
)
AS_WELL = 1.02  # times the noise, and so many times the corners that carry weight
LEAST_INFORMATION = 1e-2  # of a direction, over what the rig's own covariance says: below, the views say nothing of it


def measure_agreement(calibration: StereoCalibration, detections: Detections, T_left_board: SE3) -> Agreement:
    """The rig against new views, whose board poses are about ``T_left_board``; views without a pose are left out.

    The board may be bent: its shape is freed where the views say so. What the calibration's views had in common, the new ones are
    taken to have too.

    Raises:
        DataError: The calibration states no covariance, or a singular one.
        CalibrationError: The views cannot be solved.
    """
    rig, covariance = calibration.rig, _sound(calibration.stated_covariance)
    seen = detections.left_is_seen.sum(axis=1) + detections.right_is_seen.sum(axis=1) >= MIN_CORNERS
    used = np.flatnonzero(seen)
    views, poses = detections.select(used), SE3(T_left_board.R[used], T_left_board.t[used])
    alone_px, pair_px = _alone_and_paired(rig, views, poses)
    usual = 1.0 if calibration.exposure is None else max(calibration.exposure.ratio, 1.0)
    is_gross = pair_px > MOST_APART * usual * max(alone_px, calibration.noise_px)
    found = _compared_by_solving(calibration, covariance, views, poses)
    if found is None or (not found.freedom and not is_gross):
        if not is_gross:
            raise CalibrationError("the views say too little to be compared with the rig.")
        none = np.zeros(0)
        found = Agreement(np.inf, 0, 0.0, (), none, np.zeros((0, 0)), alone_px)
    p_value = 0.0 if is_gross else found.p_value
    return replace(found, p_value=p_value, is_gross=is_gross, alone_px=alone_px, pair_px=pair_px)


def _compared_by_solving(
    calibration: StereoCalibration, covariance: Covariance, views: Detections, poses: SE3
) -> Agreement | None:
    """None where the views cannot be solved."""
    rig = calibration.rig
    at_rig = BundleEstimate((rig.left.parameters, rig.right.parameters), poses, rig.T_right_left)
    free = _best(
        [_solved(calibration, covariance, views, start, WIDE) for start in (at_rig, *_apart(at_rig, rig, views))]
    )
    near = _solved(calibration, covariance, views, at_rig, NARROW)
    chosen = (
        near
        if free is None or (near is not None and _explains_as_well(near, free, views, len(covariance.names)))
        else free
    )
    if chosen is None:
        return None
    told, _, views_in_common = real_covariance(
        chosen.solve.problem,
        chosen.solve.minimum.estimate,
        chosen.solve.minimum.equations,
        chosen.solve.reduced,
        chosen.solve.noise_px,
    )
    away = PriorTerm(chosen.prior).distance(chosen.solve.minimum.estimate.bundle)
    factor = float(calibration.provenance.get("views_in_common", {}).get("sigma_factor", 1.0))
    excess = max(factor / views_in_common.factor, 1.0) ** 2
    return _compared(rig, covariance, away, told, excess, chosen.solve.noise_px, chosen.width, freedom_of(calibration))


def _alone_and_paired(rig: StereoRig, views: Detections, poses: SE3) -> tuple[float, float]:
    """Median distance of the corners from their predictions, pixels: each camera with board poses of its own, and both with one."""
    hidden = np.full(views.left_px.shape, np.nan)
    left = estimate_board_poses(rig, replace(views, right_px=hidden)).left_r2_px2
    right = estimate_board_poses(rig, replace(views, left_px=hidden)).right_r2_px2
    both = estimate_board_poses(rig, views, poses)
    paired = np.concatenate([both.left_r2_px2, both.right_r2_px2], axis=1)
    paired = paired[views.left_is_seen.any(axis=1) & views.right_is_seen.any(axis=1)]
    alone = np.concatenate([left, right], axis=1)
    medians = (float(np.sqrt(np.nanmedian(r2))) if np.isfinite(r2).any() else 0.0 for r2 in (alone, paired))
    alone_px, pair_px = medians
    return alone_px, pair_px


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    """The new views solved with a prior of so many standard deviations; how many corners carry weight."""

    width: float
    prior: RigPrior
    solve: RealViewsSolve
    n_used: int


def _solved(
    calibration: StereoCalibration, covariance: Covariance, views: Detections, start: BundleEstimate, width: float
) -> _Solved | None:
    """None where the solve does not reach a minimum.

    Exposures are freed only where those of the calibration were apart, and never beside a narrow prior: they would take up a turn of
    the rig.
    """
    rig = calibration.rig
    try:
        prior = RigPrior.from_rig(
            rig, Covariance(covariance.names, width**2 * covariance.matrix), held=_held(rig, covariance.names)
        )
    except ValueError as error:
        raise DataError(f"the rig's covariance cannot be compared with: {error}.") from None
    were_apart = calibration.exposure is not None and calibration.exposure.are_apart
    exposure = "auto" if were_apart and width == WIDE else "together"
    request = CalibrationRequest(rig.left.model, "left.skew" in covariance.names, prior=prior, exposure=exposure)
    problem, minimum, _, _ = solve_with_misfit(views, request, start, RobustSolver(minimize))
    solve = solve_as_they_were(problem, minimum, request, replace(views, object_sigma_m=None))
    if not np.isfinite(solve.noise_px) or not solve.minimum.is_converged:
        return None
    return _Solved(width, prior, solve, sum(int(used.sum()) for used in inliers(solve.problem, solve.minimum)))


def _apart(at_rig: BundleEstimate, rig: StereoRig, views: Detections) -> list[BundleEstimate]:
    """A start from each camera alone, for a rig that is far off; none where no view has a pose in both."""
    left, right = (
        estimate_poses(camera.model, camera.parameters, views.object_points_m, px)
        for camera, px in ((rig.left, views.left_px), (rig.right, views.right_px))
    )
    both = left.is_usable & right.is_usable
    if not both.any():
        return []
    R = right.R[both] @ left.R[both].swapaxes(1, 2)
    t = right.t[both] - np.einsum("vij,vj->vi", R, left.t[both])
    R_mean = so3.project_to_rotation(R.mean(axis=0))
    own = SE3(
        so3.project_to_rotation(np.where(left.is_usable[:, None, None], left.R, at_rig.T_left_board.R)),
        np.where(left.is_usable[:, None], left.t, at_rig.T_left_board.t),
    )
    return [replace(at_rig, T_left_board=own, T_right_left=SE3(R_mean, np.median(t, axis=0)))]


def _best(solved: Sequence[_Solved | None]) -> _Solved | None:
    """That in which most corners carry weight; of nearly as many, that with the least noise."""
    found = [one for one in solved if one is not None]
    most = max((one.n_used for one in found), default=0)
    return min((one for one in found if AS_WELL * one.n_used >= most), key=lambda one: one.solve.noise_px, default=None)


def _explains_as_well(near: _Solved, free: _Solved, views: Detections, n_parameters: int) -> bool:
    """Whether the narrow prior's solve leaves no more noise than chance makes of the freedom that it lacks, and no fewer corners."""
    left = max(2 * free.n_used - 6 * views.n_views - n_parameters, 1)
    by_chance = float(np.sqrt(1 + (n_parameters + 4 * np.sqrt(2 * n_parameters)) / left))
    is_as_quiet = near.solve.noise_px < max(AS_WELL, by_chance) * free.solve.noise_px
    return is_as_quiet and free.n_used < AS_WELL * near.n_used


def _compared(
    rig: StereoRig,
    covariance: Covariance,
    away: Float[ndarray, "p"],
    told: Float[ndarray, "p p"],
    excess: float,
    noise_px: float,
    width: float,
    behind: float,
) -> Agreement:
    """The statistic in the directions that the views tell of.

    In units of the rig's covariance, along the eigenvectors of what the views add, information is t, the wide prior's 1 / width²: the
    views' own estimate is the found one over t / (t + 1 / width²), with variance 1 / t, and that of the rig 1.
    """
    sigma = np.sqrt(np.diag(covariance.matrix))
    w, vectors = np.linalg.eigh(covariance.matrix / np.outer(sigma, sigma))
    L = sigma[:, None] * vectors * np.sqrt(np.maximum(w, 1e-15 * w[-1]))
    whitened = np.linalg.solve(L, np.linalg.solve(L, told).T)
    n, V = np.linalg.eigh(np.linalg.inv(0.5 * (whitened + whitened.T)))
    t = np.maximum(n - width**-2, 0.0)
    tells = t > LEAST_INFORMATION
    d = V.T @ np.linalg.solve(L, away)
    d = d[tells] * n[tells] / t[tells]
    variance = 1.0 + excess / t[tells]
    W = (L @ V)[:, tells]
    statistic, freedom = float(np.sum(d**2 / variance)), int(tells.sum())
    basis = np.linalg.solve(L, np.eye(len(L)))
    forms = V.T[tells] @ basis / np.sqrt(variance)[:, None]  # standardised difference of a change of the parameters
    causes = fit_causes(rig, covariance.names, forms, d / np.sqrt(variance))
    by_cause = min((_chance(c.freedom, behind, c.gain) for c in causes), default=1.0)
    p_value = min(1.0, 2 * min(_chance(freedom, behind, statistic), len(causes) * by_cause))
    agreement = Agreement(
        statistic,
        freedom,
        p_value,
        covariance.names,
        W @ d,
        (W * (excess / t[tells])) @ W.T,
        noise_px,
    )
    if agreement.agrees:
        return agreement
    return replace(agreement, cause=likeliest_cause(rig, causes, statistic))


def _sound(covariance: Covariance) -> Covariance:
    """Without parameters that have no variance: those were held."""
    keep = np.flatnonzero(np.diag(covariance.matrix) > 0)
    return Covariance(tuple(covariance.names[i] for i in keep), covariance.matrix[np.ix_(keep, keep)])


def _held(rig: StereoRig, names: tuple[str, ...]) -> tuple[str, ...]:
    """What the covariance does not name is held: whole parts of the rig, or single intrinsics."""
    from binocal.solvers.prior import camera_names

    held = [
        n for side in ("left", "right") for n in camera_names(rig, side) if n not in names and not n.endswith(".skew")
    ]
    return (*held, *(part for part in ("rotation", "translation") if f"{part}.x" not in names))


def _chance(freedom: int, behind: float, statistic: float) -> float:
    """How often the statistic is as large by chance; ``behind`` are the degrees of freedom of the standard deviations."""
    from scipy.special import fdtrc  # a tenth of a second to import

    return float(fdtrc(freedom, behind, statistic / freedom)) if freedom else 1.0
