"""What the SPEC should perhaps have been: some of the images in which the board was not found are looked at again."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from binocal.boards import Board
from binocal.boards.board import format_board, format_length
from binocal.detection.detect import detect
from binocal.detection.finding.markers import get_dictionary
from binocal.detection.found import FoundBoard
from binocal.detection.recognition import SeenBoard, recognize
from binocal.errors import FormatError
from binocal.images.reading import read_grey_image

MOST_TRIED = 4
MIN_AGREEING = 2  # images that show the same other board, unless there is only one
MAX_OFF = 0.06  # relative, between a marker's side as measured and as given: measured to 0.01 to 0.04
CELL_PX = (
    2.5  # of a marker's code, from which on all markers of a sharp image are read one by one; a whole board's from 1 on
)
MAX_GAP_OFF = 0.15  # relative, of a square grid: its squares are only found to a pixel
_SAME_TURNED = ("chessboard", "circles", "squares")  # columns and rows exchanged are the same board


@dataclass(frozen=True, slots=True)
class Hint:
    """What was seen in ``n_other`` of ``n_tried`` images in place of the board: the finding's code, remedy and figures."""

    n_other: int
    n_tried: int
    remedy: str | None
    figures: Mapping[str, Any]
    code: str = "board-is-another"


def count_signs(found: Sequence[tuple[Path, FoundBoard]]) -> int:
    """How many images show a grid of one other size, or a chessboard whose squares are patterned."""
    sizes = Counter(result.size_seen for _, result in found if result.size_seen is not None)
    return max(sum(result.is_patterned for _, result in found), *sizes.values(), 0)


def hint_from_images(found: Sequence[tuple[Path, FoundBoard]], board: Board) -> Hint | None:
    """Another board that some of the images show; None where they do not agree on one, or it is the board itself."""
    if (mirrored := _hint_of_mirror(found, board)) is not None:
        return mirrored
    seen: list[tuple[Path, SeenBoard | None]] = []
    for path in _paths_to_try(found):
        try:
            seen.append((path, recognize(read_grey_image(path))))
        except FormatError:
            continue
        names = Counter(_identity(other) for _, other in seen if other is not None and other.is_whole)
        if len(seen) == MOST_TRIED or max(names.values(), default=0) >= MIN_AGREEING:
            break
    names = Counter(_identity(other) for _, other in seen if other is not None)
    if not names:
        return _hint_of_patterns(found, board)
    identity, n_agreeing = names.most_common(1)[0]
    path, other = _fullest([(path, each) for path, each in seen if each is not None and _identity(each) == identity])
    if n_agreeing < min(MIN_AGREEING, len(seen)) or _is_same(other, board):
        return None
    if (small := _markers_too_small(other, board)) is not None:
        return Hint(n_agreeing, len(seen), None, small, "markers-too-small")
    n_other, n_tried = n_agreeing, len(seen)
    same_size = sum(result.size_seen == (other.columns, other.rows) for _, result in found)
    if other.kind == board.kind and same_size > n_agreeing:
        n_other, n_tried = same_size, len(found)
    return Hint(n_other, n_tried, _advice(other, board), {"what": f"{other} ({path.name})"})


def _hint_of_mirror(found: Sequence[tuple[Path, FoundBoard]], board: Board) -> Hint | None:
    """The board itself in images that are mirrored, as some webcams give them: its markers cannot be read there."""
    if board.kind not in ("charuco", "aprilgrid"):
        return None  # these are their own mirror images
    paths = _paths_to_try(found)[:MIN_AGREEING]
    for path in paths:
        try:
            grey = read_grey_image(path)
        except FormatError:
            return None
        if detect(np.ascontiguousarray(grey[:, ::-1]), board).reason:
            return None
    if not paths:
        return None
    remedy = "give the images as the cameras took them (some webcams and their programs mirror them)"
    return Hint(len(paths), len(paths), remedy, {"what": f"the board mirrored ({paths[0].name})"})


def _paths_to_try(found: Sequence[tuple[Path, FoundBoard]]) -> list[Path]:
    """Images without the board: first those that show something else, then some from all over the set."""
    without = [(path, result) for path, result in found if result.reason]
    telling = [path for path, result in without if result.size_seen is not None or result.is_patterned]
    others = [path for path, result in without if result.size_seen is None and not result.is_patterned]
    return [*_spread(telling), *_spread(others)]


def _spread(paths: Sequence[Path]) -> list[Path]:
    """Some of the paths, the first of them first, from all over the sequence."""
    index = np.unique(np.linspace(0, len(paths) - 1, min(2 * MOST_TRIED, len(paths))).round().astype(int))
    return [paths[i] for i in index]


def _identity(seen: SeenBoard) -> tuple[str, int, int, str]:
    """What images of one board agree on; not all of them need show all rows of markers."""
    return seen.kind, seen.columns, 0 if seen.family else seen.rows, seen.family


def _fullest(seen: Sequence[tuple[Path, SeenBoard]]) -> tuple[Path, SeenBoard]:
    """The image that shows most rows, and its board; whole if one with as many rows is."""
    path, most = max(seen, key=lambda each: (each[1].rows, each[1].is_whole, each[1].n_markers))
    return path, most


def _is_same(seen: SeenBoard, board: Board) -> bool:
    """Whether it may be the board that was given after all."""
    if seen.kind != board.kind:
        return False
    sizes = [(board.columns, board.rows)] + [(board.rows, board.columns)] * (board.kind in _SAME_TURNED)
    if board.is_marked:  # which may be seen in part
        return any(seen.columns <= columns and seen.rows <= rows for columns, rows in sizes)
    if not seen.family:
        is_gap = seen.kind != "squares" or _is_same_gap(seen, board)
        return (seen.columns, seen.rows) in sizes and is_gap
    is_size = seen.columns == board.columns and (
        seen.rows == board.rows or (not seen.is_whole and seen.rows <= board.rows)
    )
    is_family = board.kind == "aprilgrid" or board.dictionary.startswith(seen.family.removesuffix("1000"))
    return is_size and is_family and _is_same_side(seen, board)


def _is_same_side(seen: SeenBoard, board: Board) -> bool:
    given = board.marker_m / board.pitch_m if board.kind == "charuco" else 1 / (1 + board.tag_gap_ratio)
    return abs(seen.marker_side / given - 1) < MAX_OFF


def _is_same_gap(seen: SeenBoard, board: Board) -> bool:
    return board.kind == "squares" and abs(seen.gap * board.pitch_m / board.gap_m - 1) < MAX_GAP_OFF


def _advice(seen: SeenBoard, board: Board) -> str:
    """What to give; only what was seen is in it."""
    size = f"{seen.columns}x{seen.rows}"
    if seen.kind == "squares":
        if _is_same_gap(seen, board):
            return f"did you mean {format_board(replace(board, columns=seen.columns, rows=seen.rows))}?"
        return f"did you mean squares:{size}:SIDE:GAP (the gap is about {seen.gap:.2f} times the squares' side)?"
    if not seen.family:
        if seen.may_hold_markers and board.kind != "chessboard":
            return f"give chessboard:{size} if no square holds a marker; if some do, move nearer"
        return f"did you mean {seen.kind}:{size}?"
    if seen.kind == "markers":
        return "is the board or its dictionary another one? Known are ChArUco boards and AprilGrids"
    if not seen.is_whole:
        size = f"{seen.columns}xROWS"
    has_lengths = board.kind == seen.kind
    if seen.kind == "charuco":
        has_square = board.is_metric and board.kind in ("chessboard", "charuco")
        side = format_length(board.pitch_m) if has_square else "SQUARE"
        is_known = has_square and has_lengths and _is_same_side(seen, board)
        marker = format_length(board.marker_m) if is_known else "MARKER"
        spec = f"charuco:{size}:{side}:{marker}:{seen.dictionary}"
        what = "" if is_known else f" (the markers' side is about {seen.marker_side:.2f} of the squares')"
    else:
        is_known = has_lengths and _is_same_side(seen, board)
        side = format_length(board.pitch_m) if has_lengths and board.is_metric else "SIDE"
        gap = f"{board.tag_gap_ratio:g}" if is_known else "GAP"
        spec = f"aprilgrid:{size}:{side}:{gap}"
        what = (
            ""
            if is_known
            else f" (the tags' side, and the gap between them over it, about {1 / seen.marker_side - 1:.2f})"
        )
    return f"did you mean {spec}{what}?" if seen.is_whole else f"count the rows and give {spec}{what}"


def _hint_of_patterns(found: Sequence[tuple[Path, FoundBoard]], board: Board) -> Hint | None:
    """A chessboard of the size that was given, but patterned, whose markers cannot be read."""
    n = sum(result.is_patterned for _, result in found)
    if not n:
        return None
    squares = f"{board.columns + 1}x{board.rows + 1}"
    side = format_length(board.pitch_m) if board.is_metric else "SQUARE"
    advice = (
        f"the board looks like a ChArUco board of {squares} squares, give charuco:{squares}:{side}:MARKER:DICTIONARY"
    )
    return Hint(n, len(found), advice, {"what": "patterns in their bright squares"})


def _markers_too_small(seen: SeenBoard, board: Board) -> dict[str, Any] | None:
    """Sizes in pixels where a chessboard is the given ChArUco board with markers too small to be read; None where it is not."""
    if not (seen.may_hold_markers and board.kind == "charuco"):
        return None
    if {seen.columns, seen.rows} != {board.columns - 1, board.rows - 1}:
        return None
    marker_px = seen.square_px * board.marker_m / board.pitch_m
    cell_px = marker_px / (get_dictionary(board.dictionary).markerSize + 2)
    return {"square_px": seen.square_px, "marker_px": marker_px, "cell_px": cell_px} if cell_px < CELL_PX else None
