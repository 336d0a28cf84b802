"""What tells some of a chessboard's squares from the others: discs of the other colour, or the other colour itself.

Squares are (column, row), counted from the top-left one, (0, 0), as OpenCV's ``gen_pattern.py`` counts them. Marks lie inside of the
board's outer ring of squares: white ones of the ring could not be told from the margin.
"""

from __future__ import annotations

import re

Squares = tuple[tuple[int, int], ...]

DISC_RADIUS = 0.17  # squares, of OpenCV's pattern
MOST_MARKS = 64
_FORM = "marked, discs=7,4,7,5,8,5 or swapped=1,1 (column,row of each square from the top left, 0,0)"


def usual_discs(columns: int, rows: int) -> Squares:
    """Three discs in the middle of a board of so many inner corners: a corner, the square above it and the one on its right.

    Of 14x9 corners they are the ones of OpenCV's documentation.

    Raises:
        ValueError: The board is too small for them.
    """
    column, row = (columns + 1) // 2, (rows + 1) // 2
    if columns < 4 or rows < 3:
        raise ValueError(f"a marked chessboard has at least 4x3 inner corners; got {columns}x{rows}")
    return (column, row - 1), (column, row), (column + 1, row)


def check_marks(columns: int, rows: int, discs: Squares, swapped: Squares) -> None:
    """That marks lie in different squares, within the outer ring of a board of so many inner corners.

    Raises:
        ValueError: They do not.
    """
    squares = [*discs, *swapped]
    if len(squares) > MOST_MARKS:
        raise ValueError(f"a chessboard has at most {MOST_MARKS} marked squares; got {len(squares)}")
    for square in squares:
        if not (0 < square[0] < columns and 0 < square[1] < rows):
            raise ValueError(
                f"square {square[0]},{square[1]} cannot be marked: column 1 to {columns - 1} and row 1 to {rows - 1} can, "
                "for the outer squares cannot be told from the margin"
            )
        if squares.count(square) > 1:
            raise ValueError(f"square {square[0]},{square[1]} is marked twice")


def is_mark(field: str) -> bool:
    """Whether a field of a SPEC is meant for marks, and no length."""
    return re.match(r"\s*[a-z]", field) is not None


def parse_marks(fields: list[str], columns: int, rows: int) -> tuple[Squares, Squares]:
    """The squares with discs and those of the other colour, of a SPEC's fields.

    Raises:
        ValueError: A field is none of them.
    """
    marks: dict[str, Squares] = {}
    for field in fields:
        name, _, places = field.strip().partition("=")
        if name == "marked" and not places:
            name, squares = "discs", usual_discs(columns, rows)
        elif name in ("discs", "swapped") and re.fullmatch(r"[0-9]{1,3}(,[0-9]{1,3})*", places):
            numbers = [int(number) for number in places.split(",")]
            if len(numbers) % 2:
                raise ValueError(f"{field.strip()[:60]!r} needs a column and a row for each square; write {_FORM}")
            squares = tuple(zip(numbers[::2], numbers[1::2], strict=True))
        else:
            raise ValueError(
                f"{field.strip()[:60]!r} is neither a length such as 30mm nor a mark of a chessboard: {_FORM}"
            )
        if name in marks:
            raise ValueError(f"{name} are given twice")
        marks[name] = squares
    return marks.get("discs", ()), marks.get("swapped", ())


def format_marks(columns: int, rows: int, discs: Squares, swapped: Squares) -> str:
    """The fields that :func:`parse_marks` reads back, each with its colon before it."""
    if columns >= 4 and rows >= 3 and discs == usual_discs(columns, rows):
        text = ":marked"
    else:
        text = f":discs={_places(discs)}" if discs else ""
    return text + (f":swapped={_places(swapped)}" if swapped else "")


def _places(squares: Squares) -> str:
    return ",".join(f"{column},{row}" for column, row in squares)
