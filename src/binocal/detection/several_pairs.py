"""Pairs of images that show several boards: every board in every image, before anybody says which are one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from binocal.boards import BoardSet
from binocal.datasets.folder import ImagePair
from binocal.detection.found import FoundBoard, not_found
from binocal.detection.pairs import ReadImage, common_size, digest_of, look_at_all, page_notes
from binocal.detection.several import detect_boards_in_layouts
from binocal.detection.unseen_boards import LookedAt, require_board
from binocal.errors import DataError, FormatError
from binocal.images.preprocessing import Preparation
from binocal.result import RejectedView

SIDES = ("left", "right")


@dataclass(frozen=True, slots=True, eq=False)
class BoardsSeen(ReadImage):
    """One image, and for each SPEC the boards that it shows."""

    found: tuple[tuple[FoundBoard, ...], ...] = ()
    layouts: tuple[Any, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class BoardsInPairs:
    """The images of the pairs that can be used, side by side, the other pairs with reasons, and sentences for the user."""

    pairs: tuple[ImagePair, ...]
    left: tuple[BoardsSeen, ...]
    right: tuple[BoardsSeen, ...]
    left_size_wh: tuple[int, int]
    right_size_wh: tuple[int, int]
    rejected: tuple[RejectedView, ...]
    notes: tuple[str, ...]
    input_sha256: Mapping[str, str]


def detect_boards_in_pairs(
    pairs: Sequence[ImagePair],
    boards: BoardSet,
    *,
    preparation: Preparation | None = None,
    progress: Callable[[int, int], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
    n_threads: int | None = None,
) -> BoardsInPairs:
    """Every board of the set in every image; see :func:`binocal.detection.pairs.detect_pairs`.

    Raises:
        DetectionError: No image shows any of the boards, or none of one camera does.
        DataError: There is no pair, no readable image, or a camera's images have no common size.
        CancelledError: ``should_stop`` returned True.
    """
    if not pairs:
        raise DataError("there is no pair of images; left and right images are paired by the number in their names.")
    look = partial(_look, boards=boards, preparation=preparation or Preparation())
    paths = [path for pair in pairs for path in (pair.left_path, pair.right_path)]
    seen = look_at_all(paths, look, progress, should_stop, n_threads)
    seen = _agree_on_layouts(seen, look, should_stop, n_threads)
    sides = {"left": seen[0::2], "right": seen[1::2]}
    if all(image.problem for image in seen):
        raise DataError(f"none of the {len(seen)} images can be used; {seen[0].path.name} {seen[0].problem}")
    require_board([_looked_at(SIDES[i % 2], image, boards) for i, image in enumerate(seen)], boards.boards[0], 0)
    sizes = {side: common_size(side, images) for side, images in sides.items()}
    kept, rejected = [], []
    for i, pair in enumerate(pairs):
        reason = _why_unusable([(side, sides[side][i], sizes[side]) for side in SIDES])
        if reason:
            rejected.append(RejectedView(pair.name, reason))
        else:
            kept.append(i)
    notes = list(page_notes(sides))
    for k, board in enumerate(boards.boards):
        if not any(image.found and image.found[k] for image in seen):
            notes.append(f"no image shows the board {board.kind}:{board.columns}x{board.rows}")
    return BoardsInPairs(
        tuple(pairs[i] for i in kept),
        tuple(sides["left"][i] for i in kept),
        tuple(sides["right"][i] for i in kept),
        sizes["left"],
        sizes["right"],
        tuple(rejected),
        tuple(notes),
        {side: digest_of(images) for side, images in sides.items()},
    )


def _look(
    path: Path, *, boards: BoardSet, preparation: Preparation, layouts: Sequence[Any] | None = None
) -> BoardsSeen:
    try:
        image = preparation.read(path)
    except FormatError as error:
        return BoardsSeen(path, problem=str(error.problem))
    found, proved = detect_boards_in_layouts(image.grey, boards, layouts or [None] * len(boards.boards))
    size_wh = image.grey.shape[1], image.grey.shape[0]
    return BoardsSeen(path, size_wh, sha256=image.sha256, n_pages=image.n_pages, found=found, layouts=proved)


def _agree_on_layouts(
    seen: list[BoardsSeen],
    look: Callable[..., BoardsSeen],
    should_stop: Callable[[], bool] | None,
    n_threads: int | None,
) -> list[BoardsSeen]:
    """Marker boards: the layout that most images prove holds for all; images that were read otherwise are read again."""
    votes = [
        Counter(layout for layout in layouts if layout)
        for layouts in zip(*(i.layouts for i in seen if i.layouts), strict=True)
    ]
    if not any(votes):
        return seen
    agreed = tuple(vote.most_common(1)[0][0] if vote else None for vote in votes)
    again = [
        i
        for i, image in enumerate(seen)
        if any(
            got and layout and proved != layout
            for got, layout, proved in zip(image.found, agreed, image.layouts, strict=True)
        )
        if image.found
    ]
    renewed = look_at_all([seen[i].path for i in again], partial(look, layouts=agreed), None, should_stop, n_threads)
    changed = dict(zip(again, renewed, strict=True))
    return [changed.get(i, image) for i, image in enumerate(seen)]


def _looked_at(side: str, image: BoardsSeen, boards: BoardSet) -> LookedAt:
    """What a camera's image showed of any board, as the rules about unseen boards ask for it."""
    if image.problem:
        return LookedAt(side, image.path, None, image.problem)
    found = next((board for of_spec in image.found for board in of_spec), None)
    sizes = ", ".join(f"{board.columns}x{board.rows}" for board in boards.boards)
    return LookedAt(side, image.path, found or not_found(boards.boards[0].n_points, f"no board of {sizes} found"))


def _why_unusable(images: Sequence[tuple[str, BoardsSeen, tuple[int, int]]]) -> str:
    """Why a pair cannot be used; empty where it can."""
    reasons = []
    for side, image, size_wh in images:
        if image.problem:
            reasons.append(f"{image.path.name} {image.problem}")
        elif image.size_wh != size_wh:
            width, height = image.size_wh or (0, 0)
            reasons.append(
                f"{image.path.name} is {width}x{height}, the other {side} images are {size_wh[0]}x{size_wh[1]}"
            )
    if not reasons and not any(of_spec for _, image, _ in images for of_spec in image.found):
        return "left and right: no board found"
    return "; ".join(reasons)
