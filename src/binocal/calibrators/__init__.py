"""Every way to calibrate a rig, behind one signature."""

from __future__ import annotations

from binocal.calibrators.base import MIN_VIEWS, CalibrationOptions, Calibrator, ProgressCallback
from binocal.calibrators.registry import CALIBRATORS, load_calibrator
from binocal.evidence import Detections
from binocal.result import StereoCalibration

__all__ = ["CALIBRATORS", "MIN_VIEWS", "CalibrationOptions", "Calibrator", "calibrate", "load_calibrator"]


def calibrate(
    detections: Detections,
    *,
    calibrator: str = "drl",
    model: str = "brown4",
    skew: bool = False,
    seed: int = 0,
    progress: ProgressCallback | None = None,
) -> StereoCalibration:
    """Both cameras' intrinsics, the transform between them, and their covariance, from corners.

    ``model`` is ``brown4``, ``brown5``, ``brown8``, ``fisheye4``, or ``auto``: the one with the least error on held-out
    views (the simplest that is not clearly worse). Skew is 0 unless ``skew``. Same input and seed, same result.

    Raises:
        ValueError: An option is unknown.
        DataError: The corners cannot be used.
        CalibrationError: No trustworthy rig follows from them; the text names the culprit.
    """
    method = load_calibrator(calibrator)
    if model == "auto":
        from binocal.calibrators.model_selection import calibrate_with_best_model

        return calibrate_with_best_model(detections, method, CalibrationOptions("auto", skew, seed), progress)
    from binocal.cameras import camera_model

    camera_model(model)
    return method(detections, CalibrationOptions(model, skew, seed))
