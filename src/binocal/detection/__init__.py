"""Image and board to detections; OpenCV lives here."""

from binocal.detection.detect import detect
from binocal.detection.found import FoundBoard
from binocal.detection.pairs import PairDetections, detect_pairs
from binocal.detection.preprocessing import Preparation, strengthen_edges

__all__ = ["FoundBoard", "PairDetections", "Preparation", "detect", "detect_pairs", "strengthen_edges"]
