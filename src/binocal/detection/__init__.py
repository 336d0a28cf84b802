"""Image and board to detections; OpenCV lives here."""

from binocal.detection.detect import detect
from binocal.detection.found import FoundBoard

__all__ = ["FoundBoard", "detect"]
