"""The board as a value: what kind, how many points, where they lie.

Board frame: x along a row of points, y along a column, z = 0 the printed plane, seen by the camera with x to the right,
y down and z away from the camera when the board is upright and faces it. Points are stored row by row.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy import ndarray

from binocal.boards.dictionaries import check_dictionary, check_tag_family
from binocal.boards.marks import Squares, check_marks, format_marks, is_mark, parse_marks
from binocal.boards.puzzle_code import SIDE
from binocal.shapes import Bool, Float, Int

_METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}
_EXAMPLES = (
    "chessboard:9x6:30mm (inner corners), charuco:11x8:30mm:22mm:DICT_5X5_50 (squares), aprilgrid:6x6:88mm:0.3, "
    "circles:10x10:30mm, acircles:4x11:20mm, squares:4x3:30mm:30mm, puzzleboard:11x8:30mm (inner corners)"
)

MOST_POINTS = 40_000  # 200 x 200; a camera of 20 million pixels gives each a square of 22 pixels
LEAST_PITCH_M = 1e-6  # gratings under microscopes are a few micrometres
LARGEST_PITCH_M = (
    3.0  # the largest boards known have squares of half a metre; millimetres given as metres are far beyond
)
LARGEST_TAG_GAP_RATIO = 10.0  # Kalibr's is 0.3
SQUARE_GAP_RATIOS = (
    0.1,
    10.0,
)  # of the gap over the side: narrower ones are one edge to a lens, wider ones hold half of the sheet empty
_KINDS = ("chessboard", "charuco", "aprilgrid", "circles", "acircles", "squares", "puzzleboard")

_NAMES = {
    "chessboard": "a chessboard",
    "charuco": "a ChArUco board",
    "aprilgrid": "an AprilGrid",
    "circles": "a circle grid",
    "acircles": "a staggered circle grid",
    "squares": "a square grid",
    "puzzleboard": "a PuzzleBoard",
}

BoardKind = Literal["chessboard", "charuco", "aprilgrid", "circles", "acircles", "squares", "puzzleboard"]
CircleStyle = Literal["", "large", "hollow", "rings"]
CIRCLE_STYLES = ("large", "hollow", "rings")
MARKS = (
    (0, 0),
    (2, 0),
    (0, 3),
)  # columns and rows from the first: sides of 2, 3 and 1 steps, alike in no turn, mirror image or shear
LARGE = 1.4  # a marked circle's diameter over the others'
HOLE = 0.5  # a ring's inner diameter over its outer one


@dataclass(frozen=True, slots=True)
class Board:
    """A planar calibration board.

    ``columns`` and ``rows`` count what the field counts for the kind: inner corners (chessboard, puzzleboard), squares (charuco),
    tags (aprilgrid), circles (circles), circles per row and rows (acircles, OpenCV's staggered layout), squares (squares, BoofCV's
    square grid). ``pitch_m`` is the square's side, the tag's side (aprilgrid), the spacing of circles, or half the spacing within
    a row (acircles), in metres; 1 and ``is_metric`` False when the specification gave no unit: lengths are then in
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
    """ChArUco: name of the ArUco dictionary. AprilGrid: the tag family; empty: ``tag36h11``."""
    tag_gap_ratio: float = 0.3
    """AprilGrid: gap between tags over tag side (Kalibr's ``tagSpacing``)."""
    first_tag_id: int = 0
    """The lowest id. AprilGrid: that of the bottom-left tag, see :attr:`tag_ids`. ChArUco: that of the first marker."""
    circle_diameter_ratio: float = 0.5
    """Circle grids: diameter over the distance to the nearest neighbour; matters to rendering only."""
    discs: Squares = ()
    """Chessboard: squares (column, row) from the top-left one, (0, 0), with a disc of the other colour in the middle."""
    swapped: Squares = ()
    """Chessboard: squares that have the other colour."""
    circle_style: CircleStyle = ""
    """Circle grids: three circles about the middle larger ("large") or rings ("hollow"), all rings ("rings"), or plain."""
    gap_m: float = 0.0
    """Square grids: from one square's side to the next one's, metres."""
    start: tuple[int, int] = (0, 0)
    """PuzzleBoard: which corner (column, row) of the whole pattern is the board's first."""

    def __post_init__(self) -> None:
        least = {"aprilgrid": 1, "puzzleboard": 4}.get(self.kind, 2)
        size = f"board {_shown(f'{self.columns}x{self.rows}')}"
        if self.columns < least or self.rows < least or self.n_points < 4:
            raise ValueError(f"{size} is too small for {_NAMES[self.kind]}")
        if self.n_points > MOST_POINTS:
            raise ValueError(f"{size} is too large: it has more than {MOST_POINTS} points; give columns x rows")
        if not (np.isfinite(self.pitch_m) and self.pitch_m > 0):
            raise ValueError(f"board pitch must be positive; got {self.pitch_m} m")
        if self.is_metric and self.pitch_m < LEAST_PITCH_M:
            raise ValueError(
                f"a board with a pitch of {self.pitch_m:g} m is not plausible (at least {LEAST_PITCH_M:g} m); check the unit of the length"
            )
        if self.is_metric and self.pitch_m > LARGEST_PITCH_M:
            raise ValueError(
                f"a board with a pitch of {self.pitch_m:g} m is not plausible (at most {LARGEST_PITCH_M:g} m); "
                f"are its lengths in millimetres ({self.pitch_m:g}mm, in a target file {1e-3 * self.pitch_m:g})?"
            )
        if self.kind == "charuco":
            if not 0 < self.marker_m < self.pitch_m:
                raise ValueError(f"ChArUco markers ({self.marker_m} m) must be smaller than squares ({self.pitch_m} m)")
            check_dictionary(
                self.dictionary, self.first_tag_id + self.columns * self.rows // 2 if self.first_tag_id else 0
            )
        if self.first_tag_id < 0 or (self.first_tag_id and self.kind not in ("charuco", "aprilgrid")):
            raise ValueError(f"a first id belongs to boards with markers, and is 0 or more; got {self.first_tag_id}")
        if self.kind == "aprilgrid":
            self._check_tags()
        if self.is_marked:
            if self.kind != "chessboard":
                raise ValueError(f"squares are marked on chessboards; {_NAMES[self.kind]} has no marked ones")
            check_marks(self.columns, self.rows, self.discs, self.swapped)
        if self.circle_style:
            self._check_style()
        self._check_gap()
        self._check_start()

    def _check_start(self) -> None:
        column, row = self.start
        if self.kind != "puzzleboard":
            if self.start != (0, 0):
                raise ValueError(f"a start in the pattern belongs to PuzzleBoards; {_NAMES[self.kind]} has none")
            return
        if min(self.start) < 0 or column + self.columns > SIDE or row + self.rows > SIDE:
            raise ValueError(
                f"a PuzzleBoard of {self.columns}x{self.rows} corners from {column},{row} on reaches beyond the pattern's {SIDE}x{SIDE}"
            )

    def _check_gap(self) -> None:
        if self.kind != "squares":
            if self.gap_m:
                raise ValueError(f"a gap in metres belongs to square grids; {_NAMES[self.kind]} has none")
            return
        low, high = SQUARE_GAP_RATIOS
        if not low * self.pitch_m <= self.gap_m <= high * self.pitch_m:
            raise ValueError(
                f"the gap between squares must be {low:g} to {high:g} times their side; got {self.gap_m:g} m "
                f"between squares of {self.pitch_m:g} m"
            )

    def _check_style(self) -> None:
        if self.circle_style not in CIRCLE_STYLES or self.kind not in ("circles", "acircles"):
            raise ValueError(
                f"circles are {', '.join(CIRCLE_STYLES)} or plain; got {self.circle_style!r} of {_NAMES[self.kind]}"
            )
        if self.circle_style != "rings" and (self.kind != "circles" or self.columns < 3 or self.rows < 4):
            raise ValueError(
                f"three {self.circle_style} circles mark grids of the kind circles with at least 3 columns and 4 rows; "
                f"got {self.kind}:{self.columns}x{self.rows}"
            )

    def _check_tags(self) -> None:
        if not 0 < self.tag_gap_ratio <= LARGEST_TAG_GAP_RATIO:
            raise ValueError(
                f"the gap between tags over their side must be positive and at most {LARGEST_TAG_GAP_RATIO:g}, "
                f"such as 0.3; got {self.tag_gap_ratio:g}"
            )
        check_tag_family(self.dictionary or "tag36h11", self.first_tag_id + self.columns * self.rows)

    @staticmethod
    def from_spec(spec: str) -> Board:
        """Board of a SPEC text such as ``chessboard:11x8:20mm``; see :func:`parse_board`."""
        return parse_board(spec)

    @property
    def n_points(self) -> int:
        """Number of measurable points."""
        if self.kind == "charuco":
            return (self.columns - 1) * (self.rows - 1)
        if self.kind in ("aprilgrid", "squares"):
            return 4 * self.columns * self.rows
        return self.columns * self.rows

    @property
    def allows_partial(self) -> bool:
        """True where what is printed names the points, so that a partly visible board can be used."""
        return self.kind in ("charuco", "aprilgrid", "puzzleboard") or self.is_marked or bool(self.marked_points)

    @property
    def is_marked(self) -> bool:
        """Whether squares of a chessboard are marked."""
        return bool(self.discs or self.swapped)

    @property
    def is_printed(self) -> Bool[ndarray, "n"]:
        """Which points the print has: at the corners of a square of the other colour no edges cross."""
        is_printed = np.ones(self.n_points, bool)
        if self.swapped:
            grid = is_printed.reshape(self.rows, self.columns)
            for column, row in self.swapped:
                grid[row - 1 : row + 1, column - 1 : column + 1] = False
        return is_printed

    @property
    def marked_points(self) -> tuple[int, ...]:
        """The three marked circles of a circle grid: the first, the one two columns on, the one three rows on; else empty."""
        if self.circle_style not in ("large", "hollow"):
            return ()
        column, row = (self.columns - 3) // 2, (self.rows - 4) // 2
        return tuple((row + down) * self.columns + column + right for right, down in MARKS)

    @property
    def marker_dictionary(self) -> str:
        """OpenCV's name of the markers' dictionary; empty for boards without markers."""
        if self.kind == "aprilgrid":
            return f"DICT_APRILTAG_{(self.dictionary or 'tag36h11').removeprefix('tag')}"
        return self.dictionary

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

        chessboard, puzzleboard, circles: row by row from (0, 0). charuco: inner corners row by row, the first at (1, 1) pitch, so
        that the board's outer corner is the origin. acircles: OpenCV's order, x = (2 column + row mod 2) pitch, y = row
        pitch.
        aprilgrid: tag by tag, row by row from the top-left tag, each tag's corners top-left, top-right, bottom-right,
        bottom-left (of the tag as printed). squares: the squares' corners row by row from (0, 0), as BoofCV numbers them: the upper
        corners of the first row of squares, then its lower ones.
        """
        points = np.zeros((self.n_points, 3))
        if self.kind == "aprilgrid":
            step = 1.0 + self.tag_gap_ratio
            row, column = np.divmod(np.arange(self.columns * self.rows), self.columns)
            corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float)
            points[:, :2] = (np.stack([column, row], axis=-1)[:, None] * step + corners).reshape(-1, 2)
        elif self.kind == "squares":
            row, column = np.divmod(np.arange(self.n_points), 2 * self.columns)
            for axis, place in enumerate((column, row)):
                points[:, axis] = place // 2 * (1 + self.gap_m / self.pitch_m) + place % 2
        else:
            inner = 1 if self.kind == "charuco" else 0
            row, column = np.divmod(np.arange(self.n_points), self.columns - inner)
            points[:, 0] = (2 * column + row % 2) if self.kind == "acircles" else column + inner
            points[:, 1] = row + inner
        return points * self.pitch_m


def _shown(text: str) -> str:
    """A user's text as a message quotes it: not longer than a SPEC can be."""
    return text if len(text) <= 80 else f"{text[:60]}… ({len(text)} characters)"


def parse_length(text: str) -> tuple[float, bool]:
    """Metres and True, or the bare number and False where no unit (mm, cm, m, in) is given."""
    match = re.fullmatch(r"\s*([0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*(mm|cm|m|in)?\s*", text)
    if not match or not 0 < float(match[1]) < math.inf:
        raise ValueError(
            f"{_shown(text)!r} is not a length; write a positive number with its unit (mm, cm, m, in), such as 30mm"
        )
    return float(match[1]) * _METRES.get(match[2] or "m", 1.0), match[2] is not None


def parse_board(spec: str) -> Board:
    """Board of a SPEC text; a length without a unit, or none at all, leaves the scale unknown.

    Raises:
        ValueError: The text is not a SPEC; the message shows examples.
    """
    kind, _, rest = spec.strip().partition(":")
    fields = rest.split(":") if rest else []
    size = re.fullmatch(r"([0-9]+)x([0-9]+)", fields[0]) if fields else None
    if kind not in _KINDS or not size:
        raise ValueError(f"board {_shown(spec)!r} is not understood; examples: {_EXAMPLES}")
    if max(len(size[1]), len(size[2])) > len(str(MOST_POINTS)):
        raise ValueError(f"board {_shown(spec)!r} is too large: no board has more than {MOST_POINTS} points")
    columns, rows = int(size[1]), int(size[2])
    marks = [field for field in fields if is_mark(field)] if kind == "chessboard" else []
    fields = [field for field in fields if field not in marks]
    style = fields.pop() if kind in ("circles", "acircles") and fields[-1] in CIRCLE_STYLES else ""
    start = _parse_start(fields.pop(), spec) if kind == "puzzleboard" and "=" in fields[-1] else (0, 0)
    most = {"charuco": 5, "aprilgrid": 5, "squares": 3}.get(kind, 2)
    if len(fields) > most:
        raise ValueError(f"board {_shown(spec)!r} has too many fields; examples: {_EXAMPLES}")
    pitch_m, is_metric = _length_of(spec, fields[1]) if len(fields) > 1 else (1.0, False)
    scale = 1.0 if is_metric else pitch_m
    pitch_m = pitch_m if is_metric else 1.0
    if kind == "charuco":
        if len(fields) < 4:
            raise ValueError(
                f"board {_shown(spec)!r} needs square, marker and dictionary: charuco:11x8:30mm:22mm:DICT_5X5_50"
            )
        marker_m, marker_is_metric = _length_of(spec, fields[2])
        if marker_is_metric != is_metric:
            raise ValueError(f"board {_shown(spec)!r}: give both lengths a unit, or neither")
        if not re.fullmatch(r"DICT_\w+", fields[3]):
            raise ValueError(
                f"board {_shown(spec)!r}: {_shown(fields[3])!r} is not an ArUco dictionary such as DICT_5X5_50"
            )
        first_id = _parse_id(fields[4], spec) if len(fields) > 4 else 0
        check_dictionary(fields[3], first_id + columns * rows // 2)
        return Board(kind, columns, rows, pitch_m, is_metric, marker_m / scale, fields[3], first_tag_id=first_id)
    if kind == "aprilgrid":
        gap = _parse_gap(fields[2]) if len(fields) > 2 else 0.3
        more = fields[3:]
        family = more.pop(0) if more and not more[0].isdigit() else "tag36h11"
        first_id = _parse_id(more.pop(0), spec) if more else 0
        if more:
            raise ValueError(
                f"board {_shown(spec)!r} has too many fields; after the gap come a tag family and a first id"
            )
        return Board(
            kind, columns, rows, pitch_m, is_metric, dictionary=family, tag_gap_ratio=gap, first_tag_id=first_id
        )
    if kind == "squares":
        # without a gap it is as wide as the squares, which is usual
        gap_m, gap_is_metric = _length_of(spec, fields[2]) if len(fields) > 2 else (pitch_m * scale, is_metric)
        if gap_is_metric != is_metric:
            raise ValueError(f"board {_shown(spec)!r}: give both lengths a unit, or neither")
        gap_m /= scale
        return Board(kind, columns, rows, pitch_m, is_metric, gap_m=gap_m)
    try:
        discs, swapped = parse_marks(marks, columns, rows)
    except ValueError as error:
        raise ValueError(f"board {_shown(spec)!r}: {error}") from None
    return Board(kind, columns, rows, pitch_m, is_metric, discs=discs, swapped=swapped, circle_style=style, start=start)  # type: ignore[arg-type]


def _length_of(spec: str, text: str) -> tuple[float, bool]:
    """As :func:`parse_length`; the error names the board."""
    try:
        return parse_length(text)
    except ValueError as error:
        raise ValueError(f"board {_shown(spec)!r}: {error}") from None


def _parse_gap(text: str) -> float:
    """Gap over tag side; what is no number is NaN, which no board may have."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def _parse_id(text: str, spec: str) -> int:
    if not re.fullmatch(r"[0-9]{1,5}", text):
        raise ValueError(f"board {_shown(spec)!r}: {_shown(text)!r} is no first id of its markers, such as 24")
    return int(text)


def _parse_start(text: str, spec: str) -> tuple[int, int]:
    match = re.fullmatch(r"\s*start=([0-9]{1,3}),([0-9]{1,3})\s*", text)
    if not match:
        raise ValueError(
            f"board {_shown(spec)!r}: {_shown(text)!r} is no corner of the pattern, such as start=50,100 (column,row from 0,0)"
        )
    return int(match[1]), int(match[2])


def format_length(length_m: float) -> str:
    """Text of a length that :func:`parse_length` reads back to the same number: millimetres where they are exact."""
    text = f"{round(length_m * 1e3, 9):g}mm"
    return text if parse_length(text)[0] == length_m else f"{length_m!r}m"


def format_board(board: Board) -> str:
    """SPEC text of a board, the inverse of :func:`parse_board`.

    Not carried, because rendering alone needs it: the circles' diameter.
    """
    spec = f"{board.kind}:{board.columns}x{board.rows}"
    needs_length = board.is_metric or board.kind in ("charuco", "aprilgrid", "squares") or board.pitch_m != 1.0
    if needs_length:
        spec += f":{format_length(board.pitch_m) if board.is_metric else repr(board.pitch_m)}"
    if board.kind == "charuco":
        spec += f":{format_length(board.marker_m) if board.is_metric else repr(board.marker_m)}:{board.dictionary}"
    if board.kind == "squares":
        spec += f":{format_length(board.gap_m) if board.is_metric else repr(board.gap_m)}"
    if board.kind == "aprilgrid":
        spec += f":{board.tag_gap_ratio!r}"
        if board.dictionary not in ("", "tag36h11"):
            spec += f":{board.dictionary}"
    spec += format_marks(board.columns, board.rows, board.discs, board.swapped)
    spec += f":{board.first_tag_id}" if board.first_tag_id else ""
    spec += ":start={},{}".format(*board.start) if board.start != (0, 0) else ""
    return spec + f":{board.circle_style}" * bool(board.circle_style)
