"""``heterogeneous``: two cameras of different kinds, such as colour and thermal, in one solve in which each counts by its own noise.

Such cameras differ in resolution, lens, blur and noise, and the thermal one may see the board's light and dark exchanged, so that its
corners are numbered from the other end. The points are sorted in each camera against the other's, each camera is calibrated alone,
what it leaves of its own corners is its noise, and the joint solve weighs the corners of both by that.

Source: the paper's related work [9] as its text describes it (a high-definition colour camera and an infrared thermal one; locate and
sort the points of the plate in each, calibrate the cameras, then the pair); near it Li, Wu & Wang 2021 (10.1364/oe.405600). Deviations:
the pair is solved jointly with both cameras' intrinsics, robustly, with all the checks of ``lm``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy import ndarray

from binocal.calibrators.base import CalibrationRequest
from binocal.calibrators.joint import calibrate_jointly
from binocal.calibrators.staged import DiagnosedViews, check_detections, diagnosed_views, solve_camera
from binocal.evidence import Detections, changed_orders
from binocal.evidence.detections import PER_CORNER
from binocal.result import StereoCalibration
from binocal.shapes import Float
from binocal.solvers.staged_covariance import CameraStage
from binocal.solvers.whitening import estimate_misfit_px

NAME = "heterogeneous"
SIDES = ("left", "right")


def calibrate_heterogeneous(evidence: Detections, request: CalibrationRequest) -> StereoCalibration:
    """The joint solve, each camera's corners by their own noise (see :class:`binocal.calibrators.base.Calibrator`)."""
    detections = check_detections(NAME, evidence)
    request.check_options()
    diagnosed = diagnosed_views(detections, request)
    request.check_stop()
    ordered = _sorted_points(detections, diagnosed)
    weighed, noise_px, n_iterations = ordered, {}, 0
    for index, side in enumerate(SIDES):
        stage, n, _ = solve_camera(diagnosed, index, request)
        n_iterations += n
        weighed, noise_px[side] = _with_noise_of(weighed, diagnosed, side, stage)
        request.check_stop()
    calibration = calibrate_jointly(weighed, request)
    left, right = changed_orders(detections, ordered)
    said = {"added_noise_px": noise_px, "views_sorted": {"left": len(left), "right": len(right)}}
    return replace(
        calibration,
        n_iterations=calibration.n_iterations + n_iterations,
        evidence=replace(
            calibration.corners, detections=_as_measured(calibration.corners.detections, weighed, ordered)
        ),
        provenance={**calibration.provenance, "heterogeneous": said},
    )


def _as_measured(used: Detections, weighed: Detections, ordered: Detections) -> Detections:
    """The used views with the covariances that their corners came with."""
    place = {name: i for i, name in enumerate(ordered.names)}
    restored = ordered.select(np.array([place[name] for name in used.names]))
    left, right = changed_orders(weighed, used)
    restored = restored.reorder("left", {view: np.array(order) for view, order in left.items()})
    return restored.reorder("right", {view: np.array(order) for view, order in right.items()})


def _sorted_points(detections: Detections, diagnosed: DiagnosedViews) -> Detections:
    """All views, those that can be used with the points of both cameras in one order."""
    views = diagnosed.views
    place = {name: i for i, name in enumerate(detections.names)}
    index = np.array([place[name] for name in views.names])
    arrays = {}
    for name in PER_CORNER:
        if (given := getattr(detections, name)) is not None:
            arrays[name] = given.copy()
            arrays[name][index] = getattr(views, name)
    return replace(detections, **arrays)


def _with_noise_of(
    ordered: Detections, diagnosed: DiagnosedViews, side: str, stage: CameraStage
) -> tuple[Detections, float]:
    """The detections with one camera's covariances as its own residuals ask for, and the standard deviation that was added."""
    n = ordered.left_px.shape[:2]
    added_px, covariance = stage.noise_px, getattr(ordered, f"{side}_covariance_px2")
    if covariance is None:
        stated = np.broadcast_to(np.zeros((2, 2)), (*n, 2, 2))
    else:
        added_px = _misfit_px(diagnosed, side, np.square(stage.residuals_px).sum(axis=-1))
        stated = covariance
    widened = stated + added_px**2 * np.eye(2)
    if side == "left":
        return replace(ordered, left_covariance_px2=widened), added_px
    return replace(ordered, right_covariance_px2=widened), added_px


def _misfit_px(diagnosed: DiagnosedViews, side: str, lengths2_px2: Float[ndarray, "views n"]) -> float:
    """What one camera's residuals exceed its corners' own covariances by."""
    other = "right" if side == "left" else "left"
    alone = replace(diagnosed.views, **{f"{other}_covariance_px2": None, f"{other}_cross_covariance_px2": None})
    return estimate_misfit_px(alone, (lengths2_px2, lengths2_px2))
