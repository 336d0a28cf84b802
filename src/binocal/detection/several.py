"""One image and several boards in, every one of them out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from numpy import ndarray

from binocal.boards import Board, BoardSet
from binocal.detection.chessboard import detect_chessboards
from binocal.detection.detect import MIN_SIDE_PX, detect_in_layout, soften_drawing, stretch_8_bit
from binocal.detection.found import FoundBoard
from binocal.images.reading import to_grey


def detect_boards(image: ndarray, boards: BoardSet | Sequence[Board]) -> tuple[tuple[FoundBoard, ...], ...]:
    """For each of the boards all of its kind that an image shows, from left to right; the image as for :func:`binocal.detect`.

    Chessboards of one SPEC may be many, and are told from those of another by their numbers of corners. Boards with markers are told
    apart by their ids, so that there is one of a SPEC at most; of circle and square grids, too;
    where an image shows two, none is found.

    Raises:
        ValueError: The array is not an image, or two boards cannot be told apart.
    """
    known = boards if isinstance(boards, BoardSet) else BoardSet(tuple(boards))
    return detect_boards_in_layouts(image, known, [None] * len(known.boards))[0]


def detect_boards_in_layouts(
    image: ndarray, board_set: BoardSet, layouts: Sequence[Any]
) -> tuple[tuple[tuple[FoundBoard, ...], ...], tuple[Any, ...]]:
    """As :func:`detect_boards`, with each marker board's layout given (None: from the image), and those that the image proves.

    Raises:
        ValueError: The array is not an image.
    """
    boards = board_set.boards
    grey = soften_drawing(to_grey(image))
    found: list[tuple[FoundBoard, ...]] = [()] * len(boards)
    proved: list[Any] = [None] * len(boards)
    if min(grey.shape) < MIN_SIDE_PX:
        return tuple(found), tuple(proved)
    stretched, problem = stretch_8_bit(grey)
    plain = [i for i, board in enumerate(boards) if board.kind == "chessboard" and not board.is_marked]
    if plain and not problem:
        of_plain = detect_chessboards(grey, stretched, [boards[i] for i in plain])
        for i, of_board in zip(plain, of_plain, strict=True):
            found[i] = of_board
    for i in set(range(len(boards))) - set(plain):
        one, proved[i] = detect_in_layout(image, boards[i], layouts[i])
        if one.is_found:
            found[i] = (one,)
    return tuple(found), tuple(proved)
