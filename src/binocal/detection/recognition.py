"""Which board an image shows, whatever board was asked for: tried where that one was not found.

Circles and chessboards count where detection finds them under the size that was counted; a marker board where its markers lie
as on one (:mod:`binocal.detection.finding.arrangements`). What is only likely is no size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.detection.aprilgrid import find_tags
from binocal.detection.chessboard import find_chessboard_size
from binocal.detection.chessboard.appearance import LEAST_SQUARE_PX
from binocal.detection.circles import find_circle_grid
from binocal.detection.detect import detect, stretch, stretch_8_bit
from binocal.detection.finding.arrangements import find_arrangement
from binocal.detection.finding.grid import grid_spacing
from binocal.detection.finding.markers import find_family, smallest_dictionary, to_8_bit
from binocal.detection.squares import find_square_grid

MIN_MARKERS = 4  # of one family, in no known arrangement: fewer are read into clutter
TAGS = "DICT_APRILTAG_36h11"
_MANY = 1000  # tags: all ways to find them are tried


@dataclass(frozen=True, slots=True)
class SeenBoard:
    """A board that an image shows, as far as the image tells."""

    kind: str
    """As in a SPEC, or "markers" where their arrangement is not known."""
    columns: int = 0
    rows: int = 0
    family: str = ""
    """Of the markers, named by its largest dictionary."""
    n_markers: int = 0
    marker_side: float = 0.0
    """In squares of a ChArUco board, in distances of an AprilGrid's tags."""
    is_whole: bool = True
    """Whether no more rows can follow those seen."""
    square_px: float = 0.0
    """Of a chessboard."""
    gap: float = 0.0
    """Of a square grid, over the squares' side."""

    @property
    def may_hold_markers(self) -> bool:
        """Whether a chessboard's squares are so small that markers in them would not be seen."""
        return self.kind == "chessboard" and self.square_px < LEAST_SQUARE_PX

    @property
    def dictionary(self) -> str:
        """The smallest one of the family with enough markers."""
        return smallest_dictionary(self.family, self.columns * self.rows // 2 + 1)

    def __str__(self) -> str:
        size = f"{self.columns}x{self.rows}"
        if self.kind == "chessboard":
            squares = f"{self.columns + 1}x{self.rows + 1}"
            or_else = (
                f", or a ChArUco board of {squares} squares whose markers are too small to be seen"
                * self.may_hold_markers
            )
            return f"a chessboard of {size} inner corners{or_else}"
        if self.kind in ("circles", "acircles"):
            return f"a {'staggered ' if self.kind == 'acircles' else ''}grid of {size} circles"
        if self.kind == "squares":
            return f"a grid of {size} separate squares"
        markers = f"{self.n_markers} markers of the family {self.family.removesuffix('_1000')}"
        if self.kind == "markers":
            return markers
        board = "a ChArUco board" if self.kind == "charuco" else "an AprilGrid"
        unit = "squares" if self.kind == "charuco" else "tags"
        return f"{board} of {size if self.is_whole else f'{self.columns} columns'} {unit} ({markers})"


def recognize(grey: ndarray) -> SeenBoard | None:
    """The board that an image (h, w), uint8 or uint16, shows; None where none is recognised."""
    stretched, problem = stretch(grey)
    if problem:
        return None
    seen = _recognize_chessboard(grey) or _recognize_markers(to_8_bit(stretched))
    if seen is not None:
        return seen  # before circles: squares pass for them, and those at the corners of tags make a grid
    stretched8 = stretch_8_bit(grey)[0]
    squares = find_square_grid(stretched8)
    if squares is not None and detect(grey, squares).is_found:
        return SeenBoard("squares", squares.columns, squares.rows, gap=squares.gap_m)
    circles = find_circle_grid(stretched8)
    is_found = circles is not None and detect(grey, circles).is_found
    return SeenBoard(circles.kind, circles.columns, circles.rows) if circles is not None and is_found else None


def _recognize_chessboard(grey: ndarray) -> SeenBoard | None:
    """A chessboard; of a ChArUco board detection says that its squares are patterned, unless they are small."""
    size = find_chessboard_size(stretch_8_bit(grey)[0])
    if size is None:
        return None
    found = detect(grey, Board("chessboard", *size, is_metric=False))
    if not found.is_found:
        return None
    square_px = float(np.nanmedian(grid_spacing(found.points_px.reshape(size[1], size[0], 2))))
    return SeenBoard("chessboard", *size, square_px=square_px)


def _recognize_markers(grey8: ndarray) -> SeenBoard | None:
    family, ids, quads = find_family(grey8)
    if family in ("", TAGS):  # a tag's corners may touch squares, and its border be wide
        of_tags = find_tags(grey8, _MANY)[:2]
        if len(of_tags[0]) > len(ids):
            family, (ids, quads) = TAGS, of_tags
    if len(ids) < MIN_MARKERS:
        return None
    found = find_arrangement(ids, quads, (grey8.shape[1], grey8.shape[0]))
    if found is None or (found.kind == "aprilgrid" and family != TAGS):
        return SeenBoard("markers", family=family, n_markers=len(ids))
    return SeenBoard(found.kind, found.columns, found.rows, family, len(ids), round(found.side, 2), found.is_whole)
