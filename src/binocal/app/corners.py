"""From two sets of image files to corners, with what became of every file."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from binocal.boards import Board, BoardSet
from binocal.cameras import StereoRig
from binocal.datasets.folder import ImagePair
from binocal.errors import BinocalError, CalibrationError, DetectionError
from binocal.evidence import Detections
from binocal.images.preprocessing import Preparation
from binocal.progress import ProgressCallback, ShouldStop, stage_of
from binocal.result import RejectedView


@dataclass(frozen=True, slots=True, eq=False)
class FoundCorners:
    """What two sets of images gave."""

    detections: Detections
    rejected: tuple[RejectedView, ...]
    ignored: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]
    input_sha256: Mapping[str, str]


def find_corners(
    left: str,
    right: str,
    board: Board | BoardSet,
    preparation: Preparation | None,
    progress: ProgressCallback | None,
    should_stop: ShouldStop | None,
    least_pairs: int = 0,
    rig: StereoRig | None = None,
) -> FoundCorners:
    """The corners of all pairs that two globs or folders name, at least ``least_pairs`` of which both cameras must see.

    Of several boards each is a view of its own (:mod:`binocal.app.several_boards`); so it is too where most images show more than one
    chessboard of a single SPEC. ``rig`` tells which of them are one, where it is known.

    Raises:
        DataError: The images cannot be used; the error carries what was ignored before.
        CancelledError: ``should_stop`` returned True.
    """
    from binocal.app.parts_of_boards import expected_corners
    from binocal.datasets.folder import list_pairs
    from binocal.detection import detect_pairs

    pairing = list_pairs(left, right)
    ignored = tuple((str(path), reason) for path, reason in pairing.ignored)
    options = {
        "progress": stage_of(progress, "finding corners"),
        "should_stop": should_stop,
        "preparation": preparation,
    }
    boards = board if isinstance(board, BoardSet) else BoardSet((board,))
    first, *others = boards.boards
    with explained(ignored, ()):
        if others:
            return _find_several(pairing.pairs, boards, options, ignored, rig)
        try:
            expect = partial(expected_corners, rig=rig) if first.is_marked else None
            found = detect_pairs(pairing.pairs, first, least_pairs=least_pairs, expect=expect, **options)
        except DetectionError as error:
            if not any(each.code == "several-boards" for each in error.findings):
                raise
            return _find_several(pairing.pairs, boards, options, ignored, rig)
    return FoundCorners(
        found.detections, tuple(found.rejected), ignored, (*pairing.notes, *found.notes), found.input_sha256
    )


def _find_several(
    pairs: Sequence[ImagePair],
    boards: BoardSet,
    options: Mapping[str, Any],
    ignored: tuple[tuple[str, str], ...],
    rig: StereoRig | None,
) -> FoundCorners:
    from binocal.app.several_boards import views_of_boards
    from binocal.detection.several_pairs import detect_boards_in_pairs

    found = detect_boards_in_pairs(pairs, boards, **options)
    detections, notes = views_of_boards(found, boards, rig)
    return FoundCorners(detections, found.rejected, ignored, notes, found.input_sha256)


def detect_corners(
    left: str,
    right: str,
    board: Board,
    *,
    progress: ProgressCallback | None = None,
    should_stop: ShouldStop | None = None,
) -> Detections:
    """The corners of all pairs in which the board was found.

    Raises:
        DataError: The images cannot be used.
    """
    return find_corners(left, right, board, None, progress, should_stop).detections


@contextlib.contextmanager
def explained(
    ignored: Sequence[tuple[str, str]], rejected: Sequence[RejectedView], notes: Sequence[str] = ()
) -> Iterator[None]:
    """An error that leaves the block also carries what was ignored, rejected and noted before it."""
    try:
        yield
    except BinocalError as error:
        if isinstance(error, CalibrationError):
            error.rejected = {view.name: view.reason for view in rejected} | error.rejected
        for path, reason in ignored:
            error.add_note(f"ignored {path}: {reason}")
        for note in notes:
            error.add_note(f"note: {note}")
        raise
