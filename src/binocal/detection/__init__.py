"""Image and board to detections; OpenCV lives here."""

from binocal.detection.detect import detect
from binocal.detection.found import FoundBoard
from binocal.detection.pairs import PairDetections, detect_pairs
from binocal.detection.several import detect_boards
from binocal.images.preprocessing import strengthen_edges

__all__ = ["FoundBoard", "PairDetections", "detect", "detect_boards", "detect_pairs", "strengthen_edges"]
