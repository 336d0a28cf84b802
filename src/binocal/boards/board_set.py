"""Several boards that one image may show, as one list of points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy import ndarray

from binocal.boards.board import Board, format_board, parse_board
from binocal.shapes import Float

SEPARATOR = " + "  # between SPECs; no SPEC has a blank


@dataclass(frozen=True, slots=True)
class BoardSet:
    """Boards of different SPECs, each of which an image may show once or more.

    Their points stand in one list, board after board, drawn in one plane one below the other with a pitch between them. Every view is
    of one board and has the others' points unseen, so that where the drawing puts the boards matters to nothing but that view's pose.
    """

    boards: tuple[Board, ...]

    def __post_init__(self) -> None:
        if not self.boards:
            raise ValueError("give at least one board")
        if len({board.is_metric for board in self.boards}) > 1:
            raise ValueError(
                "some boards have a length with its unit and some have none; give each its length, or none"
            )
        for i, board in enumerate(self.boards):
            for other in self.boards[:i]:
                if _look_alike(board, other):
                    raise ValueError(
                        f"the boards {format_board(other)} and {format_board(board)} cannot be told apart in an image: {_remedy(board, other)}"
                    )

    @staticmethod
    def from_specs(specs: Sequence[str] | str) -> BoardSet:
        """The boards of some SPEC texts, or of one text as :attr:`spec` writes it.

        Raises:
            ValueError: A text is no SPEC, or two boards cannot be told apart.
        """
        texts = specs.split(SEPARATOR) if isinstance(specs, str) else specs
        return BoardSet(tuple(parse_board(text) for text in texts))

    @property
    def spec(self) -> str:
        """The SPECs in one text."""
        return SEPARATOR.join(format_board(board) for board in self.boards)

    @property
    def is_metric(self) -> bool:
        """Whether the points are in metres."""
        return self.boards[0].is_metric

    @property
    def places(self) -> tuple[slice, ...]:
        """Where each board's points stand in the list."""
        ends = np.cumsum([0, *(board.n_points for board in self.boards)]).tolist()
        return tuple(slice(first, end) for first, end in pairwise(ends))

    @property
    def object_points_m(self) -> Float[ndarray, "n 3"]:
        """The points of all boards, metres (pitches if not metric); of one board, its own."""
        if len(self.boards) == 1:
            return self.boards[0].object_points_m
        parts, y = [], 0.0
        for board in self.boards:
            points = board.object_points_m
            low, high = points.min(axis=0), points.max(axis=0)
            parts.append(points - [(low[0] + high[0]) / 2, low[1] - y, 0.0])
            y += float(high[1] - low[1]) + 2 * board.pitch_m
        points = np.concatenate(parts)
        return points - [0.0, (points[:, 1].min() + points[:, 1].max()) / 2, 0.0]


def _look_alike(a: Board, b: Board) -> bool:
    if a.kind != b.kind:
        return False
    if a.marker_dictionary:
        ids, other = (range(x.first_tag_id, x.first_tag_id + _n_markers(x)) for x in (a, b))
        return a.marker_dictionary == b.marker_dictionary and ids.start < other.stop and other.start < ids.stop
    if a.kind == "puzzleboard":  # parts of one pattern, which have corners in common or have not
        return all(abs(2 * (p - q) + m - n) < m + n for p, q, m, n in zip(a.start, b.start, *_sizes(a, b), strict=True))
    if a.is_marked or b.is_marked:
        return True  # a part of a marked chessboard may have as many corners as the other
    return sorted((a.columns, a.rows)) == sorted((b.columns, b.rows))


def _sizes(*boards: Board) -> tuple[tuple[int, int], ...]:
    return tuple((board.columns, board.rows) for board in boards)


def _n_markers(board: Board) -> int:
    return board.columns * board.rows if board.kind == "aprilgrid" else board.columns * board.rows // 2


def _remedy(board: Board, other: Board) -> str:
    if board.marker_dictionary:
        return "their markers' ids overlap; print one with another first id"
    if board.kind == "puzzleboard":
        return "they have corners of the pattern in common; print one with another start"
    if board.is_marked or other.is_marked:
        return "a part of a marked chessboard looks like another chessboard; show no other one beside it"
    return "boards of as many columns and rows need one --board; print one of another size"
