"""What a calibration is made from: the corners that each camera saw in each view."""

from binocal.evidence.detections import Detections
from binocal.evidence.orders import changed_orders

__all__ = ["Detections", "changed_orders"]
