"""What detection says about one image."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.shapes import Bool, Float
from binocal.values import ArrayValue, frozen_array


@dataclass(frozen=True, slots=True, eq=False)
class FoundBoard(ArrayValue):
    """The board's points in one image, in the board's own order.

    ``points_px`` is NaN where a point was not seen, all NaN where the board was not found; ``reason`` then says why,
    and is empty otherwise. ``covariance_px2`` is each point's estimated covariance, NaN where it was not seen;
    ``cross_covariance_px2`` the sum of those with the other points, None where points share no pixels. ``note`` says
    what a careful reader should know of a found board. ``size_seen`` is the size of the grid that was seen instead
    of the board's (columns and rows, the larger first), for hints.
    """

    points_px: Float[ndarray, "n 2"]
    covariance_px2: Float[ndarray, "n 2 2"]
    reason: str = ""
    note: str = ""
    size_seen: tuple[int, int] | None = None
    cross_covariance_px2: Float[ndarray, "n 2 2"] | None = None
    is_patterned: bool = False
    """Whether a chessboard was not taken for the board because its bright squares hold patterns, as a ChArUco board's do."""
    spec_seen: str = ""
    """Why a marker board was not taken for the board: the SPEC that its markers prove; "?" where they show only that it is another."""
    is_among_several: bool = False
    """Whether the board was not found because several boards are seen, and which is meant cannot be known."""
    is_unnamed: bool = False
    """Whether corners like the board's are seen, and nothing in the image tells which of them they are."""

    def __post_init__(self) -> None:
        for name in ("points_px", "covariance_px2", "cross_covariance_px2"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, frozen_array(getattr(self, name)))
        shape = (*self.points_px.shape, 2)
        is_wrong = self.cross_covariance_px2 is not None and self.cross_covariance_px2.shape != shape
        if self.points_px.ndim != 2 or self.covariance_px2.shape != shape or is_wrong:
            raise ValueError(
                f"points (n, 2) need covariances (n, 2, 2); got {self.points_px.shape}, {self.covariance_px2.shape}"
            )

    @property
    def is_seen(self) -> Bool[ndarray, "n"]:
        """Which points were seen."""
        return np.isfinite(self.points_px[:, 0])

    @property
    def is_found(self) -> bool:
        """Whether the board was found."""
        return not self.reason


def not_found(n_points: int, reason: str, *, size_seen: tuple[int, int] | None = None) -> FoundBoard:
    """A board that was not found, and why."""
    return FoundBoard(np.full((n_points, 2), np.nan), np.full((n_points, 2, 2), np.nan), reason, size_seen=size_seen)


def several_boards(board: Board) -> FoundBoard:
    """A board that was not found because an image shows it more than once."""
    more = ", or print them with different ids" if board.kind in ("charuco", "aprilgrid") else ""
    text = f"more than one board in the image; show one at a time, or cover the others{more}"
    return replace(not_found(board.n_points, text), is_among_several=True)
