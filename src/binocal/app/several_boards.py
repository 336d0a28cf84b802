"""Corners of pairs of images that show several boards: every board a view of its own, paired between the cameras by geometry."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.boards import BoardSet
from binocal.cameras import StereoRig
from binocal.detection.found import FoundBoard
from binocal.detection.several_pairs import BoardsInPairs, BoardsSeen
from binocal.evidence import Detections
from binocal.findings import finding, refusal
from binocal.initialization.board_pairing import SeenBoards, pair_boards
from binocal.shapes import Float, Int
from binocal.values import counted

MOST_NAMES = 6  # of views in one note


@dataclass(frozen=True, slots=True, eq=False)
class _BoardView:
    """One board of a pair: its places in the lists of boards that the cameras saw, -1 where one did not."""

    shot: int
    left: int
    right: int
    order: Int[ndarray, "n"]
    """In which the right corners stand as the left ones do."""


def views_of_boards(
    found: BoardsInPairs, boards: BoardSet, rig: StereoRig | None = None
) -> tuple[Detections, tuple[str, ...]]:
    """The boards of all pairs as views ``NAME board K``, from left to right in the left image, and what is to be said of them.

    A board that only one camera sees, or that the pose of the cameras puts where the other image shows no board, is a view of one
    camera. ``rig`` is the rig, where it is known already.

    Raises:
        DetectionError: Boards that look alike cannot be paired.
    """
    points = boards.object_points_m
    (left, left_boards), (right, right_boards) = (
        _collect(images, boards, size)
        for images, size in ((found.left, found.left_size_wh), (found.right, found.right_size_wh))
    )
    pairs = pair_boards(points, boards.places, left, right, rig=rig)
    if pairs.problem:
        figures: dict[str, Any] = {"n_left": len(left.shot), "n_right": len(right.shot), "n_pairs": len(found.pairs)}
        raise refusal(finding("boards-not-paired", board=boards.spec, reason=pairs.problem, **figures))
    plain = np.arange(len(points))
    views = [
        _BoardView(int(left.shot[i]), int(i), int(j), order)
        for i, j, order in zip(pairs.left, pairs.right, pairs.order, strict=True)
    ]
    views += [_BoardView(int(left.shot[i]), int(i), -1, plain) for i in _others(len(left.shot), pairs.left)]
    views += [_BoardView(int(right.shot[j]), -1, int(j), plain) for j in _others(len(right.shot), pairs.right)]
    views.sort(
        key=lambda view: (view.shot, view.left < 0, _middle_px(left.px, view.left), _middle_px(right.px, view.right))
    )
    counts: Counter[int] = Counter()
    names = []
    for view in views:
        counts[view.shot] += 1
        names.append(f"{found.pairs[view.shot].name} board {counts[view.shot]}")
    kinds = [int(left.kind[view.left] if view.left >= 0 else right.kind[view.right]) for view in views]
    arrays = _arrays(boards, views, kinds, left_boards, right_boards)
    detections = Detections(
        points,
        left_size_wh=found.left_size_wh,
        right_size_wh=found.right_size_wh,
        names=tuple(names),
        is_metric=boards.is_metric,
        board_spec=boards.spec,
        shots=tuple(view.shot for view in views),
        **arrays,
    )
    return detections, _notes(views, names, found)


def _collect(
    images: Sequence[BoardsSeen], boards: BoardSet, size_wh: tuple[int, int]
) -> tuple[SeenBoards, list[FoundBoard]]:
    """All boards of one camera's images."""
    rows = [
        (shot, kind, board)
        for shot, image in enumerate(images)
        for kind, of_spec in enumerate(image.found)
        for board in of_spec
    ]
    px = np.full((len(rows), len(boards.object_points_m), 2), np.nan)
    for row, (_, kind, board) in zip(px, rows, strict=True):
        row[boards.places[kind]] = board.points_px
    shots, kinds = (np.array([row[c] for row in rows], dtype=int) for c in range(2))
    return SeenBoards(shots, kinds, px, size_wh), [board for _, _, board in rows]


def _others(n: int, taken: Int[ndarray, "m"]) -> list[int]:
    return np.setdiff1d(np.arange(n), taken).tolist()


def _middle_px(px: Float[ndarray, "k n 2"], index: int) -> float:
    """From left to right."""
    return float(np.nanmean(px[index, :, 0])) if index >= 0 else 0.0


def _arrays(
    boards: BoardSet,
    views: Sequence[_BoardView],
    kinds: Sequence[int],
    left: Sequence[FoundBoard],
    right: Sequence[FoundBoard],
) -> dict[str, Any]:
    """Corners and covariances by view, in the order of the left camera's corners."""
    n = len(boards.object_points_m)
    arrays: dict[str, Any] = {}
    for side, found in (("left", left), ("right", right)):
        px = np.full((len(views), n, 2), np.nan)
        covariance, cross = np.full((2, len(views), n, 2, 2), np.nan)
        for row, (view, kind) in enumerate(zip(views, kinds, strict=True)):
            index = view.left if side == "left" else view.right
            if index < 0:
                continue
            board, place = found[index], boards.places[kind]
            order = view.order[place] - place.start if side == "right" else slice(None)
            px[row, place] = board.points_px[order]
            covariance[row, place] = board.covariance_px2[order]
            shared = board.cross_covariance_px2
            none = np.where(np.isnan(board.covariance_px2), np.nan, 0.0)
            cross[row, place] = (none if shared is None else shared)[order]
        arrays |= {f"{side}_px": px, f"{side}_covariance_px2": covariance, f"{side}_cross_covariance_px2": cross}
    if not any(np.nan_to_num(arrays[f"{side}_cross_covariance_px2"]).any() for side in ("left", "right")):
        arrays |= dict.fromkeys(("left_cross_covariance_px2", "right_cross_covariance_px2"))
    return arrays


def _notes(views: Sequence[_BoardView], names: Sequence[str], found: BoardsInPairs) -> tuple[str, ...]:
    """What was seen, and which views are of one camera only."""
    n_both = sum(view.left >= 0 and view.right >= 0 for view in views)
    notes = [
        *found.notes,
        f"{counted(len(views), 'board')} in {counted(len(found.pairs), 'pair')} of images, {n_both} of them in both",
    ]
    single: dict[str, list[str]] = defaultdict(list)
    for view, name in zip(views, names, strict=True):
        if view.left < 0 or view.right < 0:
            single["right" if view.left < 0 else "left"].append(name)
    for side, of_side in single.items():
        other = "left" if side == "right" else "right"
        shown = ", ".join(of_side[:MOST_NAMES]) + (", ..." if len(of_side) > MOST_NAMES else "")
        notes.append(
            f"{counted(len(of_side), 'view')} ({shown}): used for the {side} camera only; no board of the {other} image is where this one must be"
        )
    return tuple(notes)
