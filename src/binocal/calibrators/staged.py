"""What calibrators share that work in stages: each camera alone, then the pose between them with the cameras held.

Views are checked and corner orders repaired as for every other calibrator; what differs is what is made of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy import ndarray

from binocal import acceptance
from binocal.acceptance.whole_set import APART_T, CLEARLY_APART_RATIO, CLEARLY_APART_T, NOT_FREED
from binocal.calibrators.base import CalibrationRequest
from binocal.calibrators.set_checking import without_copies
from binocal.cameras import Camera, StereoRig, camera_model
from binocal.evidence import Detections
from binocal.findings import Finding, finding, refusal
from binocal.geometry import SE3
from binocal.initialization.diagnosis import diagnose_views
from binocal.result import (
    Covariance,
    Evidence,
    ExposureFit,
    OutlierCorner,
    RejectedView,
    ResidualSummary,
    StereoCalibration,
    ViewResult,
)
from binocal.shapes import Bool, Float
from binocal.solvers import robust
from binocal.solvers.board_views import BundleEstimate, BundleMinimum, BundleProblem, CameraObservations
from binocal.solvers.covariance import inliers
from binocal.solvers.minimization import LoopOptions, minimize
from binocal.solvers.poses import estimate_board_poses
from binocal.solvers.staged_covariance import CameraStage, PoseStage, staged_covariance

SIDES = ("left", "right")
LEAST_RATIO = (
    1.2  # of the pair's noise over the cameras': what cameras that were fitted alone cost the pair stays below 1.1
)
MIN_CORNERS = 6  # of a view in one camera: fewer hardly tell a pose beside the lens


@dataclass(frozen=True, slots=True, eq=False)
class DiagnosedViews:
    """The views to calibrate from, their corner orders repaired, a start in closed form, and what became of the others."""

    views: Detections
    start: BundleEstimate
    rejected: tuple[RejectedView, ...]
    notes: Mapping[str, str]
    findings: tuple[Finding, ...]

    def is_seen(self, side: int) -> Bool[ndarray, "views n"]:
        """Corners of one camera in the views that show it enough of them."""
        seen = self.views.left_is_seen if side == 0 else self.views.right_is_seen
        return seen & (seen.sum(axis=1, keepdims=True) >= MIN_CORNERS)

    def pixels(self, side: int) -> Float[ndarray, "views n 2"]:
        """Corners of one camera."""
        return self.views.left_px if side == 0 else self.views.right_px

    def start_poses(self, side: int) -> SE3:
        """``T_camera_board`` of every view at the start."""
        return self.start.T_left_board if side == 0 else self.start.T_right_left @ self.start.T_left_board


def diagnosed_views(detections: Detections, request: CalibrationRequest) -> DiagnosedViews:
    """The views once each, without those that cannot be used. Raises as :func:`diagnose_views`."""
    given, copies, doubts = without_copies(detections)
    diagnosis = diagnose_views(given, request.model, has_skew=request.skew)
    used = np.flatnonzero(diagnosis.is_used)
    start = BundleEstimate(
        (diagnosis.left.parameters, diagnosis.right.parameters),
        SE3(diagnosis.R_left_board[used], diagnosis.t_left_board[used]),
        diagnosis.T_right_left,
    )
    return DiagnosedViews(
        diagnosis.detections.select(used),
        start,
        (*copies, *diagnosis.rejected),
        dict(zip(given.names, diagnosis.notes, strict=True)),
        (*doubts, *diagnosis.findings),
    )


def camera_problem(
    diagnosed: DiagnosedViews, side: int, request: CalibrationRequest, *, intrinsics: bool = True
) -> BundleProblem:
    """One camera alone with the board as drawn."""
    px = np.where(diagnosed.is_seen(side)[..., None], diagnosed.pixels(side), np.nan)
    camera = CameraObservations.from_corners(camera_model(request.model), px, skew=request.skew, intrinsics=intrinsics)
    return BundleProblem(np.ascontiguousarray(diagnosed.views.object_points_m.T), (camera,))


def solve_camera(diagnosed: DiagnosedViews, side: int, request: CalibrationRequest) -> tuple[CameraStage, int, bool]:
    """One camera's most probable parameters from its own corners, robustly; iterations, and whether it arrived."""
    problem = camera_problem(diagnosed, side, request)
    start = BundleEstimate((diagnosed.start.parameters[side],), diagnosed.start_poses(side), SE3.identity())
    minimum = minimize(problem, start)
    return _stage(problem, minimum), int(minimum.n_iterations), bool(minimum.is_converged)


def camera_as_given(
    diagnosed: DiagnosedViews, side: int, request: CalibrationRequest, parameters: Float[ndarray, "p"]
) -> CameraStage:
    """A camera that somebody else calibrated by least squares over the same corners; poses are fitted to it, all corners alike."""
    problem = camera_problem(diagnosed, side, request, intrinsics=False)
    start = BundleEstimate((parameters,), diagnosed.start_poses(side), SE3.identity())
    minimum = minimize(problem, start, LoopOptions(kernel="squared"))
    free = camera_problem(diagnosed, side, request)
    return _stage(free, minimum)


def _stage(problem: BundleProblem, minimum: BundleMinimum) -> CameraStage:
    (camera,), (used,) = problem.cameras, inliers(problem, minimum)
    parameters, T = minimum.estimate.parameters[0], minimum.estimate.T_left_board
    predicted = Camera(camera.model.name, (1, 1), parameters).project(T.apply(problem.object_points.T))
    residuals = np.where(used[..., None], camera.pixels.swapaxes(-1, -2) - predicted, 0.0)
    n_views = int(used.any(axis=1).sum())
    freedom = 2 * int(used.sum()) - 6 * n_views - int(camera.is_free.sum())
    if freedom <= 0:
        raise refusal(finding("too-few-measurements"))
    noise_px = float(np.sqrt(np.sum(residuals**2) / freedom))
    return CameraStage(
        camera.model, parameters, camera.is_free, T, used, residuals, max(noise_px, robust.SCALE_FLOOR_PX)
    )


@dataclass(frozen=True, slots=True, eq=False)
class StagedSolve:
    """What the stages made: cameras, ``T_right_left``, how it was linearised, a pose per view, iterations, what else to say.

    ``fitted`` is the pose between the cameras that fits all corners best with the cameras held, where that is another.
    """

    cameras: tuple[CameraStage, CameraStage]
    T_right_left: SE3
    second: PoseStage
    T_left_board: SE3
    n_iterations: int
    is_converged: bool
    provenance: Mapping[str, Any]
    fitted: SE3 | None = None


def poses_by_both(diagnosed: DiagnosedViews, cameras: tuple[CameraStage, CameraStage], T_right_left: SE3) -> SE3:
    """One pose per view from both cameras' corners, cameras and rig held, robustly."""
    views = diagnosed.views
    rig = _rig(views, cameras, T_right_left)
    return estimate_board_poses(rig, views, start=diagnosed.start.T_left_board).T_left_board


def _rig(views: Detections, cameras: tuple[CameraStage, CameraStage], T_right_left: SE3) -> StereoRig:
    left, right = (
        Camera(stage.model.name, size, stage.parameters)
        for stage, size in zip(cameras, (views.left_size_wh, views.right_size_wh), strict=True)
    )
    return StereoRig(left, right, SE3(T_right_left.R, T_right_left.t), views.is_metric)


def summarize_stages(
    diagnosed: DiagnosedViews, solve: StagedSolve, *, solver: str = "the solve in stages", else_use: str = ""
) -> StereoCalibration:
    """The calibration with its covariance and its residuals per view, accepted or refused like any other.

    ``solver`` and ``else_use`` as in :func:`binocal.acceptance.apply_rules`.

    Raises:
        CalibrationError: No trustworthy rig follows; the text names the cause.
    """
    views = diagnosed.views
    rig = _rig(views, solve.cameras, solve.T_right_left)
    names, covariance, factor = staged_covariance(solve.cameras, views.object_points_m, solve.second, rig.T_right_left)
    lengths2 = _lengths2(views, rig, solve.T_left_board)
    exposure, apart = _exposure(diagnosed, solve, lengths2)
    rows = [_view_result(diagnosed, i, lengths2, solve.cameras) for i in range(views.n_views)]
    used2 = [np.where(camera.is_used, r2, np.nan) for camera, r2 in zip(solve.cameras, lengths2, strict=True)]
    rms = [_rms(r2) for r2 in (*used2, np.stack(used2))]
    T_left_board = SE3(solve.T_left_board.R, solve.T_left_board.t)
    calibration = StereoCalibration(
        rig=rig,
        covariance=Covariance(names, covariance),
        rms=ResidualSummary(*rms),
        noise_px=_pooled_noise_px(solve.cameras),
        views=tuple(rows),
        rejected=diagnosed.rejected,
        findings=(*apart, *diagnosed.findings, *acceptance.scale_findings(views)),
        n_iterations=solve.n_iterations,
        exposure=exposure,
        provenance={
            "stages": {"noise_px": {side: c.noise_px for side, c in zip(SIDES, solve.cameras, strict=True)}},
            "views_in_common": {"sigma_factor": factor},
            **solve.provenance,
        },
        evidence=Evidence(views, T_left_board),
    )
    motion = acceptance.gross_motion(exposure, acceptance.corner_spacing_px(views))
    if motion is not None:
        raise refusal(motion, acceptance.describe_views(calibration))
    return acceptance.apply_rules(calibration, is_converged=solve.is_converged, solver=solver, else_use=else_use)


def _lengths2(views: Detections, rig: StereoRig, T_left_board: SE3) -> list[Float[ndarray, "views n"]]:
    """Squared distances of each camera's corners from their predictions, NaN where not seen."""
    in_left = T_left_board.apply(views.object_points_m)
    return [
        np.square(px - camera.project(points)).sum(axis=-1)
        for px, camera, points in (
            (views.left_px, rig.left, in_left),
            (views.right_px, rig.right, rig.T_right_left.apply(in_left)),
        )
    ]


def _exposure(
    diagnosed: DiagnosedViews, solve: StagedSolve, lengths2: list[Float[ndarray, "views n"]]
) -> tuple[ExposureFit, tuple[Finding, ...]]:
    """How each camera alone fits against the pair, and a warning where the pair fits worse by more than chance.

    With one pose per pair in place of two, the squares grow by six for each pair but the first, in squares of the noise, and by what
    cameras that each were fitted to their own noise cost.
    """
    if solve.fitted is not None:
        T_left_board = poses_by_both(diagnosed, solve.cameras, solve.fitted)
        lengths2 = _lengths2(diagnosed.views, _rig(diagnosed.views, solve.cameras, solve.fitted), T_left_board)
    both = solve.cameras[0].is_used & solve.cameras[1].is_used
    n_views, n = int(both.any(axis=1).sum()), int(both.sum())
    excess, pair2 = 0.0, 0.0
    for camera, r2 in zip(solve.cameras, lengths2, strict=True):
        together = float(r2[both].sum()) / camera.noise_px**2
        pair2 += together
        excess += together - float(np.square(camera.residuals_px[both]).sum()) / camera.noise_px**2
    n_cameras = sum(int(camera.is_free.sum()) for camera in solve.cameras)
    expected = 6 * (n_views - 1) + n_cameras
    T = (excess - expected) / np.sqrt(2 * expected)
    noise_px = _pooled_noise_px(solve.cameras)
    ratio = np.sqrt(pair2 / max(4 * n - 6 * n_views - 6 - n_cameras, 1))
    exposure = ExposureFit(noise_px, noise_px * max(float(ratio), 1.0))
    is_apart = T > APART_T and exposure.ratio > LEAST_RATIO
    if not (is_apart or (T > CLEARLY_APART_T and exposure.ratio > CLEARLY_APART_RATIO)):
        return exposure, ()
    return exposure, (finding("exposures-apart", alone_px=exposure.alone_px, pair_px=exposure.pair_px, how=NOT_FREED),)


def _pooled_noise_px(cameras: tuple[CameraStage, CameraStage]) -> float:
    """Noise of a corner coordinate over both cameras."""
    counts = np.array([camera.is_used.sum() for camera in cameras])
    return float(np.sqrt(np.sum(counts * np.square([c.noise_px for c in cameras])) / counts.sum()))


def _view_result(
    diagnosed: DiagnosedViews,
    view: int,
    lengths2: list[Float[ndarray, "views n"]],
    cameras: tuple[CameraStage, CameraStage],
) -> ViewResult:
    outliers, used2, n_corners = [], [], 0
    for side, (r2, camera) in enumerate(zip(lengths2, cameras, strict=True)):
        seen = np.isfinite(r2[view])
        n_corners += int(seen.sum())
        used2.append(np.where(camera.is_used[view], r2[view], np.nan))
        outliers += [
            OutlierCorner(SIDES[side], int(i), float(np.sqrt(r2[view, i])))
            for i in np.flatnonzero(seen & ~camera.is_used[view])
        ]
    name = diagnosed.views.names[view]
    together, left, right = (_rms(r2) for r2 in (np.stack(used2), *used2))
    return ViewResult(name, together, left, right, n_corners, tuple(outliers), diagnosed.notes.get(name, ""))


def _rms(lengths2: Float[ndarray, "*n"]) -> float:
    """Root of the mean of those that are not NaN; NaN where all are."""
    kept = lengths2[np.isfinite(lengths2)]
    return float(np.sqrt(kept.mean())) if len(kept) else float("nan")


def check_detections(name: str, evidence: object) -> Detections:
    """The evidence, if it is of a board.

    Raises:
        TypeError: It is another kind.
    """
    if not isinstance(evidence, Detections):
        raise TypeError(f"calibrator {name!r} works from Detections of a board; got {type(evidence).__name__}")
    return evidence
