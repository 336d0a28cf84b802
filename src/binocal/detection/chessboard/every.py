"""Every chessboard of some SPECs in an image, told apart by their numbers of corners."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.detection.chessboard.rivals import is_board
from binocal.detection.chessboard.sightings import MIN_SHARE_SEEN, Candidate
from binocal.detection.chessboard.verification import BoardImage, verify
from binocal.detection.finding.lattice import Lattice
from binocal.detection.finding.search import SearchLevel, scaled_levels
from binocal.detection.found import FoundBoard
from binocal.shapes import Float, UInt8

MIN_SHARE_WITHIN = 0.5  # of a lattice's corners, within another's outline: both are of one board


@dataclass(frozen=True, slots=True, eq=False)
class _Place:
    """The lattices of all searches that lie where the first of them, the fullest, does."""

    outline_px: Float[ndarray, "h 1 2"]
    candidates: list[Candidate] = field(default_factory=list)

    def of_sizes(self, sizes: Collection[tuple[int, int]]) -> list[Candidate]:
        """Those that may be boards of these sizes, the likeliest first: whole ones before others, then larger ones.

        A size does not count where more searches show a larger board: pieces of one look like boards too.
        """
        counts = Counter(candidate.lattice.size for candidate in self.candidates)
        likely = [
            size
            for size in sizes
            if counts[size] and not any(_is_piece(size, other) and counts[other] > counts[size] for other in counts)
        ]
        return sorted(
            (candidate for candidate in self.candidates if candidate.lattice.size in likely),
            key=lambda candidate: (_share_missing(candidate.lattice) > 0, -candidate.lattice.n_seen),
        )


def _is_piece(size: tuple[int, int], of: tuple[int, int]) -> bool:
    return size != of and size[0] <= of[0] and size[1] <= of[1]


def _share_missing(lattice: Lattice) -> float:
    columns, rows = lattice.size
    return 1 - lattice.n_seen / (columns * rows)


def detect_chessboards(
    grey: ndarray, image: UInt8[ndarray, "h w"], boards: Sequence[Board]
) -> tuple[tuple[FoundBoard, ...], ...]:
    """All chessboards of each SPEC, from left to right; ``image`` is ``grey`` stretched to 8 bits.

    Every search is made, because boards differ in size and distance. The fullest sighting of each board is measured, of equally full
    ones the first; boards of other sizes are passed over.
    """
    shot_of = {
        shot.size: (index, shot) for index, shot in enumerate(BoardImage(grey, image, board) for board in boards)
    }
    found: list[list[FoundBoard]] = [[] for _ in boards]
    for place in _places(image, {size: shot.board.n_points for size, (_, shot) in shot_of.items()}):
        for candidate in place.of_sizes(shot_of):
            index, shot = shot_of[candidate.lattice.size]
            board = verify(shot, candidate)
            if board.is_found:
                found[index].append(board)
                break
    return tuple(
        tuple(sorted(of_spec, key=lambda board: float(np.nanmean(board.points_px[:, 0])))) for of_spec in found
    )


def _places(image: UInt8[ndarray, "h w"], n_points: dict[tuple[int, int], int]) -> list[_Place]:
    """Where the searches show boards; ``n_points`` are those of the SPECs by their sizes, of which a part will do."""
    candidates = [
        Candidate(lattice, replace(level, lattices=[lattice]))
        for level in scaled_levels(image, None)
        for lattice in level.lattices
        if lattice.n_seen >= MIN_SHARE_SEEN * n_points.get(lattice.size, np.inf)
        or is_board(lattice, size_wh=level.size_wh)
    ]
    places: list[_Place] = []
    for candidate in sorted(candidates, key=lambda candidate: -candidate.lattice.n_seen):
        points = _corners_px(candidate.level, candidate)
        for place in places:
            if (
                np.mean([cv2.pointPolygonTest(place.outline_px, point, False) >= 0 for point in points])
                > MIN_SHARE_WITHIN
            ):
                place.candidates.append(candidate)
                break
        else:
            places.append(_Place(cv2.convexHull(np.array(points, np.float32)), [candidate]))
    return places


def _corners_px(level: SearchLevel, candidate: Candidate) -> list[tuple[float, float]]:
    """The corners seen, in the image."""
    points = level.to_image(candidate.lattice.points_px.reshape(-1, 2))
    return [(float(x), float(y)) for x, y in points[np.isfinite(points[:, 0])]]
