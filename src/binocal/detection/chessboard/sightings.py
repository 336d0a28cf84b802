"""What the searches of an image have shown of a chessboard so far: pure data, a new value after every search."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.detection.chessboard.rivals import MIN_LINES, boards_among
from binocal.detection.finding.lattice import Lattice
from binocal.detection.finding.search import SearchLevel
from binocal.detection.found import FoundBoard
from binocal.shapes import Float

# Of a board whose outline is complete; below it the view is too doubtful to keep. The border of a shadow across a board of
# eight columns costs a fifth of the corners.
MIN_SHARE_SEEN = 0.75


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A lattice that may be the board or a part of it, and the search (its scale or stretch) that showed it."""

    lattice: Lattice
    level: SearchLevel


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """Of a board of ``size`` (the larger number of corners first) with ``n_points``."""

    size: tuple[int, int]
    n_points: int
    is_stretched: bool = False
    """Whether the stretched images are searched, which show a part of the image only."""
    has_levels: bool = True
    """Whether the searches of this kind have not come to their end."""
    pending: tuple[Candidate, ...] = ()
    """Lattices of the board's size, nearly whole, not yet measured."""
    is_second_look: bool = False
    """Whether a search more was made since the first of them."""
    most_seen: int = 0
    """Corners of the fullest lattice of the board's size, whole enough or not."""
    refused: FoundBoard | None = None
    """The first candidate that was measured and refused."""
    several: tuple[Lattice, ...] = ()
    """Boards where more than one was seen at once."""
    other: Lattice | None = None
    """The fullest board of another size."""
    other_level: SearchLevel | None = None
    """The search that showed it."""
    part: Candidate | None = None
    """The fullest lattice of another size, whole or not."""
    larger: tuple[int, int] | None = None
    """The size of a board larger than the SPEC, where the last search showed one."""
    agrees_on_larger: bool = False
    """Whether two searches running showed the same larger board."""
    linked_px: Float[ndarray, "n 2"] = field(default_factory=lambda: np.zeros((0, 2)))
    """The largest group of linked corners."""

    def with_level(self, level: SearchLevel) -> Sightings:
        """With what one more search has shown."""
        exact = next((lattice for lattice in level.lattices if lattice.size == self.size), None)
        changes = self._see_others(level) if exact is None else self._see_exact(Candidate(exact, level))
        if len(level.linked_px) > len(self.linked_px):
            changes["linked_px"] = level.linked_px
        return replace(self, is_second_look=bool(self.pending), **changes)

    def _see_exact(self, candidate: Candidate) -> dict[str, Any]:
        n_seen = candidate.lattice.n_seen
        is_enough = n_seen >= MIN_SHARE_SEEN * self.n_points
        pending = (*self.pending, candidate) if is_enough else self.pending
        return {"most_seen": max(self.most_seen, n_seen), "pending": pending}

    def _see_others(self, level: SearchLevel) -> dict[str, Any]:
        boards = boards_among(level.lattices, size_wh=level.size_wh)
        if len(boards) > 1:  # or pieces of one, which a finer search puts together
            return {"several": self.several or tuple(boards)}
        part, other, other_level = self.part, self.other, self.other_level
        for lattice in level.lattices:
            is_large = min(lattice.points_px.shape[:2]) >= MIN_LINES
            if is_large and (part is None or lattice.n_seen > part.lattice.n_seen):
                part = Candidate(lattice, level)
        if boards and (other is None or boards[0].n_seen > other.n_seen):
            other, other_level = boards[0], level
        size = boards[0].size if boards else (0, 0)
        larger = size if size[0] > self.size[0] or size[1] > self.size[1] else None
        agrees = larger is not None and larger == self.larger
        return {
            "part": part,
            "other": other,
            "other_level": other_level,
            "larger": larger,
            "agrees_on_larger": agrees,
        }

    def with_refused(self, found: FoundBoard) -> Sightings:
        """With a candidate's refusal; the first one counts."""
        return self if self.refused is not None else replace(self, refused=found)

    def without_more_levels(self) -> Sightings:
        """At the end of the searches of this kind."""
        return replace(self, has_levels=False)

    def by_corners_seen(self) -> list[Candidate]:
        """The pending candidates, the fullest first."""
        return sorted(self.pending, key=lambda candidate: -candidate.lattice.n_seen)
