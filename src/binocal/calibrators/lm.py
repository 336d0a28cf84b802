"""``lm``: the joint solve with classical Levenberg-Marquardt throughout, without the agent."""

from __future__ import annotations

from binocal.calibrators.base import CalibrationRequest
from binocal.calibrators.joint import calibrate_jointly
from binocal.evidence import Detections
from binocal.result import StereoCalibration


def calibrate_lm(evidence: Detections, request: CalibrationRequest) -> StereoCalibration:
    """Joint maximum-likelihood calibration (see :class:`binocal.calibrators.base.Calibrator`)."""
    return calibrate_jointly(evidence, request)
