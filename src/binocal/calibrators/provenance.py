"""Who made a calibration, from what, and with which choices: said once, whatever the method."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from binocal import __version__
from binocal.calibrators.base import CalibrationRequest
from binocal.evidence import Detections, changed_orders
from binocal.result import StereoCalibration


def with_provenance(
    calibration: StereoCalibration, calibrator: str, request: CalibrationRequest, inputs: Mapping[str, Any]
) -> StereoCalibration:
    """The calibration with its whole provenance.

    Versions and platform, calibrator, seed, the choices asked for (``options``), where the evidence comes from
    (``inputs``), the model and skew that were estimated, and what the method itself stated.
    """
    options = {"model": request.model, "skew": request.skew, "max_views": request.max_views, **request.options}
    if request.prior is not None:
        options["prior"] = {"informs": list(request.prior.names), "held": list(request.prior.held)}
    provenance = {
        "binocal": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "platform": platform.platform(),
        "calibrator": calibrator,
        "seed": request.seed,
        "options": options,
        **inputs,
        "model": calibration.rig.left.model,
        "skew": request.skew,
    }
    return replace(calibration, provenance=provenance | dict(calibration.provenance))


def with_corner_orders(calibration: StereoCalibration, evidence: Detections) -> StereoCalibration:
    """The calibration whose views say in which order their corners of ``evidence`` were taken."""
    if calibration.evidence is None:
        return calibration
    left, right = changed_orders(evidence, calibration.evidence.detections)
    if not left and not right:
        return calibration
    views = (
        replace(view, left_order=left.get(i, ()), right_order=right.get(i, ()))
        for i, view in enumerate(calibration.views)
    )
    return replace(calibration, views=tuple(views))
