"""What every calibrator is: a function from detections and options to a calibration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from binocal.evidence import Detections
from binocal.result import StereoCalibration

MIN_VIEWS = 3  # two views determine four intrinsics and leave nothing to check them with

ProgressCallback = Callable[[str, int, int], None]
"""Called with (what, done, total)."""


@dataclass(frozen=True, slots=True)
class CalibrationOptions:
    """What the user may choose. ``model`` is a camera model's name; ``seed`` feeds every random choice."""

    model: str = "brown4"
    skew: bool = False
    seed: int = 0


class Calibrator(Protocol):
    """A method that calibrates a stereo rig.

    Raises:
        CalibrationError: No trustworthy rig follows from the detections.
    """

    def __call__(self, detections: Detections, options: CalibrationOptions) -> StereoCalibration:
        """The calibration that these detections determine."""
        ...
