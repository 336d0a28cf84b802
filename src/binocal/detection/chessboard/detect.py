"""The search for a chessboard: levels are searched and candidates measured as the decision asks for them."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.detection.chessboard.decision import Decision, decide, refused_board
from binocal.detection.chessboard.rivals import boards_among
from binocal.detection.chessboard.sightings import Candidate, Sightings
from binocal.detection.chessboard.verification import BoardImage, is_patterned, verify
from binocal.detection.finding.growth import grow
from binocal.detection.finding.lattice import Lattice
from binocal.detection.finding.search import scaled_levels, stretched_levels
from binocal.detection.found import FoundBoard, not_found
from binocal.shapes import UInt8


def detect_chessboard(grey: ndarray, image: UInt8[ndarray, "h w"], board: Board) -> FoundBoard:
    """The inner corners of a chessboard; ``image`` is ``grey`` stretched to 8 bits.

    Orientation: rows and columns turn as in the board's frame. Where the colours of the outer squares show the board's
    two (or four) orientations apart, the square outside corner (0, 0) is dark; where not, the row that runs most to the
    lower right of the image is chosen, which is the same in both cameras of a rig unless the board is turned by 135
    degrees.
    """
    shot = BoardImage(grey, image, board)
    sightings = Sightings(shot.size, board.n_points)
    levels = scaled_levels(image, shot.size)
    while True:
        match decide(sightings):
            case Decision.SEARCH:
                level = next(levels, None)
                sightings = sightings.without_more_levels() if level is None else sightings.with_level(level)
            case Decision.STRETCH:
                levels = stretched_levels(image, shot.size, sightings.linked_px)
                sightings = replace(sightings, is_stretched=True, has_levels=True)
            case Decision.MEASURE:
                for candidate in sightings.by_corners_seen():
                    found = verify(shot, candidate)
                    if found.is_found:
                        return found
                    sightings = sightings.with_refused(found)
                sightings = replace(sightings, pending=())
            case Decision.GROW:
                whole = None if sightings.part is None else _grow(shot, sightings.part)
                if whole is not None and (found := verify(shot, whole)).is_found:
                    return found
                sightings = replace(sightings, part=None)
            case Decision.REFUSE:
                return _refused(shot, sightings)


def _refused(shot: BoardImage, sightings: Sightings) -> FoundBoard:
    """The board as not found; what looks like a chessboard of another size may be a piece of a ChArUco board."""
    found = refused_board(sightings, shot.board)
    other, level = sightings.other, sightings.other_level
    if found.size_seen is None or other is None or level is None or not is_patterned(shot, Candidate(other, level)):
        return found
    text = "the bright squares of what was seen hold patterns; is this a ChArUco board (charuco:... in the SPEC)?"
    return not_found(shot.board.n_points, text)


def find_chessboard_size(image: UInt8[ndarray, "h w"]) -> tuple[int, int] | None:
    """Columns and rows (the larger first) of the largest complete chessboard in an image."""
    largest = [
        lattice
        for level in scaled_levels(image, None)
        for lattice in boards_among(level.lattices, size_wh=level.size_wh)[:1]
    ]
    return max(largest, key=lambda lattice: lattice.n_seen).size if largest else None


def _grow(shot: BoardImage, part: Candidate) -> Candidate | None:
    """The board that a lattice of fewer lines is a part of, None if there is none."""
    columns, rows = part.lattice.size
    if columns > shot.size[0] or rows > shot.size[1] or part.lattice.size == shot.size:
        return None
    smooth = cv2.GaussianBlur(shot.image.astype(np.float32), (0, 0), 0.8)
    grown = grow(shot.grey, smooth, part.level.to_image(part.lattice.points_px), shot.size)
    if grown is None:
        return None
    points, n_before = grown
    is_dark_first = part.lattice.is_dark_first ^ bool(n_before % 2)
    return Candidate(Lattice(part.level.from_image(points), is_dark_first, part.lattice.contrast_dn), part.level)
