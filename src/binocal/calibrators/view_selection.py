"""The views of a long recording that determine depth best, and what leaving out the others costs.

A rig is calibrated on a few views spread over the recording; with it each view's information on the shared parameters
(its normal equations without its board pose) is known. Views are then taken one after the other, each time the one
that lowers the predicted variance of depth most (greedy A-optimal design, weighted by what depth depends on). Time and
memory are linear in the views.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.calibrators import calibrate_named_or_best_model
from binocal.calibrators.base import MIN_VIEWS, CalibrationRequest
from binocal.calibrators.registry import load_calibrator
from binocal.cameras import Camera, StereoRig, camera_model
from binocal.errors import TooFewViewsError
from binocal.evidence import Detections
from binocal.geometry import SE3, so3
from binocal.result import StereoCalibration
from binocal.shapes import Float, Int
from binocal.solvers.board_views import (
    BundleEstimate,
    BundleProblem,
    CameraObservations,
)
from binocal.solvers.poses import estimate_board_poses
from binocal.solvers.whitening import CornerWeights, corner_weights

PILOT_VIEWS = 40  # spread over the recording; enough for a rig whose error does not change the order of the views
CHUNK_VIEWS = 256  # views linearised at a time: bounds the memory
SHORTLIST = 12  # views compared exactly in each round, the best by their gradient
MISFIT_FACTOR = 4.0  # a view whose RMS is that many times the usual one is not worth its information
FIELD = (0.15, 0.5, 0.85)  # where depth is evaluated: shares of the left image's width and height
DISTANCES = (0.6, 1.0, 2.0)  # at these multiples of the median distance of the boards


@dataclass(frozen=True, slots=True, eq=False)
class ViewSelection:
    """The chosen views, in rising order, and the relative depth error to expect from them and from all of them.

    The figures are the predicted standard deviation of depth over depth that the calibration alone causes, as root mean
    square over the field and the working distances; NaN where views were not chosen by it.
    """

    views: Int[ndarray, "k"]
    n_views: int
    depth_sigma: float
    all_depth_sigma: float
    misfits: tuple[str, ...] = ()

    def sentence(self) -> str:
        """What was chosen and what it costs."""
        text = (
            f"{len(self.views)} of {self.n_views} views were chosen by how well they determine depth: the calibration's share "
            f"of the depth error is then {100 * self.depth_sigma:.3g} % of the depth, with all views it would be "
            f"{100 * self.all_depth_sigma:.3g} % ({self.depth_sigma / self.all_depth_sigma:.2f} times)"
        )
        if self.misfits:
            named = ", ".join(self.misfits[:5]) + (", ..." if len(self.misfits) > 5 else "")
            text += f"; {len(self.misfits)} views that contradict the others were passed over: {named}"
        return text

    def document(self, max_views: int) -> dict[str, Any]:
        """What the provenance keeps of it."""
        return {
            "max_views": max_views,
            "n_views": self.n_views,
            "depth_sigma": self.depth_sigma,
            "all_depth_sigma": self.all_depth_sigma,
            "misfits": list(self.misfits),
            "reason": self.sentence(),
        }


def select_views(detections: Detections, request: CalibrationRequest, *, calibrator: str = "drl") -> ViewSelection:
    """The ``request.max_views`` views that together determine depth best.

    Raises:
        ValueError: ``request.max_views`` is None.
        CalibrationError: The views spread over the recording give no trustworthy rig.
        CancelledError: ``request.should_stop`` said so.
    """
    if request.max_views is None:
        raise ValueError("max_views is None: say how many views to choose")
    everything = np.arange(detections.n_views)
    both = detections.left_is_seen.any(axis=1) & detections.right_is_seen.any(axis=1)
    candidates = everything[both]
    if len(candidates) < MIN_VIEWS:
        raise TooFewViewsError(len(candidates), MIN_VIEWS)
    spread = np.unique(np.linspace(0, len(candidates) - 1, PILOT_VIEWS).round().astype(int))
    method = load_calibrator(calibrator)
    pilot = calibrate_named_or_best_model(detections.select(candidates[spread]), method, request)
    weights = corner_weights(detections, pilot.corners.misfit_px)
    information, prior, rms_px, distance_m = _informations(detections, weights, candidates, pilot.rig, request)
    is_good = rms_px < MISFIT_FACTOR * np.median(rms_px[np.isfinite(rms_px)])
    misfits = tuple(detections.names[i] for i in candidates[~is_good])
    candidates, information = candidates[is_good], information[is_good] / _noise_px(pilot, weights) ** 2
    target = depth_target(pilot.rig, float(np.median(distance_m[is_good])), skew=request.skew)
    # Scaled so that the sum of all views has a unit diagonal: pixels and distortion differ by 10^8 in their squares.
    total = prior + information.sum(axis=0)
    scale = 1 / np.sqrt(np.diagonal(total))
    information = information * scale[:, None] * scale
    prior, total = prior * scale[:, None] * scale, total * scale[:, None] * scale
    target = target * scale[:, None] * scale
    n_wanted = min(request.max_views, len(candidates))
    chosen = np.sort(
        choose_greedily(
            information, prior, target, n_wanted, each=lambda done: request.report("choosing views", done, n_wanted)
        )
    )
    sigmas = [
        float(np.sqrt(np.trace(np.linalg.solve(H, target)))) for H in (prior + information[chosen].sum(axis=0), total)
    ]
    return ViewSelection(candidates[chosen], detections.n_views, sigmas[0], sigmas[1], misfits)


def choose_greedily(
    information: Float[ndarray, "views s s"],
    prior: Float[ndarray, "s s"],
    target: Float[ndarray, "s s"],
    n: int,
    *,
    each: Callable[[int], None] | None = None,
) -> Int[ndarray, "n"]:
    """Indices of ``n`` views, in the order in which each lowers trace(target inverse(information)) most.

    Until enough views are chosen to determine everything, a tenth of an average view stands in for the rest. Candidates
    are ranked by the criterion's gradient; the first few are compared exactly, because the gradient flatters views that
    repeat each other. ``each`` is called with the number of views chosen so far.
    """
    H = prior + 0.1 * information.mean(axis=0)
    is_free = np.ones(len(information), bool)
    flat = information.reshape(len(information), -1)
    chosen = []
    for _ in range(min(n, len(information))):
        C = np.linalg.inv(H)
        gradient = np.where(is_free, flat @ (C @ target @ C).ravel(), -np.inf)
        shortlist = np.argsort(gradient)[-SHORTLIST:]
        shortlist = shortlist[is_free[shortlist]]
        exact = np.trace(
            np.linalg.solve(H + information[shortlist], np.broadcast_to(target, (len(shortlist), *H.shape))),
            axis1=1,
            axis2=2,
        )
        best = int(shortlist[np.argmin(exact)])
        chosen.append(best)
        is_free[best] = False
        H = H + information[best]
        if each is not None:
            each(len(chosen))
    return np.array(chosen, dtype=int)


def depth_target(rig: StereoRig, distance_m: float, *, skew: bool = False) -> Float[ndarray, "s s"]:
    """Mean of g g^T, g the derivative of relative depth by the shared parameters in the solver's order.

    Taken over points across the left image at several distances that both cameras see; the points' pixels are held,
    and depth is what the least-squares ray intersection makes of them.
    """
    width, height = rig.left.size_wh
    u, v, share = (axis.ravel() for axis in np.meshgrid(np.array(FIELD) * width, np.array(FIELD) * height, DISTANCES))
    rays = rig.left.unproject(np.stack([u, v], axis=-1))
    points = rays / rays[:, 2:] * (share * distance_m)[:, None]
    points = points[np.isfinite(points).all(axis=1)]
    points = points[np.isfinite(_project_both(rig, points)).all(axis=1)]
    if len(points) == 0:
        raise ValueError("no point at the boards' distance is seen by both cameras")
    steps_m = 1e-6 * distance_m
    P = np.stack(
        [
            (_project_both(rig, points + d) - _project_both(rig, points - d)) / (2 * steps_m)
            for d in steps_m * np.eye(3)
        ],
        axis=-1,
    )  # (points, 4, 3)
    columns = [
        (_project_both(plus, points) - _project_both(minus, points)) / (2 * step)
        for plus, minus, step in _neighbours(rig, skew)
    ]
    J = np.stack(columns, axis=-1)  # (points, 4, s)
    depth = -np.linalg.solve(P.swapaxes(1, 2) @ P, P.swapaxes(1, 2) @ J)[:, 2] / points[:, 2:]
    return depth.T @ depth / len(points)


def _project_both(rig: StereoRig, points: Float[ndarray, "n 3"]) -> Float[ndarray, "n 4"]:
    return np.concatenate([rig.left.project(points), rig.right.project(rig.T_right_left.apply(points))], axis=1)


def _neighbours(rig: StereoRig, skew: bool) -> list[tuple[StereoRig, StereoRig, float]]:
    """The rig stepped forth and back along each shared parameter, in the solver's order and its left steps."""
    out = []
    for side in ("left", "right"):
        camera: Camera = getattr(rig, side)
        for i in range(len(camera.parameters)):
            if i == 4 and not skew:
                continue
            step = 1e-3 if i < 5 else 1e-6
            move = step * (np.arange(len(camera.parameters)) == i)
            out.append(
                (
                    replace(rig, **{side: replace(camera, parameters=camera.parameters + move)}),
                    replace(rig, **{side: replace(camera, parameters=camera.parameters - move)}),
                    step,
                )
            )
    T = rig.T_right_left
    for i in range(6):
        rigs = []
        step = 1e-6 * (1.0 if i < 3 else max(float(np.linalg.norm(T.t)), 1e-9))
        for sign in (1, -1):
            xi = sign * step * (np.arange(6) == i)
            turn = so3.exp(xi[:3])
            rigs.append(replace(rig, T_right_left=SE3(turn @ T.R, turn @ T.t + xi[3:])))
        out.append((rigs[0], rigs[1], step))
    return out


def _noise_px(pilot: StereoCalibration, weights: CornerWeights) -> float:
    """The pilot's noise in the unit of these weights."""
    own = corner_weights(pilot.corners.detections, pilot.corners.misfit_px)
    return pilot.noise_px if own.is_uniform else pilot.noise_px * weights.unit_px / own.unit_px


def _informations(
    detections: Detections,
    weights: CornerWeights,
    views: Int[ndarray, "k"],
    rig: StereoRig,
    request: CalibrationRequest,
) -> tuple[Float[ndarray, "k s s"], Float[ndarray, "s s"], Float[ndarray, "k"], Float[ndarray, "k"]]:
    """Each view's information for a noise of 1 px, that of the models' priors, RMS residuals, distances of the boards.

    Where corners have weights, the residuals are whitened and the noise is in their unit.
    """
    blocks, rms, distances = [], [], []
    prior = np.zeros(0)
    for start in range(0, len(views), CHUNK_VIEWS):
        request.report("weighing views", start, len(views))
        chosen = views[start : start + CHUNK_VIEWS]
        chunk, chunk_weights = detections.select(chosen), weights.select(chosen)
        poses = estimate_board_poses(rig, chunk, weights=chunk_weights)
        r2 = np.concatenate([poses.left_r2_px2, poses.right_r2_px2], axis=1)
        seen = np.isfinite(r2).any(axis=1) & poses.is_found
        rms_px = np.full(len(seen), np.inf)
        rms_px[seen] = np.sqrt(np.nanmean(r2[seen], axis=1))
        problem = _problem_per_view(chunk, chunk_weights, rig, request.skew)
        n = chunk.n_views
        estimate = BundleEstimate.of_rig(rig, poses.T_left_board[:, None])
        blank = np.ones(n)
        H = problem.shared_information(estimate, problem.linearize(estimate, blank, "squared"))
        prior = np.concatenate([c.prior_precision[c.is_free] for c in problem.cameras] + [np.zeros(6)])
        H = H - np.diag(prior)  # each view's equations hold the priors; they count once
        H[~seen] = 0
        blocks.append(0.5 * (H + H.swapaxes(1, 2)))
        rms.append(rms_px)
        centre = poses.T_left_board.R @ detections.object_points_m.mean(axis=0) + poses.T_left_board.t
        distances.append(np.linalg.norm(centre, axis=-1))
    request.report("weighing views", len(views), len(views))
    return np.concatenate(blocks), np.diag(prior), np.concatenate(rms), np.concatenate(distances)


def _problem_per_view(detections: Detections, weights: CornerWeights, rig: StereoRig, skew: bool) -> BundleProblem:
    """Every view as a rig of its own in a batch."""
    cameras = tuple(
        CameraObservations.from_corners(
            camera_model(camera.model), px, skew=skew, whitening=whitening
        ).each_view_alone()
        for camera, px, whitening in (
            (rig.left, detections.left_px, weights.left),
            (rig.right, detections.right_px, weights.right),
        )
    )
    return BundleProblem(np.ascontiguousarray(detections.object_points_m.T), cameras)
