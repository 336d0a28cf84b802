"""What a calibration is made from: the corners that each camera saw in each view."""

from binocal.evidence.detections import Detections

__all__ = ["Detections"]
