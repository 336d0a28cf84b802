"""Chessboards: lattices of X-corners compared with the SPEC, oriented, measured and checked.

:mod:`.sightings` holds what the search has shown, :mod:`.decision` says what to do next and why a board is refused,
:mod:`.verification` measures a candidate at full resolution; :mod:`.detect` is the loop between them, and :mod:`.every` finds
every board of several SPECs.
"""

from binocal.detection.chessboard.detect import detect_chessboard, find_chessboard_size
from binocal.detection.chessboard.every import detect_chessboards

__all__ = ["detect_chessboard", "detect_chessboards", "find_chessboard_size"]
