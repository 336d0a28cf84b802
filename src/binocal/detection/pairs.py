"""Pairs of images to detections: in threads, and with a reason for every image that is not used."""

from __future__ import annotations

import hashlib
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy import ndarray

from binocal import threads
from binocal.boards import Board
from binocal.datasets.folder import ImagePair, Pairing
from binocal.detection.detect import detect_in_layout
from binocal.detection.found import FoundBoard
from binocal.detection.unseen_boards import LookedAt, require_board
from binocal.errors import CancelledError, DataError, DetectionError, FormatError
from binocal.evidence import Detections
from binocal.images.opencv_settings import single_threaded_opencv
from binocal.images.preprocessing import Preparation
from binocal.result import RejectedView
from binocal.shapes import Float

MIN_SHARE_OF_ONE_SIZE = 0.75  # of a camera's images; with fewer it is not clear which size the camera has
MIN_PAIRS = 3  # of a calibration: with fewer, images that are not read of files with several are what is missing
MOST_NAMES = 6  # of views in one note
_SIDES = ("left", "right")
Image = TypeVar("Image")
Expect = Callable[[Detections, Sequence[tuple[int, str]]], Sequence["Float[ndarray, 'n 2'] | None"]]
"""From the views so far, and views with the camera whose part has no names, to where its corners must be: None or NaN if unknown."""


@dataclass(frozen=True, slots=True, eq=False)
class PairDetections:
    """The views in which at least one camera saw the board, the others with reasons, and sentences for the user."""

    detections: Detections
    rejected: tuple[RejectedView, ...]
    notes: tuple[str, ...]
    input_sha256: Mapping[str, str] = field(default_factory=dict)
    """Of ``left`` and ``right``: SHA-256 over the name and the SHA-256 of each readable image, in order."""


@dataclass(frozen=True, slots=True, eq=False)
class ReadImage:
    """One image: its size and what identifies it, or why it could not be read."""

    path: Path
    size_wh: tuple[int, int] | None = None
    problem: str = ""
    sha256: str = ""
    n_pages: int = 1


@dataclass(frozen=True, slots=True, eq=False)
class _Seen(ReadImage):
    """One image, and what was found in it."""

    found: FoundBoard | None = None
    layout: Any = None


def detect_pairs(
    pairs: Pairing | Sequence[ImagePair],
    board: Board,
    *,
    preparation: Preparation | None = None,
    progress: Callable[[int, int], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
    n_threads: int | None = None,
    least_pairs: int = 0,
    expect: Expect | None = None,
) -> PairDetections:
    """The board in every image of every pair; in both images of ``least_pairs`` pairs, if so many are given.

    ``expect`` says where the board's corners must be in an image that shows a part of it which nothing in the image names, from
    the views so far and the other camera's corners: the part is named by that.

    A view that one camera saw is kept, with NaN for the other camera. An unreadable image, or one of another size
    than the rest of its camera's, rejects its view. ``progress`` is called with images done and images in all,
    ``should_stop`` is asked after each image; OpenCV's own threads are switched off meanwhile, because the images
    already fill ``n_threads`` threads (:func:`binocal.threads.n_threads` of them by default).

    Raises:
        DetectionError: The board was found in no image, in none of one camera, in too few pairs, or most images show
        another board; with a hint if there is one.
        DataError: There is no pair, no readable image, or a camera's images have no common size.
        CancelledError: ``should_stop`` returned True.
    """
    preparation = preparation or Preparation()
    pairs = tuple(pairs.pairs if isinstance(pairs, Pairing) else pairs)
    if not pairs:
        raise DataError("there is no pair of images; left and right images are paired by the number in their names.")
    paths = [path for pair in pairs for path in (pair.left_path, pair.right_path)]
    look = partial(_detect_one, board=board, preparation=preparation)
    seen = look_at_all(paths, look, progress, should_stop, n_threads)
    seen = _agree_on_layout(seen, look, should_stop, n_threads)
    sides = {"left": seen[0::2], "right": seen[1::2]}
    pages = page_notes(sides)
    if pages and len(pairs) < MIN_PAIRS:
        raise DataError(f"{len(pairs)} pair{'s' * (len(pairs) != 1)} of images: {pages[0]}")
    if not any(image.found for image in seen):
        raise DataError(f"none of the {len(seen)} images can be used; {seen[0].path.name} {seen[0].problem}")
    looked = [LookedAt(_SIDES[i % 2], image.path, image.found, image.problem) for i, image in enumerate(seen)]
    require_board(looked, board, least_pairs)
    sizes = {side: common_size(side, images) for side, images in sides.items()}
    kept, rejected, notes = _sort_views(pairs, sides, sizes)
    if not kept:
        raise DetectionError(_one_line("no view is usable", rejected), {view.name: view.reason for view in rejected})
    detections = _detections_of(pairs, board, sides, kept, sizes)
    if expect is not None and (unnamed := _unnamed_parts(sides, kept)):
        sides = _with_parts_named(sides, kept, unnamed, expect(detections, unnamed), look)
        kept, rejected, notes = _sort_views(pairs, sides, sizes)
        detections = _detections_of(pairs, board, sides, kept, sizes)
    notes = [*pages, *notes]
    if sizes["left"] != sizes["right"]:
        notes.append("left images are {}x{}, right ones {}x{}".format(*sizes["left"], *sizes["right"]))
    return PairDetections(
        detections,
        tuple(rejected),
        tuple(notes),
        {side: digest_of(images) for side, images in sides.items()},
    )


def _detections_of(
    pairs: Sequence[ImagePair],
    board: Board,
    sides: Mapping[str, Sequence[_Seen]],
    kept: Sequence[int],
    sizes: Mapping[str, tuple[int, int]],
) -> Detections:
    """The corners of the views that are kept."""
    points = {side: np.stack([_points(sides[side][i], board) for i in kept]) for side in _SIDES}
    covariances = {side: np.stack([_covariance(sides[side][i], board) for i in kept]) for side in _SIDES}
    cross = {side: np.stack([_cross_covariance(sides[side][i], board) for i in kept]) for side in _SIDES}
    shares_pixels = any(bool(np.nan_to_num(of_side).any()) for of_side in cross.values())
    return Detections(
        board.object_points_m,
        points["left"],
        points["right"],
        sizes["left"],
        sizes["right"],
        tuple(pairs[i].name for i in kept),
        board.is_metric,
        covariances["left"],
        covariances["right"],
        left_cross_covariance_px2=cross["left"] if shares_pixels else None,
        right_cross_covariance_px2=cross["right"] if shares_pixels else None,
    )


def _unnamed_parts(sides: Mapping[str, Sequence[_Seen]], kept: Sequence[int]) -> list[tuple[int, str]]:
    """Views, in the order in which they are kept, and the camera that shows a part of the board without what names it."""
    return [
        (view, side)
        for view, i in enumerate(kept)
        for side in _SIDES
        if (found := sides[side][i].found) is not None and found.is_unnamed
    ]


def _with_parts_named(
    sides: Mapping[str, list[_Seen]],
    kept: Sequence[int],
    unnamed: Sequence[tuple[int, str]],
    expected_px: Sequence[Float[ndarray, "n 2"] | None],
    look: Callable[..., _Seen],
) -> dict[str, list[_Seen]]:
    """What was seen, with the parts that lie where they are expected."""
    named = {side: list(images) for side, images in sides.items()}
    for (view, side), px in zip(unnamed, expected_px, strict=True):
        image = sides[side][kept[view]]
        if px is None:
            continue
        again = look(image.path, expected_px=px)
        if again.found is not None and again.found.is_found:
            other = _SIDES[side == "left"]
            note = "; ".join(text for text in (again.found.note, f"named by the {other} camera's corners") if text)
            named[side][kept[view]] = replace(again, found=replace(again.found, note=note))
    return named


def look_at_all(
    paths: Sequence[Path],
    look: Callable[[Path], Image],
    progress: Callable[[int, int], None] | None,
    should_stop: Callable[[], bool] | None,
    n_threads: int | None,
) -> list[Image]:
    """Every image, in the order given; see :func:`detect_pairs`.

    Raises:
        CancelledError: ``should_stop`` returned True.
    """
    results: list[Image | None] = [None] * len(paths)
    pool = ThreadPoolExecutor(n_threads or threads.n_threads())
    with single_threaded_opencv():
        try:
            waiting = {pool.submit(look, path): i for i, path in enumerate(paths)}
            for done, future in enumerate(as_completed(waiting), start=1):
                results[waiting[future]] = future.result()
                if progress is not None:
                    progress(done, len(paths))
                if should_stop is not None and should_stop():
                    raise CancelledError(f"stopped after {done} of {len(paths)} images")
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
    return [result for result in results if result is not None]


def _detect_one(
    path: Path,
    *,
    board: Board,
    preparation: Preparation,
    layout: Any = None,
    expected_px: Float[ndarray, "n 2"] | None = None,
) -> _Seen:
    try:
        image = preparation.read(path)
    except FormatError as error:
        return _Seen(path, problem=str(error.problem))
    found, proved = detect_in_layout(image.grey, board, layout, expected_px)
    size_wh = image.grey.shape[1], image.grey.shape[0]
    return _Seen(path, size_wh, sha256=image.sha256, n_pages=image.n_pages, found=found, layout=proved)


def _agree_on_layout(
    seen: list[_Seen],
    look: Callable[..., _Seen],
    should_stop: Callable[[], bool] | None,
    n_threads: int | None,
) -> list[_Seen]:
    """Marker boards: the layout that most images prove holds for all.

    Images that were read otherwise are read again.
    """
    votes = Counter(image.layout for image in seen if image.layout)
    if not votes:
        return seen
    layout = votes.most_common(1)[0][0]
    again = [i for i, image in enumerate(seen) if image.found is not None and image.layout != layout]
    renewed = look_at_all([seen[i].path for i in again], partial(look, layout=layout), None, should_stop, n_threads)
    seen = list(seen)
    for i, image in zip(again, renewed, strict=True):
        seen[i] = image
    return seen


def common_size(side: str, images: Sequence[ReadImage]) -> tuple[int, int]:
    """The size of a camera's images.

    Raises:
        DataError: They have no common size, or none can be read.
    """
    sizes = Counter(image.size_wh for image in images if image.size_wh is not None)
    if not sizes:
        raise DataError(
            f"none of the {len(images)} {side} images can be used; {images[0].path.name} {images[0].problem}"
        )
    ranked = sizes.most_common()
    size, count = ranked[0]
    if size is None or count < MIN_SHARE_OF_ONE_SIZE * sum(sizes.values()):
        text = " and ".join(f"{number} of {width}x{height}" for (width, height), number in ranked[:2])
        raise DataError(
            f"{side} images differ in size ({text} pixels); a camera has one size: give images of one mode only."
        )
    return size


def _sort_views(
    pairs: Sequence[ImagePair], sides: dict[str, list[_Seen]], sizes: dict[str, tuple[int, int]]
) -> tuple[list[int], list[RejectedView], list[str]]:
    """Indices of the views to keep, the rejected ones, and notes on the kept ones."""
    kept, rejected = [], []
    remarks: dict[str, list[str]] = defaultdict(list)
    for i, pair in enumerate(pairs):
        unusable, unseen = [], {}
        for side in _SIDES:
            image = sides[side][i]
            if image.problem or image.found is None:
                unusable.append(f"{image.path.name} {image.problem}")
            elif image.size_wh != sizes[side]:
                width, height = image.size_wh or (0, 0)
                expected = "{}x{}".format(*sizes[side])
                unusable.append(f"{image.path.name} is {width}x{height}, the other {side} images are {expected}")
            elif image.found.reason:
                unseen[side] = image.found.reason
        if unusable:
            rejected.append(RejectedView(pair.name, "; ".join(unusable)))
        elif len(unseen) == len(_SIDES):
            same = len(set(unseen.values())) == 1
            texts = (
                [f"left and right: {unseen['left']}"] if same else [f"{side}: {why}" for side, why in unseen.items()]
            )
            rejected.append(RejectedView(pair.name, "; ".join(texts)))
        else:
            kept.append(i)
            for side, why in unseen.items():
                remarks[f"used for the {_SIDES[side == 'left']} camera only; {side}: {why}"].append(pair.name)
            for side in _SIDES:
                if (found := sides[side][i].found) is not None and found.note:
                    remarks[f"{side}: {found.note}"].append(pair.name)
    return kept, rejected, [f"{_list_views(names)}: {remark}" for remark, names in remarks.items()]


def _list_views(names: Sequence[str]) -> str:
    """The views, the first of them by name."""
    if len(names) == 1:
        return f"view {names[0]}"
    more = ", ..." if len(names) > MOST_NAMES else ""
    return f"{len(names)} views ({', '.join(names[:MOST_NAMES])}{more})"


def page_notes(sides: Mapping[str, Sequence[ReadImage]]) -> list[str]:
    """What is not read of files that hold several images."""
    notes = []
    for side, images in sides.items():
        several = [image for image in images if image.n_pages > 1]
        if several:
            first = several[0]
            notes.append(
                f"{len(several)} of {len(images)} {side} files hold several images, {first.path.name} {first.n_pages} of them: "
                "only the first of each is used; export them as files of their own."
            )
    return notes


def _one_line(text: str, rejected: Sequence[RejectedView]) -> str:
    first = rejected[0]
    return f"{text}: {first.name}: {first.reason}" + (f" (and {len(rejected) - 1} more)" if len(rejected) > 1 else "")


def digest_of(images: Sequence[ReadImage]) -> str:
    """SHA-256 over names and contents' SHA-256, in order."""
    digest = hashlib.sha256()
    for image in images:
        digest.update(f"{image.path.name}\0{image.sha256}\n".encode(errors="surrogateescape"))
    return digest.hexdigest()


def _points(image: _Seen, board: Board) -> ndarray:
    return image.found.points_px if image.found is not None else np.full((board.n_points, 2), np.nan)


def _cross_covariance(image: _Seen, board: Board) -> ndarray:
    """Zero where a kind of board has none."""
    if image.found is None:
        return np.full((board.n_points, 2, 2), np.nan)
    cross = image.found.cross_covariance_px2
    return np.where(np.isnan(image.found.covariance_px2), np.nan, 0.0) if cross is None else cross


def _covariance(image: _Seen, board: Board) -> ndarray:
    return image.found.covariance_px2 if image.found is not None else np.full((board.n_points, 2, 2), np.nan)
