"""What the SPEC should perhaps have been, tried on a few images when the board was found in none."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
from numpy import ndarray

from binocal.boards import Board
from binocal.boards.board import format_length
from binocal.detection.chessboard import find_chessboard_size
from binocal.detection.detect import detect, stretch, stretch_8_bit
from binocal.detection.found import FoundBoard
from binocal.errors import FormatError
from binocal.images.reading import read_grey_image

MOST_TRIED = 3
_FAMILIES = (
    "DICT_4X4_1000",
    "DICT_5X5_1000",
    "DICT_6X6_1000",
    "DICT_7X7_1000",
    "DICT_ARUCO_ORIGINAL",
    "DICT_APRILTAG_36h11",
)


def hint_from_images(found: Sequence[tuple[Path, FoundBoard]], board: Board) -> tuple[str, str, int]:
    """What was seen instead of the board, a hint, and in how many images: a grid of another size, or a ChArUco board."""
    sizes = Counter(result.size_seen for _, result in found if result.size_seen is not None)
    patterned = [path for path, result in found if result.is_patterned]
    size, count = sizes.most_common(1)[0] if sizes else (None, 0)
    if patterned and len(patterned) >= count:
        return "patterns in their bright squares", _hint_of_markers(patterned, board), len(patterned)
    if size is None:
        return "", "", 0
    example = next(path for path, result in found if result.size_seen == size)
    text = f"found a {size[0]}x{size[1]} board in {example.name}: did you mean {board.kind}:{size[0]}x{size[1]}?"
    return "a grid of another size", text, count


def _hint_of_markers(paths: Sequence[Path], board: Board) -> str:
    """The ChArUco board that a patterned chessboard is, as far as its markers tell."""
    squares = f"{board.columns + 1}x{board.rows + 1}"
    side = format_length(board.pitch_m) if board.is_metric else "SQUARE"
    for path in paths[:MOST_TRIED]:
        with contextlib.suppress(FormatError):
            family, n_markers = _commonest_family(read_grey_image(path), board)
            if family:
                return (
                    f"{path.name} shows {n_markers} markers of the family {family}: the board is a ChArUco board of {squares} squares, "
                    f"give charuco:{squares}:{side}:MARKER:{family}_50 (or _100, _250, _1000)"
                )
    return f"the board looks like a ChArUco board of {squares} squares, give charuco:{squares}:{side}:MARKER:DICTIONARY"


def hint_by_trying(paths: Sequence[Path], board: Board) -> str:
    """A hint from other boards tried on the first readable images; empty where none fits."""
    images: list[tuple[Path, ndarray]] = []
    for path in paths:
        try:
            images.append((path, read_grey_image(path)))
        except FormatError:
            continue
        if len(images) == MOST_TRIED:
            break
    for path, grey in images:
        hint = _try_boards(path, grey, board)
        if hint:
            return hint
    return _try_families(*images[0], board) if images and board.kind in ("charuco", "aprilgrid") else ""


def _try_boards(path: Path, grey: ndarray, board: Board) -> str:
    """Columns and rows exchanged; and for plain boards the other plain kinds."""
    trials = []
    if board.columns != board.rows and board.kind in ("charuco", "aprilgrid", "acircles"):
        trials.append(replace(board, columns=board.rows, rows=board.columns))
    if board.kind in ("circles", "acircles"):
        trials.append(replace(board, kind="acircles" if board.kind == "circles" else "circles"))
    for trial in trials:
        if detect(grey, trial).is_found:
            size = f"{trial.columns}x{trial.rows}"
            return f"found a {size} {trial.kind} in {path.name}: did you mean {trial.kind}:{size}?"
    if board.kind == "charuco":
        from binocal.detection.charuco import find_columns

        columns = find_columns(stretch(grey)[0], board)
        if columns and columns != board.columns:
            return f"the markers in {path.name} fit a board {columns} squares wide: count columns and rows again."
    if board.kind in ("circles", "acircles"):
        image, problem = stretch_8_bit(grey)
        size = None if problem else find_chessboard_size(image)
        if size is not None:
            return (
                f"found a {size[0]}x{size[1]} chessboard in {path.name}: did you mean chessboard:{size[0]}x{size[1]}?"
            )
    return ""


def _try_families(path: Path, grey: ndarray, board: Board) -> str:
    """Markers of other families than the board's."""
    family, n_markers = _commonest_family(grey, board)
    if not family:
        return ""
    return f"{path.name} shows {n_markers} markers of the family {family}: is the board or its dictionary another one?"


def _commonest_family(grey: ndarray, board: Board) -> tuple[str, int]:
    """The family, other than the board's, of which most markers are seen, and how many; none where they may be chance."""
    from binocal.detection.finding.markers import find_markers, to_8_bit

    stretched, problem = stretch(grey)
    if problem:
        return "", 0
    best: tuple[int, str] = (3, "")  # fewer than 4 markers are chance
    for family in _FAMILIES:
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, family))
        own = family.rsplit("_", 1)[0]
        if board.dictionary.startswith(own) or (board.kind == "aprilgrid" and family.endswith("36h11")):
            continue
        ids, _ = find_markers(to_8_bit(stretched), dictionary)
        if len(ids) > best[0]:
            best = len(ids), family
    return best[1].removesuffix("_1000"), best[0]
