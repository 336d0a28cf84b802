"""``wide-field``: lenses of 110 to 220 degrees, as of long-wave infrared pairs: least squares over all views at once.

Each camera is calibrated alone with a model that follows the image's height over the angle from the axis; the pose between them is
found by least squares over all views' corners, not as the mean of the poses that single views give; then everything is solved
together. What the mean of the views would have left stands beside it, as the binocular mean reprojection error
(:func:`binocal.metrics.binocular.binocular_error_px`).

Source: the paper's related work [11], Wang, Li, Liu, Huang & Chen 2020; the mean of the views is Bouguet's toolbox way that it compares
with. Deviations: Kannala & Brandt's model of four coefficients in place of Scaramuzza's polynomial; a robust kernel; the joint end.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy import ndarray

from binocal.calibrators.base import CalibrationRequest
from binocal.calibrators.joint import calibrate_jointly
from binocal.calibrators.lens_kind import OtherKind, other_kind
from binocal.calibrators.registry import refuse_unsuited
from binocal.cameras import StereoRig, camera_model
from binocal.evidence import Detections
from binocal.geometry import SE3, so3
from binocal.metrics.binocular import binocular_error_px
from binocal.result import StereoCalibration
from binocal.shapes import Float
from binocal.solvers.board_views import BundleEstimate, BundleMinimum, BundleProblem, CameraObservations
from binocal.solvers.minimization import LoopOptions, minimize

NAME = "wide-field"
TOGETHER = (
    1.2  # of what each camera alone leaves: an ordinary lens that fits the pair so well leaves no motion to explain
)
MIN_CORNERS = 6  # of a view in one camera, for a pose of its own


def calibrate_wide_field(evidence: Detections, request: CalibrationRequest) -> StereoCalibration:
    """Least squares over all views (see :class:`binocal.calibrators.base.Calibrator`).

    Raises:
        ValueError: The request asks for another camera model than fisheye4.
    """
    refuse_unsuited(NAME, request)
    calibration = calibrate_jointly(evidence, request, minimizer=_CamerasFirst())
    request.check_stop()
    if (other := other_kind(calibration)) is not None:
        calibration = _with_lenses_doubted(calibration, other, evidence, request)
        request.check_stop()
    mean = mean_of_views(calibration)
    views = calibration.corners.detections
    errors = {
        "all_views_px": binocular_error_px(calibration.rig, views),
        "mean_of_views_px": binocular_error_px(mean, views),
    }
    said = {"wide_field": {"binocular_mean_reprojection_error": errors}}
    return replace(calibration, provenance={**calibration.provenance, **said})


def _with_lenses_doubted(
    calibration: StereoCalibration, other: OtherKind, evidence: Detections, request: CalibrationRequest
) -> StereoCalibration:
    """The calibration of lenses that an ordinary model fits as well or better: it says so, and its standard deviations hold the difference.

    Exposures that are apart to this model alone are taken for one moment.
    """
    exposure = calibration.exposure
    is_in_question = exposure is not None and exposure.are_apart and request.exposure == "auto"
    if exposure is not None and is_in_question and other.noise_px < TOGETHER * exposure.alone_px:
        calibration = calibrate_jointly(evidence, replace(request, exposure="together"), minimizer=_CamerasFirst())
        calibration = _without(calibration, "exposures-apart")
        other = other_kind(calibration) or other
    covariance = other.widened(calibration.covariance)
    return replace(calibration, covariance=covariance, findings=(*other.findings, *calibration.findings))


def _without(calibration: StereoCalibration, code: str) -> StereoCalibration:
    return replace(calibration, findings=tuple(found for found in calibration.findings if found.code != code))


def mean_of_views(calibration: StereoCalibration) -> StereoRig:
    """The rig of cameras calibrated alone and the mean of the poses between them that single views give.

    From the corners of a calibration; rotations are averaged after Markley, Cheng, Crassidis & Oshman 2007.
    """
    views, rig = calibration.corners.detections, calibration.rig
    points = np.ascontiguousarray(views.object_points_m.T)
    T_left_board = calibration.corners.T_left_board
    cameras, poses = [], []
    for camera, T, px in (
        (rig.left, T_left_board, views.left_px),
        (rig.right, rig.T_right_left @ T_left_board, views.right_px),
    ):
        observed = CameraObservations.from_corners(camera_model(camera.model), px)
        start = BundleEstimate((camera.parameters,), T, SE3.identity())
        found = minimize(BundleProblem(points, (observed,)), start).estimate
        cameras.append(replace(camera, parameters=found.parameters[0]))
        poses.append(found.T_left_board)
    both = (views.left_is_seen.sum(axis=1) >= MIN_CORNERS) & (views.right_is_seen.sum(axis=1) >= MIN_CORNERS)
    relative = poses[1][both] @ poses[0][both].inverse()
    return replace(
        rig, left=cameras[0], right=cameras[1], T_right_left=SE3(so3.mean(relative.R), relative.t.mean(axis=0))
    )


class _CamerasFirst:
    """A minimiser that begins with each camera alone and the pose between them with the cameras held; later solves go on from there."""

    def __init__(self) -> None:
        self.has_begun = False

    def __call__(
        self,
        problem: BundleProblem,
        start: BundleEstimate,
        options: LoopOptions | None = None,
        *,
        scale_px: Float[ndarray, "*batch"] | None = None,
    ) -> BundleMinimum:
        if self.has_begun or problem.terms:
            return minimize(problem, start, options, scale_px=scale_px)
        self.has_begun = True
        parameters, n_iterations = [], 0
        for camera, values, T in zip(problem.cameras, start.parameters, problem.camera_poses(start), strict=True):
            alone = BundleEstimate((values,), T, SE3.identity())
            found = minimize(replace(problem, cameras=(camera,)), alone)
            parameters.append(found.estimate.parameters[0])
            n_iterations += int(found.n_iterations)
        held = replace(
            problem,
            cameras=tuple(replace(c, is_free=np.zeros_like(c.is_free)) for c in problem.cameras),
        )
        posed = minimize(held, replace(start, parameters=(parameters[0], parameters[1])))
        n_iterations += int(posed.n_iterations)
        end = minimize(problem, posed.estimate, options)
        return replace(end, n_iterations=end.n_iterations + n_iterations)
