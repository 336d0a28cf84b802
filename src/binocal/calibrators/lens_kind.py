"""Whether lenses may be of another kind than the model that a method solves for: an ordinary one fits the same corners as well or better.

A model that lacks what a lens does (a fisheye's coefficients have none for lenses that sit askew) leaves residuals that differ from view
to view, as cameras do that were not triggered together; or hardly any, and a pose between the cameras that makes up for what it lacks.
The same corners are therefore solved for with Brown's model, too. What both models differ by is known no better than that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from binocal.cameras import StereoRig, camera_model
from binocal.findings import Finding, finding
from binocal.geometry import SE3, so3
from binocal.initialization.model_start import fit_intrinsics
from binocal.result import Covariance, StereoCalibration
from binocal.solvers.board_views import BundleEstimate, BundleProblem, CameraObservations
from binocal.solvers.minimization import minimize

ORDINARY = "brown5"
MOST_DEG = 60.0  # from the axis: a corner seen beyond, and no ordinary lens has seen it
INLIER_SIGMAS = 5.0
TOLD_SIGMAS = 2.0  # of the difference between both models' rigs
DECISIVE_BIC = 10.0  # "very strong" evidence (Kass & Raftery 1995, section 3.2)
SHARED = ("fx", "fy", "cx", "cy")  # what means the same in both models


@dataclass(frozen=True, slots=True, eq=False)
class OtherKind:
    """What an ordinary lens model makes of the corners: its rig's difference from the calibration's, and both noises, pixels."""

    findings: tuple[Finding, ...]
    noise_px: float
    names: tuple[str, ...]
    difference: np.ndarray

    def widened(self, covariance: Covariance) -> Covariance:
        """The covariance with the difference between both models as an error of one standard deviation."""
        d = np.zeros(len(covariance.names))
        for name, value in zip(self.names, self.difference.tolist(), strict=True):
            if name in covariance.names:
                d[covariance.names.index(name)] = value
        return Covariance(covariance.names, covariance.matrix + np.outer(d, d))


def other_kind(calibration: StereoCalibration) -> OtherKind | None:
    """What an ordinary model makes of the corners; None where they are seen too far from an axis, or it fits decisively worse."""
    views, rig = calibration.corners.detections, calibration.rig
    points = views.object_points_m
    pixels = (views.left_px, views.right_px)
    T_left_board = calibration.corners.T_left_board
    start, observed = [], {rig.left.model: [], ORDINARY: []}
    for camera, T, px in zip(
        (rig.left, rig.right), (T_left_board, rig.T_right_left @ T_left_board), pixels, strict=True
    ):
        seen = T.apply(points)
        is_seen = np.isfinite(px[..., 0])
        if not is_seen.any():
            return None
        cosine = seen[..., 2] / np.linalg.norm(seen, axis=-1)
        if cosine[is_seen].min() < np.cos(np.radians(MOST_DEG)):
            return None
        model = camera_model(ORDINARY)
        plain = np.r_[camera.parameters[:5], np.zeros(model.n_parameters - 5)]
        fitted = fit_intrinsics(model, plain, seen[is_seen], px[is_seen])
        if fitted is None:
            return None
        start.append(fitted)
        for name, list_of in observed.items():
            list_of.append(CameraObservations.from_corners(camera_model(name), px))
    board = np.ascontiguousarray(points.T)
    own_problem = BundleProblem(board, tuple(observed[rig.left.model]))
    own_start = BundleEstimate((rig.left.parameters, rig.right.parameters), T_left_board, rig.T_right_left)
    own = minimize(own_problem, own_start)
    problem = BundleProblem(board, tuple(observed[ORDINARY]))
    other = minimize(problem, BundleEstimate((start[0], start[1]), T_left_board, rig.T_right_left))
    r2 = [np.stack(p.residual_lengths2(m.estimate)) for p, m in ((own_problem, own), (problem, other))]
    kept = np.isfinite(r2[0]) & np.isfinite(r2[1])
    kept &= (r2[0] < np.nanmedian(r2[0]) * INLIER_SIGMAS**2) & (r2[1] < np.nanmedian(r2[1]) * INLIER_SIGMAS**2)
    if not (kept.any() and bool(other.is_converged)):
        return None
    own_px, other_px = (float(np.sqrt(np.mean(r[kept]) / 2)) for r in r2)
    n = 2 * int(kept.sum())
    more = 2 * (camera_model(ORDINARY).n_parameters - camera_model(rig.left.model).n_parameters)
    better = 2 * n * np.log(own_px / other_px)
    if better < -DECISIVE_BIC:
        return None
    parameters, T = other.estimate.parameters, other.estimate.T_right_left
    names, difference = _difference(rig, parameters, SE3(so3.project_to_rotation(T.R), T.t))
    sigma = calibration.covariance.sigma
    in_sigmas = max(abs(d) / max(sigma.get(name, np.inf), 1e-300) for name, d in zip(names, difference, strict=True))
    found = finding(
        "lens-of-another-kind",
        model=rig.left.model,
        own_px=own_px,
        other=ORDINARY,
        other_px=other_px,
        sigmas=float(in_sigmas),
    )
    is_told = better - more * np.log(n) > DECISIVE_BIC or in_sigmas > TOLD_SIGMAS
    return OtherKind((found,) if is_told else (), other_px, names, difference)


def _difference(
    rig: StereoRig, parameters: tuple[np.ndarray, ...], T_right_left: SE3
) -> tuple[tuple[str, ...], np.ndarray]:
    """The other rig's parameters less this one's, those that mean the same, in the coordinates of a covariance."""
    names, values = [], []
    for side, camera, other in zip(("left", "right"), (rig.left, rig.right), parameters, strict=True):
        own = dict(zip(camera_model(camera.model).parameter_names, camera.parameters.tolist(), strict=True))
        theirs = dict(zip(camera_model(ORDINARY).parameter_names, np.asarray(other).tolist(), strict=True))
        names += [f"{side}.{name}" for name in SHARED]
        values += [theirs[name] - own[name] for name in SHARED]
    T = rig.T_right_left
    names += [f"{part}.{axis}" for part in ("rotation", "translation") for axis in "xyz"]
    values += [*so3.log(T_right_left.R @ T.R.T).tolist(), *(T_right_left.t - T.t).tolist()]
    return tuple(names), np.array(values)
