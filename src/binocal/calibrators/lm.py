"""``lm``: the joint road with classical Levenberg-Marquardt throughout, without the agent."""

from __future__ import annotations

from binocal.calibrators.base import CalibrationOptions
from binocal.calibrators.joint import calibrate_jointly
from binocal.evidence import Detections
from binocal.result import StereoCalibration


def calibrate_lm(detections: Detections, options: CalibrationOptions) -> StereoCalibration:
    """Joint maximum-likelihood calibration (see :class:`binocal.calibrators.base.Calibrator`)."""
    return calibrate_jointly(detections, options, name="lm")
