"""The decision about a chessboard: look further, measure, grow a part, or refuse and say why. Pure, from what was seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from enum import Enum

from binocal.boards import Board
from binocal.detection.chessboard.sightings import Sightings
from binocal.detection.finding.lattice import Lattice
from binocal.detection.finding.search import LEAST_LINKED_TO_STRETCH
from binocal.detection.found import FoundBoard, not_found

SHARE_THAT_WILL_DO = 0.95  # with fewer corners at one scale, the next is searched too; a third seldom shows more


class Decision(Enum):
    """What to do next."""

    SEARCH = "search the next level"
    STRETCH = "begin to search the image about the linked corners, stretched"
    MEASURE = "measure the pending candidates, the fullest first"
    GROW = "grow the fullest part to the board"
    REFUSE = "give up and say why"


def decide(sightings: Sightings) -> Decision:
    """What to do next.

    A candidate is measured when it is full enough, when one more search was made since, or when nothing is left to be
    searched. A part is grown only where nothing was refused and one board at most was seen.
    """
    search = _next_search(sightings)
    if sightings.pending:
        is_full = sightings.most_seen >= SHARE_THAT_WILL_DO * sightings.n_points
        if is_full or sightings.is_second_look or search is None:
            return Decision.MEASURE
    if search is not None:
        return search
    if sightings.part is not None and not _is_settled(sightings):
        return Decision.GROW
    return Decision.REFUSE


def _next_search(sightings: Sightings) -> Decision | None:
    """How the search goes on, None if it is at its end."""
    if sightings.agrees_on_larger:
        return None
    if not sightings.is_stretched and sightings.has_levels:
        return Decision.SEARCH
    if _is_settled(sightings):
        return None  # a part of the image must not overrule what the whole of it showed
    if sightings.is_stretched:
        return Decision.SEARCH if sightings.has_levels else None
    return Decision.STRETCH if len(sightings.linked_px) >= LEAST_LINKED_TO_STRETCH else None


def _is_settled(sightings: Sightings) -> bool:
    return sightings.refused is not None or bool(sightings.several)


def refused_board(sightings: Sightings, board: Board) -> FoundBoard:
    """The board as not found, with the reason that says most: what was measured, else what was seen instead."""
    if sightings.refused is not None:
        return sightings.refused
    if sightings.several:
        return several_boards(board, sightings.several)
    other, most_seen = sightings.other, sightings.most_seen
    if other is None or most_seen >= other.n_seen:
        text = f"only {most_seen} of the {board.n_points} corners were seen" if most_seen else "no chessboard found"
        return not_found(board.n_points, text)
    columns, rows = other.size
    if columns > sightings.size[0] or rows > sightings.size[1]:
        return too_large(board, other.size)
    text = f"only {columns}x{rows} corners of the board's {board.columns}x{board.rows} were seen"
    return not_found(board.n_points, text, size_seen=other.size)


def several_boards(board: Board, boards: Sequence[Lattice]) -> FoundBoard:
    """More than one board in the image, and which is meant cannot be known."""
    sizes = ", ".join(f"{columns}x{rows}" for columns, rows in (each.size for each in boards[:6]))
    more = ", ..." if len(boards) > 6 else ""
    text = f"more than one board in the image ({len(boards)}: {sizes}{more}); show one at a time, or cover the others"
    return replace(not_found(board.n_points, text), is_among_several=True)


def too_large(board: Board, size: tuple[int, int] | None) -> FoundBoard:
    """The printed board is larger than the SPEC says, of ``size`` where it is known."""
    beyond = f"the printed board continues beyond {board.columns}x{board.rows} corners"
    if size is None:
        return not_found(board.n_points, f"{beyond}; count its inner corners again")
    text = f"{beyond}; the SPEC is probably chessboard:{size[0]}x{size[1]}"
    return not_found(board.n_points, text, size_seen=size)
