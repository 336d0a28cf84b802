"""Every way to calibrate a rig, behind one signature."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.calibrators.base import (
    MIN_VIEWS,
    BoardShapeChoice,
    CalibrationRequest,
    Calibrator,
    ExposureChoice,
    ProgressCallback,
    ShouldStop,
)
from binocal.calibrators.registry import (
    CALIBRATORS,
    evidence_of,
    known_calibrators,
    load_calibrator,
    model_for,
    refuse_unsuited,
)
from binocal.errors import CalibrationError, DataError
from binocal.evidence import Detections
from binocal.evidence.rectangles import RectanglePairs
from binocal.evidence.several_boards import boards_from_shot_to_shot
from binocal.evidence.zoom_settings import ZoomSettings
from binocal.initialization.solid_targets import MIN_POINTS, SOLID_SHARE, is_solid
from binocal.result import StereoCalibration
from binocal.shapes import Float
from binocal.solvers.prior import RigPrior

__all__ = [
    "CALIBRATORS",
    "MIN_VIEWS",
    "CalibrationRequest",
    "Calibrator",
    "calibrate",
    "calibrate_as_requested",
    "known_calibrators",
    "load_calibrator",
]


def calibrate(
    evidence: Detections | RectanglePairs | ZoomSettings,
    *,
    calibrator: str = "drl",
    model: str = "auto",
    skew: bool = False,
    seed: int = 0,
    max_views: int | None = None,
    options: Mapping[str, Any] | None = None,
    progress: ProgressCallback | None = None,
    should_stop: ShouldStop | None = None,
    prior: StereoCalibration | RigPrior | None = None,
    board_shape: BoardShapeChoice = "auto",
    exposure: ExposureChoice = "auto",
) -> StereoCalibration:
    """Both cameras' intrinsics, the transform between them, and their covariance, from corners.

    Evidence of another kind than a board's corners is for the calibrator that works from it (``rectangles``, ``zoom``).
    ``model`` is ``brown4``, ``brown5``, ``brown8``, ``fisheye4``, or ``auto``: the plainest, unless rows and lengths of
    held-out views speak decisively for another. Skew is 0 unless ``skew``. With ``max_views`` only the views that
    determine depth best are used, at most so many; ``provenance["view_choice"]`` says what that costs. ``options`` are the
    calibrator's own. ``progress(what, done, total)`` is called and ``should_stop()`` asked as the work goes on.
    ``prior`` is an earlier calibration of the rig: its covariance counts as information beside the corners. A
    :class:`binocal.RigPrior` of it says what it informs of, and which parts are held exactly (known intrinsics:
    ``RigPrior.from_calibration(earlier, held=("left", "right"))``). ``board_shape`` says whether the board is as drawn
    (``flat``), bowed, stretched and sheared (``warp``), of any shape (``free``), or what the views say (``auto``); ``exposure``
    whether both cameras saw each view at one moment (``together``) or not (``apart``). Same input and seed, same result.

    Raises:
        ValueError: An option is unknown.
        DataError: The corners cannot be used, or the prior is about other cameras.
        CalibrationError: No trustworthy rig follows from them; the text names the cause.
        CancelledError: ``should_stop`` returned True.
    """
    known = None
    if prior is not None:
        from binocal.solvers.prior import RigPrior

        if not isinstance(prior, RigPrior | StereoCalibration):
            raise TypeError(f"a prior is a StereoCalibration or a RigPrior of one; got {type(prior).__name__}")
        known = prior if isinstance(prior, RigPrior) else RigPrior.from_calibration(prior)
    request = CalibrationRequest(
        model, skew, seed, max_views, options or {}, progress, should_stop, known, board_shape, exposure
    )
    return calibrate_as_requested(evidence, request, calibrator=calibrator)


def calibrate_as_requested(
    evidence: Detections | RectanglePairs | ZoomSettings,
    request: CalibrationRequest,
    *,
    calibrator: str = "drl",
    inputs: Mapping[str, Any] | None = None,
) -> StereoCalibration:
    """:func:`calibrate` with all choices in one value.

    ``inputs`` says where the evidence comes from (hashes of images, versions); it goes to the provenance. Raises as
    :func:`calibrate`.
    """
    method = load_calibrator(calibrator)
    if evidence_of(calibrator) == "board" and calibrator in CALIBRATORS and not isinstance(evidence, Detections):
        raise TypeError(f"calibrator {calibrator!r} works from Detections of a board; got {type(evidence).__name__}")
    refuse_unsuited(calibrator, request)
    request = replace(request, model=model_for(calibrator, request.model))
    _check_model(request.model)
    if isinstance(evidence, Detections) and evidence.shots is not None:
        request = _of_several_boards(request, evidence)
    if isinstance(evidence, Detections):
        _check_points(evidence.object_points_m)
    if isinstance(evidence, Detections) and (evidence.object_sigma_m is not None or is_solid(evidence.object_points_m)):
        request = _of_points_in_space(request)
    from binocal.calibrators.provenance import with_corner_orders, with_provenance

    view_choice: dict[str, Any] = {}
    used = evidence
    if request.max_views is not None and isinstance(evidence, Detections) and evidence.n_views > request.max_views:
        from binocal.calibrators.view_selection import select_views

        selection = select_views(evidence, request, calibrator=calibrator)
        used = evidence.select(selection.views)
        view_choice = {"view_choice": selection.document(request.max_views)}
    try:
        calibration = calibrate_named_or_best_model(used, method, request)
    except CalibrationError:
        if isinstance(used, Detections):
            from binocal.calibrators.set_checking import refuse_copies

            refuse_copies(used)
        raise
    if isinstance(used, Detections):
        calibration = with_corner_orders(calibration, used)
    return with_provenance(calibration, calibrator, request, dict(inputs or {}) | view_choice)


def calibrate_named_or_best_model(
    evidence: Detections | RectanglePairs | ZoomSettings, method: Calibrator, request: CalibrationRequest
) -> StereoCalibration:
    """What the method makes of all of the evidence, with the model asked for, the prior's, or the best one."""
    if request.model == "auto" and request.prior is not None:
        request = replace(request, model=request.prior.rig.left.model)
    if request.model == "auto" and isinstance(evidence, Detections):
        from binocal.calibrators.model_selection import calibrate_with_best_model

        return calibrate_with_best_model(evidence, method, request)
    request.report("joint solve", 0, 1)
    calibration = method(evidence, request)
    request.report("joint solve", 1, 1)
    return calibration


def _of_several_boards(request: CalibrationRequest, views: Detections) -> CalibrationRequest:
    """The request with what holds where views are of different boards: one pair of images is of one moment.

    Boards that cannot be told from each other from pair to pair, and those of a single pair, are as drawn.

    Raises:
        DataError: A shape was asked for, which different boards do not have in common.
    """
    if request.board_shape not in ("auto", "flat"):
        raise DataError(
            f"the views are of several boards, which have no shape in common: the board's shape is auto or flat, not {request.board_shape}."
        )
    exposure = "together" if request.exposure == "auto" and len(set(views.shots or ())) == 1 else request.exposure
    has_shapes = request.board_shape == "auto" and bool((boards_from_shot_to_shot(views) >= 0).any())
    return replace(request, board_shape="auto" if has_shapes else "flat", exposure=exposure)


def _check_points(points: Float[ndarray, "n 3"]) -> None:
    """Raises DataError: points that are no flat board's, and too few or too flat to be another target's."""
    away, extent = float(np.abs(points[:, 2]).max(initial=0.0)), float(np.ptp(points, axis=0).max(initial=0.0))
    if away > SOLID_SHARE * extent and not is_solid(points):
        raise DataError(
            f"object points lie up to {away:.3g} from the plane z = 0, and all near one other plane or fewer than {MIN_POINTS}: give a flat "
            f"target's points with z = 0, and of any other target {MIN_POINTS} points or more that do not lie in one plane."
        )


def _of_points_in_space(request: CalibrationRequest) -> CalibrationRequest:
    """The request for points that are no flat board's, or whose own standard deviations are stated: these move them, nothing else.

    Raises:
        DataError: A flat board's shape was asked for.
    """
    if request.board_shape not in ("auto", "flat"):
        raise DataError(
            f"the target is no flat board, or its points have standard deviations (object_sigma_m): its shape is auto or flat, not "
            f"{request.board_shape}."
        )
    return replace(request, board_shape="flat")


def _check_model(name: str) -> None:
    """Raises ValueError: there is no such camera model, or none that can be calibrated with."""
    if name != "auto":
        from binocal.cameras import CAMERA_MODELS, camera_model

        if not camera_model(name).is_compiled:
            raise ValueError(
                f"camera model {name!r} cannot be solved with: the compiled solver knows {', '.join(CAMERA_MODELS)}; "
                "rigs of other models are read, written, rectified, simulated and evaluated"
            )
