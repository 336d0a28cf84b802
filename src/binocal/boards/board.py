"""The board as a value: what kind, how many points, where they lie.

Board frame: x along a row of points, y along a column, z = 0 the printed plane, seen by the camera with x to the right,
y down and z away from the camera when the board is upright and faces it. Points are stored row by row.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy import ndarray

if TYPE_CHECKING:
    from jaxtyping import Float, Int

BoardKind = Literal["chessboard", "charuco", "aprilgrid", "circles", "acircles"]


@dataclass(frozen=True, slots=True)
class Board:
    """A planar calibration board.

    ``columns`` and ``rows`` count what the field counts for the kind: inner corners (chessboard), squares (charuco),
    tags (aprilgrid), circles (circles), circles per row and rows (acircles, OpenCV's staggered layout).
    ``pitch_m`` is the square's side, the tag's side (aprilgrid), the spacing of circles, or half the spacing within a
    row (acircles), in metres; 1 and ``is_metric`` False when the specification gave no unit: lengths are then in
    pitches.
    """

    kind: BoardKind
    columns: int
    rows: int
    pitch_m: float = 1.0
    is_metric: bool = True
    marker_m: float = 0.0
    """Side of a ChArUco marker, metres."""
    dictionary: str = ""
    """ChArUco: name of the ArUco dictionary. AprilGrid: the tag family, ``tag36h11``."""
    tag_gap_ratio: float = 0.3
    """AprilGrid: gap between tags over tag side (Kalibr's ``tagSpacing``)."""
    first_tag_id: int = 0
    """AprilGrid: the lowest id, that of the bottom-left tag; see :attr:`tag_ids`."""
    circle_diameter_ratio: float = 0.5
    """Circle grids: diameter over the distance to the nearest neighbour; matters to rendering only."""

    def __post_init__(self) -> None:
        least = {"chessboard": 2, "charuco": 2, "aprilgrid": 1, "circles": 2, "acircles": 2}[self.kind]
        if self.columns < least or self.rows < least or self.n_points < 4:
            raise ValueError(f"board {self.columns}x{self.rows} is too small for a {self.kind}")
        if not (np.isfinite(self.pitch_m) and self.pitch_m > 0):
            raise ValueError(f"board pitch must be positive; got {self.pitch_m} m")
        if self.kind == "charuco" and not 0 < self.marker_m < self.pitch_m:
            raise ValueError(f"ChArUco markers ({self.marker_m} m) must be smaller than squares ({self.pitch_m} m)")

    @staticmethod
    def from_spec(spec: str) -> Board:
        """Board of a SPEC text such as ``chessboard:11x8:20mm``; see :func:`binocal.boards.parse_board`."""
        from binocal.boards.spec import parse_board

        return parse_board(spec)

    @property
    def n_points(self) -> int:
        """Number of measurable points."""
        if self.kind == "charuco":
            return (self.columns - 1) * (self.rows - 1)
        if self.kind == "aprilgrid":
            return 4 * self.columns * self.rows
        return self.columns * self.rows

    @property
    def allows_partial(self) -> bool:
        """True where every point carries its identity, so that a partly visible board can be used."""
        return self.kind in ("charuco", "aprilgrid")

    @property
    def tag_ids(self) -> Int[ndarray, "tags"]:
        """AprilGrid: ids of the tags in the order of the points, top row first; empty for other kinds.

        As Kalibr prints them: ids grow to the right and UPWARD from the bottom-left tag (its y axis points up).
        """
        if self.kind != "aprilgrid":
            return np.empty(0, dtype=int)
        return self.first_tag_id + np.arange(self.columns * self.rows).reshape(self.rows, self.columns)[::-1].ravel()

    @property
    def object_points_m(self) -> Float[ndarray, "n 3"]:
        """The points in the board frame, metres (pitches if not metric), in the board's own order.

        chessboard, circles: row by row from (0, 0). charuco: inner corners row by row, the first at (1, 1) pitch, so
        that the board's outer corner is the origin. acircles: OpenCV's order, x = (2 column + row mod 2) pitch, y = row
        pitch.
        aprilgrid: tag by tag, row by row from the top-left tag, each tag's corners top-left, top-right, bottom-right,
        bottom-left (of the tag as printed).
        """
        points = np.zeros((self.n_points, 3))
        if self.kind == "aprilgrid":
            step = 1.0 + self.tag_gap_ratio
            row, column = np.divmod(np.arange(self.columns * self.rows), self.columns)
            corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float)
            points[:, :2] = (np.stack([column, row], axis=-1)[:, None] * step + corners).reshape(-1, 2)
        else:
            inner = 1 if self.kind == "charuco" else 0
            row, column = np.divmod(np.arange(self.n_points), self.columns - inner)
            points[:, 0] = (2 * column + row % 2) if self.kind == "acircles" else column + inner
            points[:, 1] = row + inner
        return points * self.pitch_m
